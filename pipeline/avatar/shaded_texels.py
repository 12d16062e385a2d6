"""Texels placed and lit for a frame: everything of an avatar that no camera changes (RFGCA 3-10, 15, RGCA 3-5)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.body_networks import Networks
from pipeline.avatar.eyes.explicit_eyes import Eyes
from pipeline.avatar.head_networks import HeadNetworks
from pipeline.avatar.pose import FrameInputs, PosedTexels, white_once
from pipeline.avatar.shading import arriving_light, every_light, shade_diffuse, shade_harmonics, shade_matte
from pipeline.avatar.shadow_net import ShadowNet
from pipeline.avatar.spec import AvatarSpec
from pipeline.avatar.texel_parameters import START_AMBIENT, TexelParameters
from pipeline.eyes.eye_fit import FittedEye
from pipeline.geometry.rotations import matrix_from_quaternion, multiply_quaternions
from pipeline.geometry.texels import Atlas
from pipeline.lighting.bounces import bounced_irradiance
from pipeline.lighting.distant import LIGHTS_THAT_PAY, gather_distant
from pipeline.lighting.lobes import unit
from pipeline.lighting.zonal import gather_light


class LitTexels(TexelParameters):
    """Parameters of every texel, and what places and lights them for a pose and a light.

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
            if self.spec.eyes and self.eyes.lit_apart:
                frame["harmonics"] = frame["harmonics"].index_copy(0, *inputs.eye_light)
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
        transfer, degrees = (frame["transfer_color"], frame.get("transfer_mono")), self.spec.degrees
        if self.spec.shading in ("harmonics", "linear"):
            return shade_harmonics(self.albedo, *transfer, frame["harmonics"][:, : degrees**2])
        if not (self.spec.near_field or self.spec.traced) and len(lights[0]) >= LIGHTS_THAT_PAY:
            return shade_diffuse(self.albedo, *transfer, gather_distant(axes, inputs.world_light[: degrees**2]))
        return shade_diffuse(self.albedo, *transfer, gather_light(frame["means"], axes, *lights, degrees))

    def shade_indirect(self, frame: dict, inputs: FrameInputs) -> Float[Tensor, "texels 3"]:
        """Light by way of other surfaces. What these send is taken as it is: no gradient goes back along the bounce."""
        if self.spec.indirect == "ambient":
            sent = arriving_light(frame["means"].detach(), frame["light_positions"], frame["intensities"])
            return self.albedo * self.ambient / torch.pi * sent
        source = frame["diffuse"].detach().clamp_min(0)
        if self.spec.shadow_net:
            source = source * frame["shadow"].detach()[:, None]
        return self.albedo / torch.pi * bounced_irradiance(source, inputs.bounces)
