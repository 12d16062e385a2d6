"""The networks of a head together (RGCA 3, 4, 9).

In the place of those of RFGCA in `body_networks`.

    z ~ E(V, T)                                 an expression, see `pipeline.avatar.networks.expression_vae`
    V' = D_v(z)                                 what the Gaussians sit on
    dt, dR, s, o, d_c, d_m, sigma = D_ci(z, e)  does not know the camera
    dn, v = D_cv(z, e, w_o)                     w_o as seen from the middle of the head, in its frame

e, where the eyes look, is told with `gaze_features`.

All that D_ci and D_cv add starts at zero.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from types import MappingProxyType

import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import Decoded, HeadState, Latent, Surface, ViewedParameters
from pipeline.avatar.networks.decoders import FIRST_SIDE, AtlasDecoder, PoseDecoder
from pipeline.avatar.networks.expression_vae import Expression
from pipeline.avatar.networks.gaze_features import GAZE_CHANNELS, GazeFeatures
from pipeline.avatar.networks.light_linear import LightLinearDecoder
from pipeline.avatar.networks.pose_encoder import linear
from pipeline.avatar.networks.texel_harmonics import TexelHarmonics
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels, pose_texels
from pipeline.avatar.texels.texel_parameters import EXPRESSED, PLACED, TexelParameters
from pipeline.eyes.eye_fit import FittedEye
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
        spacing_m: a texel's size, see `pipeline.avatar.networks.body_networks`.
        eyes: of eyes.json, by name, for `gaze_features`.
        boxes: the texels that boxes stand on, whose places are decoded there; None: a Gaussian stands on each texel.
    """

    def __init__(
        self, atlas: Atlas, spec: AvatarSpec, parameters: TexelParameters, spacing_m: float,
        eyes: Mapping[str, FittedEye] = MappingProxyType({}), boxes: Atlas | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.atlas, self.anchors, self.texel_frame = atlas, spec.anchors, spec.texel_frame
        self.gaze = GazeFeatures(atlas, eyes) if spec.gaze_features else None
        looks = GAZE_CHANNELS if spec.gaze_features else 0
        self.expression = Expression(atlas, spec)
        sizes, network = (atlas, spec.code_size, spec.decoder_channels), (spec.code_size, spec.decoder_channels)
        names = [name for name in EXPRESSED if boxes is None or name not in PLACED]
        plain = spec.last_layers == "plain"
        self.decoder = PoseDecoder(*sizes, *additions(parameters, names, spacing_m), looks, plain)
        self.places = None
        if boxes is not None:
            self.places = PoseDecoder(boxes, *network, *additions(parameters, PLACED, spacing_m), looks, plain)
        self.texels = None
        if spec.specular_model == "tangent_harmonics":
            self.texels = TexelHarmonics(atlas.texel_count, spec.code_size)
        self.outputs = view_outputs(spec)
        if self.outputs:
            self.direction = linear(3, VIEW_FEATURES)
            sees = looks + VIEW_FEATURES
            self.view = AtlasDecoder(*sizes, sum(self.outputs.values()), True, beside=sees, plain=plain)
        if spec.shading == "linear":
            self.direction = linear(3, VIEW_FEATURES)
            self.light = LightLinearDecoder(*sizes, beside=looks + VIEW_FEATURES, plain=plain)
        self.register_buffer("corners", torch.as_tensor(atlas.corners).long(), persistent=False)
        self.register_buffer("shares", torch.as_tensor(atlas.barycentric)[..., None], persistent=False)
        self.register_buffer("rest", torch.as_tensor(atlas.rest_vertices), persistent=False)

    def decode(
        self, parameters: TexelParameters, inputs: FrameInputs,
        noise: Float[Tensor, " code"] | None = None, code: Float[Tensor, " code"] | None = None,
    ) -> Decoded:  # fmt: skip
        """Put the texels' parameters in an expression, and anchor them where it puts them.

        Args:
            parameters: as all expressions share them.
            inputs: a frame: the head's motion, and vertices and texture to encode.
            noise: standard normal numbers to draw z with; not given: its mean.
            code: z itself, in place of what the encoder says.
        """
        latent = None
        if code is None:
            latent = self.encode(inputs)
            code = latent.mean if noise is None else latent.sample(noise)
        gaze = None if self.gaze is None else self.gaze.of_frame(inputs)
        head = HeadState(code, latent, self.expression.vertices(code), inputs.head_from_world, gaze)
        parameters = parameters.plus(self.decoder(code, gaze))
        if self.places is not None:
            parameters = parameters.plus(self.places(code, gaze))
        return Decoded(parameters, self.place(head, inputs), head=head)

    def encode(self, inputs: FrameInputs) -> Latent:
        """E(V, T)."""
        return self.expression.encode(self.tracked(inputs), inputs.texture)

    def tracked(self, inputs: FrameInputs) -> Float[Tensor, "vertices 3"]:
        """V, metres in the head's frame; rigid tracking knows no expression."""
        return self.rest if self.anchors == "rigid" else inputs.local_vertices

    def place(self, head: HeadState, inputs: FrameInputs) -> PosedTexels:
        """Anchor the texels. Decoded anchors learn from pictures where they are; how they lie is taken as it is."""
        motion = inputs.head_from_world
        turn = motion[:, :3].T if self.texel_frame == "head" else None
        if self.anchors == "tracked":
            return replace(inputs.posed, world_from_head=turn)
        local = self.rest if self.anchors == "rigid" else head.decoded_vertices
        world = (local - motion[:, 3]) @ motion[:, :3]
        posed = pose_texels(self.atlas, world.detach().cpu().numpy(), world.device)
        points = (world[self.corners] * self.shares).sum(1)
        return PosedTexels(points, posed.tangent_frames, posed.quaternions, turn)

    def viewed(self, decoded: Decoded, surface: Surface, center: Float[Tensor, " 3"]) -> ViewedParameters:
        """Decode what a camera at `center` adds; see `view_outputs`."""
        if not self.outputs:
            return ViewedParameters()
        head = decoded.head
        added = self.view(head.code, self.beside(head, center)).split(list(self.outputs.values()), -1)
        return ViewedParameters(
            **{name: part.squeeze(-1) for name, part in zip(self.outputs, added, strict=True)}
        )  # fmt: skip

    def linear_color(
        self, head: HeadState, center: Float[Tensor, " 3"], light: Float[Tensor, "81 channels"]
    ) -> Float[Tensor, "texels 3"]:
        """Decode a camera's view of the light through the network that is linear in it.

        The light is in the head's frame.
        """
        return self.light(head.code, self.beside(head, center), light)

    def beside(self, head: HeadState, center: Float[Tensor, " 3"]) -> Float[Tensor, "features 8 8"]:
        """Features of the gaze, if it is told, and of the direction from the head to a camera.

        The direction is that from the middle of the head; its features are the same at all texels.
        """
        motion = head.head_from_world
        toward = unit(motion[:, :3] @ center + motion[:, 3] - self.expression.middle.mean(0))
        view = self.direction(toward)[:, None, None].expand(-1, FIRST_SIDE, FIRST_SIDE)
        return view if head.gaze is None else torch.cat([head.gaze, view])


def additions(
    parameters: TexelParameters, names: Collection[str], spacing_m: float
) -> tuple[dict[str, Tensor], dict[str, float], dict[str, float]]:
    """Parameters of these names, units and bounds of what is added to them; see `Additions`."""
    expressed = parameters.named(names)
    bounds = {name: math.log(LARGEST_FACTOR) for name in ("log_scale", "log_roughness") if name in expressed}
    return expressed, {"offset": spacing_m}, bounds


def view_outputs(spec: AvatarSpec) -> dict[str, int]:
    """Numbers per texel that the view decoder has to say, by the names of `ViewedParameters`."""
    outputs = {}
    if spec.lobe:
        outputs["visibility"] = 1
    if spec.viewed_normals:
        outputs["normal_offset"] = 3
    if spec.viewed_harmonics:
        outputs["specular_harmonics"] = COEFFICIENTS
    return outputs
