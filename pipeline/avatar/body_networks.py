"""The networks of RFGCA 3, 4 and 14 together: what pose and view add to the parameters of every texel.

    l_b, l_f = E(K_b, K_f)                      body and face points, each moved by its root's inverse
    dt, dR, s, o, z, dn = D_ci(l_b, l_f)        does not know the camera
    v = D_cv(l_b, l_f, w_o)                     w_o in the frame of each Gaussian

All that is added starts at zero: a new avatar with networks is the avatar without them.
"""

from __future__ import annotations

from collections.abc import Mapping

from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.decoders import PoseDecoder, ViewDecoder
from pipeline.avatar.pose import FrameInputs
from pipeline.avatar.pose_encoder import PoseCode
from pipeline.avatar.spec import AvatarSpec
from pipeline.geometry.texels import Atlas
from pipeline.lighting.lobes import unit

POSED = ("offset", "rotation", "log_scale", "opacity", "transfer_color", "transfer_mono", "normal_offset")
"""Parameters of a texel that a pose may change (RFGCA 4), if the avatar has them; albedo and roughness never do."""


class Networks(nn.Module):
    """Encoder and decoders, of these only what `AvatarSpec` asks for.

    Args:
        atlas: the texels.
        parameters: their own, by the names of `POSED`.
        spacing_m: a texel's size. A pose moves a Gaussian by about as much: in metres a step of the optimiser would be
            too long.
    """

    def __init__(self, atlas: Atlas, spec: AvatarSpec, parameters: Mapping[str, Tensor], spacing_m: float) -> None:
        super().__init__()
        self.code = PoseCode(atlas, spec)
        sizes = (atlas, self.code.size, spec.decoder_channels)
        self.pose = PoseDecoder(*sizes, parameters, {"offset": spacing_m}) if spec.pose_decoder else None
        self.view = ViewDecoder(*sizes) if spec.view_decoder else None

    def decode(self, parameters: Mapping[str, Tensor], inputs: FrameInputs) -> dict[str, Tensor]:
        """The texels' parameters in the pose of a frame, and what its cameras share of D_cv."""
        code, posed = self.code(inputs.record.vertices), dict(parameters)
        if self.pose is not None:
            posed |= {name: parameters[name] + added for name, added in self.pose(code).items()}
        if self.view is not None:
            posed["view_features"] = self.view.prepare(code)
        return posed

    def viewed(self, frame: Mapping[str, Tensor], center: Float[Tensor, " 3"]) -> dict[str, Float[Tensor, " texels"]]:
        """What a camera adds in a prepared frame: to the logit of the specular visibility."""
        if self.view is None:
            return {}
        # Where a Gaussian is and how it lies is decided by what it looks like, not by how far it reflects.
        toward = unit(center - frame["means"].detach())
        directions = (frame["axes"].detach().mT @ toward[..., None])[..., 0]
        return {"visibility": self.view(frame["view_features"], directions)}
