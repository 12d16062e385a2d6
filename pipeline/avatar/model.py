"""The full-body avatar: one Gaussian per atlas texel, relit by zonal transfer, a specular lobe and a shadow network.

RFGCA 5-16 with per-texel parameters that are optimised directly: what the decoders of RFGCA 4 and 14 would predict per
pose and per view is here one value per texel. Only what the effects plan turned on is built.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.pose import PosedTexels
from pipeline.avatar.shading import COLOR_DEGREES, shade_diffuse, shade_specular
from pipeline.avatar.shadow_net import ShadowNet
from pipeline.geometry.rotations import matrix_from_quaternion, multiply_quaternions
from pipeline.geometry.texels import Atlas
from pipeline.lighting.lobes import unit
from pipeline.lighting.zonal import DEGREES, clamped_cosine_coefficients, gather_light
from pipeline.rendering.supersample import splat_supersampled

START_ALBEDO = 0.4
START_ROUGHNESS = 0.15
START_VISIBILITY = 0.02
START_OPACITY = 0.95
START_FILL = 0.6
"""A Gaussian's standard deviation along the surface, in texel spacings: neighbours' weights then sum to within 3 % of
a constant, so the start surface is closed and even."""

START_THICKNESS = 0.1
"""Standard deviation along the normal, in texel spacings: a thin disc."""

SMALLEST_ALPHA = 1 / 255
"""Pixels with less coverage hold nothing to shade; the rasteriser's own cut-off."""


@dataclass(frozen=True)
class AvatarSpec:
    """What is built; stored beside the parameters. `supersample` and `dilation_px2` belong to the avatar because it
    was fitted through them."""

    specular: bool
    shadow: bool
    shadow_width: int
    supersample: int
    dilation_px2: float

    def as_json(self) -> dict:
        """The fields by name, for config.json."""
        return asdict(self)


class Avatar(nn.Module):
    """Parameters of every texel, and what renders them for a pose, a light and a camera.

    Args:
        atlas: the texels the Gaussians sit on.
        spacing: size of each texel on the rest surface along tangent and bitangent, metres [texels, 2].
    """

    def __init__(self, atlas: Atlas, spacing: Float[Tensor, "texels 2"], spec: AvatarSpec) -> None:
        super().__init__()
        self.spec = spec
        texels = len(spacing)
        thickness = START_THICKNESS * spacing.mean(-1, keepdim=True)
        lambert = torch.as_tensor(clamped_cosine_coefficients(), dtype=torch.float32)
        transfer = torch.zeros(texels, 3, DEGREES)
        transfer[:, 2] = lambert  # the lobe of the normal; tangent and bitangent start empty
        self.offset = nn.Parameter(torch.zeros(texels, 3))
        self.rotation = nn.Parameter(torch.tensor([1.0, 0, 0, 0]).repeat(texels, 1))
        self.log_scale = nn.Parameter(torch.cat([START_FILL * spacing, thickness], -1).log())
        self.opacity = nn.Parameter(torch.full((texels,), START_OPACITY).logit())
        self.albedo = nn.Parameter(torch.full((texels, 3), START_ALBEDO))
        self.transfer_color = nn.Parameter(transfer[:, :, :COLOR_DEGREES, None].repeat(1, 1, 1, 3))
        self.transfer_mono = nn.Parameter(transfer[:, :, COLOR_DEGREES:].clone())
        self.register_buffer("spacing", spacing)
        self.register_buffer("lambert", lambert)
        if spec.specular:
            self.normal_offset = nn.Parameter(torch.zeros(texels, 3))
            self.log_roughness = nn.Parameter(torch.full((texels,), START_ROUGHNESS).log())
            self.visibility = nn.Parameter(torch.full((texels,), START_VISIBILITY).logit())
        if spec.shadow:
            self.shadow_net = ShadowNet(atlas, spec.shadow_width)

    def prepare(
        self,
        posed: PosedTexels,
        irradiance: Float[Tensor, " texels"],
        falling: Float[Tensor, " texels"],
        light_positions: Float[Tensor, "lights 3"],
        intensities: Float[Tensor, "lights 3"],
    ) -> dict[str, Tensor]:
        """Everything of a frame that no camera changes: placed Gaussians with their colour (RFGCA 5-10, 15)."""
        means = posed.points + (posed.frames @ self.offset[..., None])[..., 0]
        axes, quaternions = self.orient(posed)
        channels = intensities[:, :1] if bool((intensities == intensities[:, :1]).all()) else intensities
        light = gather_light(means, axes, light_positions, channels)
        frame = {
            "means": means,
            "quaternions": quaternions,
            "scales": self.log_scale.exp(),
            "opacities": torch.sigmoid(self.opacity),
            "normals": posed.frames[..., 2],
            "diffuse": shade_diffuse(self.albedo, self.transfer_color, self.transfer_mono, light),
            "light_positions": light_positions,
            "intensities": channels,
        }
        if self.spec.specular:
            # RFGCA 10; dn is kept in the Gaussian's frame, so that it turns with the pose.
            bent = self.normal_offset + torch.tensor([0.0, 0.0, 1.0])
            frame["specular_normals"] = unit((axes @ bent[..., None])[..., 0])
        if self.spec.shadow:
            frame["shadow"] = self.shadow_net(irradiance, falling)
        return frame

    def orient(self, posed: PosedTexels) -> tuple[Tensor, Tensor]:
        """R_k = TBN_k dR_k (RFGCA 6), as matrices [texels, 3, 3] and quaternions [texels, 4]."""
        matrices = posed.frames @ matrix_from_quaternion(self.rotation)
        return matrices, multiply_quaternions(posed.quaternions, self.rotation)

    def view(self, frame: dict[str, Tensor], R: Tensor, t: Tensor, K: Tensor, width: int, height: int) -> dict:
        """One camera's picture of a prepared frame: linear RGB [h, w, 3] over black, and alpha [h, w]."""
        center = -R.T @ t
        # A closed surface hides its far side; thin Gaussians would let it shine through the gaps.
        facing = (frame["normals"] * (center - frame["means"].detach())).sum(-1) > 0
        layers = {"diffuse": frame["diffuse"]}
        if self.spec.specular:
            layers["normal"] = frame["specular_normals"]
            layers["roughness"] = self.log_roughness.exp()[:, None]
            layers["visibility"] = torch.sigmoid(self.visibility)[:, None]
        if self.spec.shadow:
            layers["shadow"] = frame["shadow"][:, None]
        picture = splat_supersampled(
            frame["means"], frame["quaternions"], frame["scales"], frame["opacities"] * facing,
            torch.cat(list(layers.values()), -1), R, t, K, width, height,
            factor=self.spec.supersample, dilation_px2=self.spec.dilation_px2,
        )  # fmt: skip
        widths = [layer.shape[-1] for layer in layers.values()]
        pixels = dict(zip(layers, picture.features.split(widths, -1), strict=True))
        return {"rgb": self.shade_pixels(pixels, picture, frame, R, center, K), "alpha": picture.alpha}

    def shade_pixels(self, pixels: dict, picture, frame: dict, R: Tensor, center: Tensor, K: Tensor) -> Tensor:
        """(c_d + c_s) shadow (RFGCA 16), the specular lobe evaluated once per covered pixel (RFGCA 11-12)."""
        color, alpha = pixels["diffuse"], picture.alpha
        if self.spec.specular:
            row, column = torch.nonzero(alpha.detach() > SMALLEST_ALPHA, as_tuple=True)
            covered = {name: layer[row, column] for name, layer in pixels.items()}
            weight = alpha[row, column].clamp_min(SMALLEST_ALPHA)
            # The depth only says where the pixel's point is; sharpening it is not the lobe's business: no gradient.
            depth = (picture.depth[row, column] / weight).detach()
            in_camera = torch.stack([(column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]], -1)
            points = depth[:, None] * torch.cat([in_camera, torch.ones_like(depth)[:, None]], -1) @ R + center
            specular = shade_specular(
                points, unit(covered["normal"]), covered["roughness"][:, 0] / weight, covered["visibility"][:, 0],
                center, frame["light_positions"], frame["intensities"],
            )  # fmt: skip
            color = color.index_put((row, column), specular.expand(-1, 3), accumulate=True)
        if self.spec.shadow:
            color = color * (pixels["shadow"] / alpha[..., None].clamp_min(SMALLEST_ALPHA))
        return color
