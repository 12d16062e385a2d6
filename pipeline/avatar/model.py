"""The full-body avatar: one Gaussian per atlas texel, relit by learned transfer or by microfacets, splatted.

RFGCA 3-16. Every texel has parameters of its own, which are optimised directly; networks may add to them what changes
with pose and view. Only what `AvatarSpec` asks for is built.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.eye_glints import mirror_pixels
from pipeline.avatar.eyes import Eyes
from pipeline.avatar.networks import POSED, Networks
from pipeline.avatar.pixel_depth import depth_of_pixels
from pipeline.avatar.pose import FrameInputs, PosedTexels, rest_normals, white_once
from pipeline.avatar.shading import (
    arriving_light,
    every_light,
    points_of_pixels,
    shade_diffuse,
    shade_gloss,
    shade_harmonics,
    shade_matte,
    shade_specular,
    start_harmonics,
    start_transfer,
)  # fmt: skip
from pipeline.avatar.shadow_net import ShadowNet
from pipeline.avatar.spec import AvatarSpec
from pipeline.geometry.eye_fit import FittedEye
from pipeline.geometry.rotations import matrix_from_quaternion, multiply_quaternions
from pipeline.geometry.texels import Atlas
from pipeline.lighting.bounces import bounced_irradiance
from pipeline.lighting.distant import LIGHTS_THAT_PAY, gather_distant
from pipeline.lighting.lobes import unit
from pipeline.lighting.zonal import gather_light
from pipeline.rendering.splat_conventions import Splatted
from pipeline.rendering.supersample import splat_supersampled

START_ALBEDO = 0.4
START_OPACITY = 0.95
START_ROUGHNESS = 0.15
START_VISIBILITY = 0.02
START_GGX_WIDTH = 0.4
START_AMBIENT = 0.02
START_FILL = 0.6
"""A Gaussian's standard deviation along the surface, in texel spacings: neighbours' weights then sum to within 3 % of
a constant, so the start surface is closed and even."""

START_THICKNESS = 0.1
"""Standard deviation along the normal, in texel spacings: a thin disc."""

SMALLEST_ALPHA = 1 / 255
"""Pixels with less coverage hold nothing to shade; the rasteriser's own cut-off."""


class Avatar(nn.Module):
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
        super().__init__()
        self.spec = spec
        texels = len(spacing)
        thickness = START_THICKNESS * spacing.mean(-1, keepdim=True)
        self.offset = nn.Parameter(torch.zeros(texels, 3))
        self.rotation = nn.Parameter(torch.tensor([1.0, 0, 0, 0]).repeat(texels, 1))
        self.log_scale = nn.Parameter(torch.cat([START_FILL * spacing, thickness], -1).log())
        self.opacity = nn.Parameter(torch.full((texels,), START_OPACITY).logit())
        self.albedo = nn.Parameter(torch.full((texels, 3), START_ALBEDO))
        self.register_buffer("spacing", spacing)
        self.build_transfer(atlas, texels)
        if spec.bent_normals:
            self.normal_offset = nn.Parameter(torch.zeros(texels, 3))
        if spec.lobe:
            self.log_roughness = nn.Parameter(torch.full((texels,), START_ROUGHNESS).log())
            self.visibility = nn.Parameter(torch.full((texels,), START_VISIBILITY).logit())
        if spec.gloss:
            self.log_ggx_width = nn.Parameter(torch.full((texels,), START_GGX_WIDTH).log())
            self.log_gloss = nn.Parameter(torch.zeros(texels))
        if spec.shadow_net:
            self.shadow_net = ShadowNet(atlas, spec.shadow_width)
        if spec.indirect == "ambient":
            self.ambient = nn.Parameter(torch.full((texels, 3), START_AMBIENT))
        if spec.decoded:
            self.networks = Networks(atlas, spec, self.shared(), float(spacing.mean()))
        if spec.eyes:
            self.eyes = Eyes(atlas, eyes or {}, self.log_scale.detach().exp())
            self.eyes.start(self)

    def build_transfer(self, atlas: Atlas, texels: int) -> None:
        """Transfer coefficients, started at the Lambertian lobe of the normal; buffer `start_*` keeps where."""
        if self.spec.shading == "microfacet":
            return
        zonal = self.spec.shading == "transfer"
        start = start_transfer() if zonal else start_harmonics(rest_normals(atlas))
        for name, values in zip(("transfer_color", "transfer_mono"), start, strict=True):
            self.register_buffer(f"start_{name}", values, persistent=zonal)  # what the atlas says is not stored twice
            repeats = (texels, *[1] * values.ndim) if zonal else [1] * values.ndim
            setattr(self, name, nn.Parameter(values.repeat(repeats)))

    def shared(self) -> dict[str, Tensor]:
        """The parameters that networks may add to, as all poses share them."""
        return {name: self.get_parameter(name) for name in POSED if hasattr(self, name)}

    def prepare(self, inputs: FrameInputs) -> dict:
        """Everything of a frame that no camera changes: placed Gaussians with their colour (RFGCA 5-10, 15)."""
        posed, (positions, intensities) = inputs.posed, inputs.lights if self.spec.near_field else inputs.far_lights
        frame = self.shared()
        if self.spec.decoded:
            frame = self.networks.decode(frame, inputs.record.vertices)
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
            "bent_normals": self.bend(frame, posed, axes),
            "light_positions": positions,
            "intensities": white_once(intensities),
            "seen": inputs.seen if self.spec.traced else every_light(len(positions), len(posed.points)),
        }
        if self.spec.pixel_depth == "traced":
            frame["mesh"] = inputs.mesh
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

    def bend(self, frame: dict, posed: PosedTexels, axes: Float[Tensor, "texels 3 3"]) -> Float[Tensor, "texels 3"]:
        """Unit normals for shading (RFGCA 10); dn is kept in the Gaussian's frame, so that it turns with the pose."""
        if not self.spec.bent_normals:
            return posed.frames[..., 2]
        offset = frame["normal_offset"]
        return unit((axes @ (offset + offset.new_tensor([0.0, 0.0, 1.0]))[..., None])[..., 0])

    def shade_direct(self, frame: dict, axes: Tensor, inputs: FrameInputs) -> Float[Tensor, "texels 3"]:
        """Light of the lamps that leaves every texel alike in all directions, before the shadow network."""
        lights = (frame["light_positions"], frame["intensities"], frame["seen"])
        if self.spec.shading == "microfacet":
            return shade_matte(self.albedo, frame["means"].detach(), frame["bent_normals"], *lights)
        transfer = (frame["transfer_color"], frame["transfer_mono"])
        if self.spec.shading == "harmonics":
            light = inputs.harmonics if self.spec.near_field else inputs.body_light[None]
            return shade_harmonics(self.albedo, *transfer, light)
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
        layers = {}
        if spec.lobe:
            roughness, visibility = self.log_roughness.exp(), self.specular_visibility(frame, center)
            if spec.eyes:
                visibility, eyes = self.eyes.split_mirrors(frame, roughness, visibility)
            if spec.deferred:
                layers = {
                    "normal": frame["bent_normals"],
                    "roughness": roughness[:, None],
                    "visibility": visibility[:, None],
                }
            else:
                lights = (frame["light_positions"], frame["intensities"])
                points = frame["means"].detach()
                color = color + shade_specular(points, frame["bent_normals"], roughness, visibility, center, *lights)
        if spec.shadow_net:
            layers["shadow"] = frame["shadow"][:, None]
            if spec.indirect != "none":
                layers["indirect"] = frame["indirect"]
        elif spec.indirect != "none":
            color = color + frame["indirect"]
        if spec.eyes and spec.lobe:
            layers["eyes"] = eyes
        return {"color": color, **layers}

    def specular_visibility(self, frame: dict, center: Float[Tensor, "3"]) -> Float[Tensor, " texels"]:
        """v_k as a camera sees it (RFGCA 14)."""
        added = self.networks.visibility(frame, center) if self.spec.view_decoder else 0
        return torch.sigmoid(self.visibility + added)

    def reflect(
        self, frame: dict, center: Tensor, points: Tensor, normals: Tensor, roughness: Tensor, visibility: Tensor
    ) -> Float[Tensor, "pixels channels"]:
        """What mirrors show a camera at `center`; see `shade_specular`."""
        lights = frame["light_positions"], frame["intensities"]
        return shade_specular(points, normals, roughness, visibility, center, *lights)

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
                frame["intensities"],
            )  # fmt: skip
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if "eyes" in pixels:
            row, column, *mirror = mirror_pixels(pixels["eyes"], frame["eye_balls"], R, center, K)
            specular = self.reflect(frame, center, *mirror)
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if "shadow" in pixels:
            color = color * (pixels["shadow"] / alpha[..., None].clamp_min(SMALLEST_ALPHA))
        return color + pixels["indirect"] if "indirect" in pixels else color
