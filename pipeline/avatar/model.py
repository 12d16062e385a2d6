"""The avatar of a body or a head: one Gaussian per atlas texel, relit by learned transfer or microfacets, splatted.

RFGCA 3-16, RGCA 3-9. Every texel has parameters of its own, which are optimised directly; networks may add to them
what changes with pose, expression and view. Only what `AvatarSpec` asks for is built.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.eye_glints import mirror_pixels
from pipeline.avatar.eyes import Eyes
from pipeline.avatar.head_networks import HeadNetworks
from pipeline.avatar.networks import Networks
from pipeline.avatar.pixel_depth import depth_of_pixels
from pipeline.avatar.pose import FrameInputs, PosedTexels, white_once
from pipeline.avatar.shading import (
    arriving_light,
    every_light,
    points_of_pixels,
    shade_diffuse,
    shade_gloss,
    shade_harmonics,
    shade_matte,
    shade_specular,
    shade_viewed,
)  # fmt: skip
from pipeline.avatar.shadow_net import ShadowNet
from pipeline.avatar.spec import AvatarSpec
from pipeline.avatar.texel_parameters import START_AMBIENT, TexelParameters
from pipeline.geometry.eye_fit import FittedEye
from pipeline.geometry.rotations import matrix_from_quaternion, multiply_quaternions
from pipeline.geometry.texels import Atlas
from pipeline.lighting.bounces import bounced_irradiance
from pipeline.lighting.distant import LIGHTS_THAT_PAY, gather_distant
from pipeline.lighting.lobes import angular_gaussian, cosine_gaussian, unit
from pipeline.lighting.zonal import gather_light
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.supersample import splat_supersampled

LOBES = {"angular": angular_gaussian, "cosine": cosine_gaussian}

SMALLEST_ALPHA = 1 / 255
"""Pixels with less coverage hold nothing to shade; the rasteriser's own cut-off."""


class Avatar(TexelParameters):
    """Parameters of every texel, and what renders them for a pose, a light and a camera.

    Args:
        atlas: the texels the Gaussians sit on.
        spacing: size of each texel on the rest surface along tangent and bitangent, metres [texels, 2].
        eyes: of eyes.json, by name, for an avatar with explicit eyes.
    """

    def __init__(
        self, atlas: Atlas, spacing: Float[Tensor, "texels 2"], spec: AvatarSpec,
        eyes: Mapping[str, FittedEye] | None = None,
    ) -> None:  # fmt: skip
        super().__init__(atlas, spacing, spec)
        if spec.shadow_net:
            self.shadow_net = ShadowNet(atlas, spec.shadow_width)
        if spec.indirect == "ambient":
            self.ambient = nn.Parameter(torch.full((len(spacing), 3), START_AMBIENT))
        if spec.decoded:
            build = HeadNetworks if spec.head else Networks
            self.networks = build(atlas, spec, self.shared(), float(spacing.mean()))
        if spec.eyes:
            self.eyes = Eyes(atlas, eyes or {}, self.log_scale.detach().exp())
            self.eyes.start(self)

    def prepare(self, inputs: FrameInputs, **expression: Tensor) -> dict:
        """Everything of a frame that no camera changes: placed Gaussians with their colour (RFGCA 5-10, 15).

        Args:
            inputs: pose and light.
            expression: of a head, `noise` or `code`, see `HeadNetworks.decode`.
        """
        positions, intensities = inputs.lights if self.spec.near_field else inputs.far_lights
        frame = self.shared()
        if self.spec.decoded:
            frame = self.networks.decode(frame, inputs, **expression)
        posed = frame["posed"] if self.spec.head else inputs.posed
        if self.spec.eyes:
            frame, posed = self.eyes.place(frame, posed, inputs)
        axes, quaternions = self.orient(frame, posed)
        frame |= {
            "means": posed.points + (posed.frames @ frame["offset"][..., None])[..., 0],
            "axes": axes,
            "quaternions": quaternions,
            "scales": frame["log_scale"].exp(),
            "opacities": torch.sigmoid(frame["opacity"]),
            "normals": posed.frames[..., 2],
            "light_positions": positions,
            "intensities": white_once(intensities),
            "seen": inputs.seen if self.spec.traced else every_light(len(positions), len(posed.points)),
        }
        frame["bent_normals"] = self.bend(frame)
        if self.spec.pixel_depth == "traced":
            frame["mesh"] = inputs.mesh
        if self.spec.shading in ("harmonics", "linear"):
            frame["harmonics"] = inputs.harmonics if self.spec.near_field else inputs.body_light[None]
        if self.spec.shading == "linear":
            frame["head_light"] = inputs.body_light
        frame["diffuse"] = self.shade_direct(frame, axes, inputs)
        if self.spec.eyes and not self.spec.shadow:
            frame["diffuse"] = self.eyes.under_lids(frame, frame["diffuse"])
        if self.spec.shadow_net:
            frame["shadow"] = self.shadow_net(*inputs.irradiance)
        if self.spec.indirect != "none":
            frame["indirect"] = self.shade_indirect(frame, inputs)
        return frame

    def orient(self, frame: dict, posed: PosedTexels) -> tuple[Tensor, Tensor]:
        """R_k = TBN_k dR_k (RFGCA 6), as matrices [texels, 3, 3] and quaternions [texels, 4]."""
        matrices = posed.frames @ matrix_from_quaternion(frame["rotation"])
        return matrices, multiply_quaternions(posed.quaternions, frame["rotation"])

    def bend(self, frame: dict, added: Float[Tensor, "texels 3"] | None = None) -> Float[Tensor, "texels 3"]:
        """Unit normals for shading. dn is kept in the Gaussian's frame (RFGCA 10), or in that of the mesh (RGCA 9), so
        that it turns with the pose; `added`: what a camera adds to it."""
        if not self.spec.bent_normals:
            return frame["normals"]
        around = frame["posed"].frames if self.spec.head else frame["axes"]
        offset = frame["normal_offset"] if added is None else frame["normal_offset"] + added
        return unit((around @ (offset + offset.new_tensor([0.0, 0.0, 1.0]))[..., None])[..., 0])

    def shade_direct(self, frame: dict, axes: Tensor, inputs: FrameInputs) -> Float[Tensor, "texels 3"]:
        """Light of the lamps that leaves every texel alike in all directions, before the shadow network."""
        lights = (frame["light_positions"], frame["intensities"], frame["seen"])
        if self.spec.shading == "microfacet":
            return shade_matte(self.albedo, frame["means"].detach(), frame["bent_normals"], *lights)
        transfer = (frame["transfer_color"], frame.get("transfer_mono"))
        if self.spec.shading in ("harmonics", "linear"):
            return shade_harmonics(self.albedo, *transfer, frame["harmonics"])
        if not (self.spec.near_field or self.spec.traced) and len(lights[0]) >= LIGHTS_THAT_PAY:
            return shade_diffuse(self.albedo, *transfer, gather_distant(axes, inputs.world_light))
        return shade_diffuse(self.albedo, *transfer, gather_light(frame["means"], axes, *lights))

    def shade_indirect(self, frame: dict, inputs: FrameInputs) -> Float[Tensor, "texels 3"]:
        """Light by way of other surfaces. What these send is taken as it is: no gradient goes back along the bounce."""
        if self.spec.indirect == "ambient":
            sent = arriving_light(frame["means"].detach(), frame["light_positions"], frame["intensities"])
            return self.albedo * self.ambient / torch.pi * sent
        source = frame["diffuse"].detach().clamp_min(0)
        if self.spec.shadow_net:
            source = source * frame["shadow"].detach()[:, None]
        return self.albedo / torch.pi * bounced_irradiance(source, inputs.bounces)

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
            if spec.deferred:
                layers = {"normal": normals, "roughness": roughness[:, None], "visibility": visibility[:, None]}
            else:
                lights = (frame["light_positions"], frame["intensities"])
                points = frame["means"].detach()
                lobe = (roughness, visibility, center, *lights, LOBES[spec.highlight])
                color = color + shade_specular(points, normals, *lobe)
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

    def reflect(
        self, frame: dict, center: Tensor, points: Tensor, normals: Tensor, roughness: Tensor, visibility: Tensor
    ) -> Float[Tensor, "pixels channels"]:
        """What mirrors show a camera at `center`; see `shade_specular`."""
        lights = frame["light_positions"], frame["intensities"]
        return shade_specular(points, normals, roughness, visibility, center, *lights, LOBES[self.spec.highlight])

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
            specular = shade_specular(
                points, normal, roughness[:, 0] / weight, visibility[:, 0], center, frame["light_positions"],
                frame["intensities"], LOBES[self.spec.highlight],
            )  # fmt: skip
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if "eyes" in pixels:
            row, column, *mirror = mirror_pixels(pixels["eyes"], frame["eye_balls"], R, center, K)
            specular = self.reflect(frame, center, *mirror)
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if "shadow" in pixels:
            color = color * (pixels["shadow"] / alpha[..., None].clamp_min(SMALLEST_ALPHA))
        return color + pixels["indirect"] if "indirect" in pixels else color
