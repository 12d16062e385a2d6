"""The networks of a head together (RGCA 3, 4, 9): the same place in an avatar as those of RFGCA in `networks`.

    z ~ E(V, T)                                 an expression, see `pipeline.avatar.expression_vae`
    V' = D_v(z)                                 what the Gaussians sit on
    dt, dR, s, o, d_c, d_m, sigma = D_ci(z)     does not know the camera
    dn, v = D_cv(z, w_o)                        w_o as seen from the middle of the head, in its frame

All that D_ci and D_cv add starts at zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.decoders import FIRST_SIDE, AtlasDecoder, PoseDecoder
from pipeline.avatar.expression_vae import Expression, Latent
from pipeline.avatar.light_linear import LightLinearDecoder
from pipeline.avatar.pose import FrameInputs, PosedTexels, pose_texels
from pipeline.avatar.pose_encoder import linear
from pipeline.avatar.spec import AvatarSpec
from pipeline.geometry.texels import Atlas
from pipeline.lighting.environment_sh import COEFFICIENTS
from pipeline.lighting.lobes import unit

VIEW_FEATURES = 8
"""Numbers that a view direction becomes, the same at all texels (RGCA supplement A)."""

LARGEST_FACTOR = 10.0
"""What a code makes of a texel's scales and roughness: up to so many times more or less. A code far outside of what was
trained on then still gives Gaussians of some size."""


class HeadNetworks(nn.Module):
    """Encoder and decoders, of these only what `AvatarSpec` asks for.

    Args:
        atlas: the texels.
        parameters: their own, by name, that a code may change.
        spacing_m: a texel's size, see `pipeline.avatar.body_networks`.
    """

    def __init__(self, atlas: Atlas, spec: AvatarSpec, parameters: Mapping[str, Tensor], spacing_m: float) -> None:
        super().__init__()
        self.atlas, self.spec, self.spacing_m = atlas, spec, spacing_m
        self.expression = Expression(atlas, spec)
        sizes = (atlas, spec.code_size, spec.decoder_channels)
        bounds = {name: math.log(LARGEST_FACTOR) for name in ("log_scale", "log_roughness") if name in parameters}
        self.decoder = PoseDecoder(*sizes, parameters, {"offset": spacing_m}, bounds)
        self.outputs = view_outputs(spec)
        if self.outputs:
            self.direction = linear(3, VIEW_FEATURES)
            self.view = AtlasDecoder(*sizes, sum(self.outputs.values()), starts_at_zero=True, beside=VIEW_FEATURES)
        if spec.shading == "linear":
            self.direction = linear(3, VIEW_FEATURES)
            self.light = LightLinearDecoder(*sizes, beside=VIEW_FEATURES)
        self.register_buffer("corners", torch.as_tensor(atlas.corners).long(), persistent=False)
        self.register_buffer("shares", torch.as_tensor(atlas.barycentric)[..., None], persistent=False)
        self.register_buffer("rest", torch.as_tensor(atlas.rest_vertices), persistent=False)

    def decode(
        self, parameters: Mapping[str, Tensor], inputs: FrameInputs,
        noise: Float[Tensor, " code"] | None = None, code: Float[Tensor, " code"] | None = None,
    ) -> dict:  # fmt: skip
        """The texels' parameters with an expression, and where it puts them.

        Args:
            parameters: as all expressions share them.
            inputs: a frame: the head's motion, and vertices and texture to encode.
            noise: standard normal numbers to draw z with; not given: its mean.
            code: z itself, in place of what the encoder says.
        """
        frame = dict(parameters)
        if code is None:
            frame["latent"] = self.encode(inputs)
            code = frame["latent"].mean if noise is None else frame["latent"].sample(noise)
        frame["decoded_vertices"] = self.expression.vertices(code)
        frame |= {name: parameters[name] + added for name, added in self.decoder(code).items()}
        return frame | {"code": code, "head": inputs.head_from_world, "posed": self.place(frame, inputs)}

    def encode(self, inputs: FrameInputs) -> Latent:
        """E(V, T)."""
        return self.expression.encode(self.tracked(inputs), inputs.texture)

    def tracked(self, inputs: FrameInputs) -> Float[Tensor, "vertices 3"]:
        """V, metres in the head's frame; rigid tracking knows no expression."""
        return self.rest if self.spec.anchors == "rigid" else inputs.local_vertices

    def place(self, frame: Mapping, inputs: FrameInputs) -> PosedTexels:
        """The anchors. Decoded ones learn from pictures where they are; how they lie is taken as it is."""
        if self.spec.anchors == "tracked":
            return inputs.posed
        local = self.rest if self.spec.anchors == "rigid" else frame["decoded_vertices"]
        motion = inputs.head_from_world
        world = (local - motion[:, 3]) @ motion[:, :3]
        posed = pose_texels(self.atlas, world.detach().cpu().numpy(), world.device)
        return PosedTexels((world[self.corners] * self.shares).sum(1), posed.frames, posed.quaternions)

    def viewed(self, frame: Mapping, center: Float[Tensor, " 3"]) -> dict[str, Float[Tensor, "texels *_"]]:
        """What a camera adds in a prepared frame, by name; see `view_outputs`."""
        if not self.outputs:
            return {}
        added = self.view(frame["code"], self.beside(frame, center)).split(list(self.outputs.values()), -1)
        return {name: part.squeeze(-1) for name, part in zip(self.outputs, added, strict=True)}

    def linear_color(self, frame: Mapping, center: Float[Tensor, " 3"]) -> Float[Tensor, "texels 3"]:
        """What a camera sees of the frame's light through the network that is linear in it."""
        return self.light(frame["code"], self.beside(frame, center), frame["head_light"])

    def beside(self, frame: Mapping, center: Float[Tensor, " 3"]) -> Float[Tensor, "features 8 8"]:
        """Features of the direction from the middle of the head to a camera, the same at all texels."""
        motion = frame["head"]
        toward = unit(motion[:, :3] @ center + motion[:, 3] - self.expression.middle.mean(0))
        return self.direction(toward)[:, None, None].expand(-1, FIRST_SIDE, FIRST_SIDE)


def view_outputs(spec: AvatarSpec) -> dict[str, int]:
    """Numbers per texel that each camera has of its own: what is added to the logit of the specular visibility, to the
    normal's offset (RGCA 9), or the harmonics of what is specular (row "EyeNeRF")."""
    outputs = {}
    if spec.lobe:
        outputs["visibility"] = 1
    if spec.viewed_normals:
        outputs["normal_offset"] = 3
    if spec.viewed_harmonics:
        outputs["specular_harmonics"] = COEFFICIENTS
    return outputs
