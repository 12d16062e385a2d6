"""The networks of RFGCA 3, 4 and 14 together: additions for pose and view.

    l_b, l_f = E(K_b, K_f)                      body and face points, each moved by its root's inverse
    dt, dR, s, o, z, dn = D_ci(l_b, l_f)        does not know the camera
    v = D_cv(l_b, l_f, w_o)                     w_o in the frame of each Gaussian

All that is added starts at zero: a new avatar with networks is the avatar without them.
"""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.prepared import Decoded, Surface, ViewedParameters
from pipeline.avatar.networks.decoders import PoseDecoder, ViewDecoder
from pipeline.avatar.networks.pose_encoder import PoseCode
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import POSED, TexelParameters
from pipeline.geometry.texels import Atlas
from pipeline.lighting.lobes import unit


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
        self.code = PoseCode(atlas, spec)
        sizes, posed = (atlas, self.code.size, spec.decoder_channels), parameters.named(POSED)
        self.pose = PoseDecoder(*sizes, posed, {"offset": spacing_m}) if spec.pose_decoder else None
        self.view = ViewDecoder(*sizes) if spec.view_decoder else None

    def decode(self, parameters: TexelParameters, inputs: FrameInputs, **_: object) -> Decoded:
        """Put the texels' parameters in the pose of a frame, and prepare D_cv for its cameras."""
        code = self.code(inputs.record.vertices)
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
