"""The avatar of a body or a head: one Gaussian per atlas texel, relit by learned transfer or microfacets, splatted.

RFGCA 3-16, RGCA 3-9. Every texel has parameters of its own, which are optimised directly; networks may add to them
what changes with pose, expression and view. Only what `AvatarSpec` asks for is built. What all cameras of a frame share
is made by `pipeline.avatar.shaded_texels`, what each sees here.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.eyes.eye_glints import mirror_pixels
from pipeline.avatar.pixel_depth import depth_of_pixels
from pipeline.avatar.shaded_texels import LitTexels
from pipeline.avatar.shading import (
    points_of_pixels,
    shade_gloss,
    shade_halfway,
    shade_near_mirrors,
    shade_specular,
    shade_viewed,
)
from pipeline.lighting.lobes import angular_gaussian, cosine_gaussian
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.supersample import splat_supersampled

LOBES = {"angular": angular_gaussian, "cosine": cosine_gaussian, "half": angular_gaussian}
"""Of what is mirrored about a mirror direction: near-mirrors, as eyes are, know no other angle."""

SMALLEST_ALPHA = 1 / 255
"""Pixels with less coverage hold nothing to shade; the rasteriser's own cut-off."""


class Avatar(LitTexels):
    """Parameters of every texel, and what renders them for a pose, a light and a camera: `prepare` a frame, then `view`
    it with each camera. Arguments: see `LitTexels`."""

    def view(self, frame: dict, R: Tensor, t: Tensor, K: Tensor, width: int, height: int) -> dict[str, Tensor]:
        """One camera's picture of a prepared frame: linear RGB [h, w, 3] over black, alpha [h, w] and, if the lobe is
        deferred, the blended normals [h, w, 3]."""
        center = -R.T @ t
        # A closed surface hides its far side; thin Gaussians would let it shine through the gaps.
        facing = (frame["normals"] * (center - frame["means"].detach())).sum(-1) > 0
        layers = self.layers(frame, center)
        picture = splat_supersampled(
            frame["means"], frame["quaternions"], frame["scales"], frame["opacities"] * facing,
            torch.cat(list(layers.values()), -1), R, t, K, width, height,
            factor=self.spec.supersample, filter=self.spec.pixel_filter, filter_std_px=self.spec.filter_std_px,
            dilation_px2=self.spec.dilation_px2, compensate_opacity=self.spec.compensate_opacity,
            median_depth=self.spec.pixel_depth == "median",
        )  # fmt: skip
        widths = [layer.shape[-1] for layer in layers.values()]
        pixels = dict(zip(layers, picture.features.split(widths, -1), strict=True))
        shown = {"rgb": self.shade_pixels(pixels, picture, frame, R, center, K), "alpha": picture.alpha}
        return {**shown, "normal": pixels["normal"]} if "normal" in pixels else shown

    def layers(self, frame: dict, center: Float[Tensor, " 3"]) -> dict[str, Float[Tensor, "texels _"]]:
        """What is splatted for one camera. The light that the shadow network's factor dims is a layer of its own."""
        spec, color = self.spec, frame["diffuse"]
        if spec.eyes:
            color = self.eyes.seen_from(frame, center, color)
        if spec.gloss:
            width = self.log_ggx_width.exp()
            color = color + self.log_gloss.exp()[:, None] * shade_gloss(width, frame, center)
        viewed, layers = self.viewed(frame, center), {}
        if spec.viewed_harmonics:
            color = color + shade_viewed(viewed["specular_harmonics"], frame["harmonics"])
        if spec.shading == "linear":
            color = color + self.albedo * self.networks.linear_color(frame, center)
        if spec.lobe:
            roughness = frame.get("log_roughness", self.log_roughness).exp()
            visibility = self.specular_visibility(viewed)
            if spec.eyes:
                visibility, eyes = self.eyes.split_mirrors(frame, roughness, visibility)
            normals = self.bend(frame, viewed["normal_offset"]) if spec.viewed_normals else frame["bent_normals"]
            if spec.eyes:  # or skin beside an eye would shine as the eye does
                normals = self.eyes.without(normals)
            if spec.deferred:
                layers = {"normal": normals, "roughness": roughness[:, None], "visibility": visibility[:, None]}
            else:
                lights = (frame["light_positions"], frame["intensities"])
                points = frame["means"].detach()
                color = color + self.shade_lobe(points, normals, roughness, visibility, center, *lights)
        if spec.shadow_net:
            layers["shadow"] = frame["shadow"][:, None]
            if spec.indirect != "none":
                layers["indirect"] = frame["indirect"]
        elif spec.indirect != "none":
            color = color + frame["indirect"]
        if spec.eyes and spec.lobe:
            layers["eyes"] = eyes
        return {"color": color, **layers}

    def viewed(self, frame: dict, center: Float[Tensor, "3"]) -> dict[str, Tensor]:
        """What a camera changes in the parameters of texels (RFGCA 14, RGCA 9)."""
        return self.networks.viewed(frame, center) if self.spec.view_decoder else {}

    def specular_visibility(self, viewed: dict[str, Tensor]) -> Float[Tensor, " texels"]:
        """v_k as the camera of `viewed` sees it."""
        return torch.sigmoid(self.visibility + viewed.get("visibility", 0))

    def shade_lobe(self, points: Tensor, normals: Tensor, *lobe_and_lights: Tensor) -> Float[Tensor, "n channels"]:
        """The specular lobe of points that are texels or pixels, see `shade_specular`."""
        if self.spec.highlight == "half":
            return shade_halfway(points, normals, *lobe_and_lights)
        return shade_specular(points, normals, *lobe_and_lights, LOBES[self.spec.highlight])

    def reflect(
        self, frame: dict, center: Tensor, points: Tensor, normals: Tensor, roughness: Tensor, visibility: Tensor
    ) -> Float[Tensor, "pixels channels"]:
        """What mirrors show a camera at `center`, all of them near each other: see `shade_near_mirrors`."""
        lights = frame["light_positions"], frame["intensities"]
        return shade_near_mirrors(points, normals, roughness, visibility, center, *lights, LOBES[self.spec.highlight])

    def shade_pixels(
        self, pixels: dict, picture: Splatted, frame: dict, R: Tensor, center: Tensor, K: Tensor
    ) -> Tensor:
        """(c_d + c_s) shadow (RFGCA 16), the specular lobe evaluated once per covered pixel (RFGCA 11-12)."""
        color, alpha = pixels["color"], picture.alpha
        if "normal" in pixels:
            row, column = torch.nonzero(alpha.detach() > SMALLEST_ALPHA, as_tuple=True)
            normal, roughness, visibility = (
                pixels[name][row, column] for name in ("normal", "roughness", "visibility")
            )
            weight = alpha[row, column].clamp_min(SMALLEST_ALPHA)
            depth = depth_of_pixels(self.spec.depth, picture, frame.get("mesh"), R, center, K)
            points = points_of_pixels(row, column, depth[row, column], R, center, K)
            lobe = (roughness[:, 0] / weight, visibility[:, 0])
            specular = self.shade_lobe(points, normal, *lobe, center, frame["light_positions"], frame["intensities"])
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if "eyes" in pixels:
            row, column, points, normals, width, visibility = mirror_pixels(
                pixels["eyes"], frame["eye_balls"], R, center, K
            )
            visibility = visibility * frame["lids"].pass_mirrored(points, normals, center)
            specular = self.reflect(frame, center, points, normals, width, visibility)
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if "shadow" in pixels:
            color = color * (pixels["shadow"] / alpha[..., None].clamp_min(SMALLEST_ALPHA))
        return color + pixels["indirect"] if "indirect" in pixels else color
