"""The networks of RFGCA 3, 4 and 14 together: additions for pose and view.

    l_b, l_f = E(K_b, K_f)                      body and face points, each moved by its root's inverse
    dt, dR, s, o, z, dn = D_ci(l_b, l_f)        does not know the camera
    v = D_cv(l_b, l_f, w_o)                     w_o in the frame of each Gaussian

All that is added starts at zero: a new avatar with networks is the avatar without them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor, nn

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import Decoded, Surface, ViewedParameters
from pipeline.avatar.networks.decoders import PoseDecoder, ViewDecoder
from pipeline.avatar.networks.pose_encoder import PoseCode
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import GEOMETRY, POSED, TexelParameters
from pipeline.geometry.texels import Atlas
from pipeline.lighting.lobes import unit


class GivenPose(nn.Module):
    """Geometry that another avatar decodes from a pose, as it had learned to.

    Args:
        parameters: of the geometry, for their shapes.
        spacing_m: see `BodyNetworks`.
    """

    def __init__(self, atlas: Atlas, spec: AvatarSpec, parameters: Mapping[str, Tensor], spacing_m: float) -> None:
        super().__init__()
        self.code = PoseCode(atlas, spec)
        sizes, units = (atlas, self.code.size, spec.decoder_channels), {"offset": spacing_m}
        self.pose = PoseDecoder(*sizes, parameters, units, plain=spec.last_layers == "plain")
        self.requires_grad_(False)

    def forward(self, vertices: Float32[np.ndarray, "vertices 3"]) -> dict[str, Float[Tensor, " texels *_"]]:
        """Additions to the geometry of texels in a posed template."""
        return self.pose(self.code(vertices))

    def take(self, other: BodyNetworks | GivenPose) -> None:
        """Copy what the networks of another avatar make of the geometry's parameters."""
        self.code.load_state_dict(other.code.state_dict())
        state, additions = other.pose.state_dict(), other.pose.additions
        names = np.repeat(list(additions.shapes), additions.widths)
        kept = torch.as_tensor(np.flatnonzero(np.isin(names, list(self.pose.additions.shapes))))
        last = f"decoder.layers.{len(self.pose.decoder.layers) - 1}.conv."
        # Weights, or their lengths and directions apart, each by output channel.
        self.pose.load_state_dict({k: v[:, kept] if k.startswith(last) else v for k, v in state.items()})


class BodyNetworks(nn.Module):
    """Encoder and decoders, of these only what `AvatarSpec` asks for.

    Args:
        atlas: the texels.
        parameters: their own.
        spacing_m: a texel's size. A pose moves a Gaussian by about as much: in metres a step of the optimiser would be
            too long.
    """

    def __init__(self, atlas: Atlas, spec: AvatarSpec, parameters: TexelParameters, spacing_m: float) -> None:
        super().__init__()
        self.given = self.code = self.pose = self.view = None
        posed = parameters.named(POSED)
        if spec.given_geometry:
            own = {name: tensor for name, tensor in posed.items() if name not in GEOMETRY}
            if spec.given_geometry == "decoded":
                self.given = GivenPose(
                    atlas, spec, {name: posed[name] for name in posed if name in GEOMETRY}, spacing_m
                )
            posed = own
        has_pose = spec.pose_decoder and bool(posed)
        if has_pose or spec.view_decoder:
            self.code = PoseCode(atlas, spec)
            sizes = (atlas, self.code.size, spec.decoder_channels)
            units = {"offset": spacing_m} if "offset" in posed else {}
            self.pose = PoseDecoder(*sizes, posed, units, plain=spec.last_layers == "plain") if has_pose else None
            self.view = ViewDecoder(*sizes) if spec.view_decoder else None

    def decode(self, parameters: TexelParameters, inputs: FrameInputs, **_: object) -> Decoded:
        """Put the texels' parameters in the pose of a frame, and prepare D_cv for its cameras."""
        if self.given is not None:
            parameters = parameters.plus(self.given(inputs.record.vertices))
        code = None if self.code is None else self.code(inputs.record.vertices)
        if self.pose is not None:
            parameters = parameters.plus(self.pose(code))
        return Decoded(parameters, inputs.posed, None if self.view is None else self.view.prepare(code))

    def viewed(self, decoded: Decoded, surface: Surface, center: Float[Tensor, " 3"]) -> ViewedParameters:
        """Decode what a camera at `center` adds to the logit of the specular visibility."""
        if self.view is None:
            return ViewedParameters()
        # Where a Gaussian is and how it lies is decided by what it looks like, not by how far it reflects.
        toward = unit(center - surface.gaussians.means.detach())
        directions = (surface.axes.detach().mT @ toward[..., None])[..., 0]
        return ViewedParameters(visibility=self.view(decoded.view_features, directions))
