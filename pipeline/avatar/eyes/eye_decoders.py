"""Decoders of eyes: gaze, pose of the head and view to parameters of their texels (RGCA 10).

    R, s, o, d_c, d_m, sigma = D_ei(e, h_p, h_r)         rho, v = D_ev(e, h_p, h_r, w_o)

Each eye has decoders of its own, which decode a map of its front: the middle of the map is where the eye looks at rest,
its border a right angle away from there. Both read a map of 4 x 4 (RGCA supplement A): 16 channels of the gaze, the
head's position (metres) and rotation vector, 3 each, and the share of the outside that the lids leave open; D_ev also 8
of the view. All that is decoded is added to what each texel has of its own, and starts at zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation
from torch import Tensor, nn
from torch.nn.functional import leaky_relu

from pipeline.avatar.networks.decoders import Additions, Upsampling, bilinear_at, draw
from pipeline.avatar.networks.gaze_features import GAZE_CHANNELS
from pipeline.avatar.networks.head_networks import LARGEST_FACTOR, VIEW_FEATURES
from pipeline.avatar.networks.pose_encoder import SLOPE, linear
from pipeline.geometry.texels import any_tangent

EYE_SIDE = 4
"""Texels per side of the map that an eye's decoders read (RGCA supplement A)."""

FRONT = math.pi / 2
"""Angle from the axis of the eye at rest to the border of its map; skin covers what lies beyond."""

FEATURES = GAZE_CHANNELS + 3 + 3 + 1

MOST_GAIN = 3.0
"""Log of how much brighter or darker a texel may become from another side: between pupil (0.01) and iris (0.2)."""


class EyeDecoders(nn.Module):
    """D_ei and D_ev of all eyes.

    Args:
        directions: of the eye texels at rest, from the middle of their eye, unit length.
        eye: number of each texel's eye.
        axes: where the eyes look at rest.
        parameters: of the eye texels, those that gaze and pose of the head may change.
        channels: of the maps between the layers.
    """

    def __init__(
        self, directions: Float[Tensor, "n 3"], eye: Int[Tensor, " n"], axes: Float[Tensor, "eyes 3"],
        parameters: Mapping[str, Tensor], channels: Sequence[int],
    ) -> None:  # fmt: skip
        super().__init__()
        limit = math.log(LARGEST_FACTOR)
        bounds = {name: limit for name in ("log_scale", "log_roughness") if name in parameters}
        self.additions, self.count = Additions(parameters, {}, bounds), len(directions)
        places = front_places(directions, axes[eye])
        self.rows = [torch.nonzero(eye == number)[:, 0] for number in range(len(axes))]
        cells = [(places[rows.cpu()] * EYE_SIDE).astype(int).clip(0, EYE_SIDE - 1) for rows in self.rows]
        self.cells = [torch.as_tensor(cell[:, 0] * EYE_SIDE + cell[:, 1]) for cell in cells]
        self.gaze = nn.ModuleList(linear(3, GAZE_CHANNELS * EYE_SIDE**2) for _ in self.rows)
        self.direction = nn.ModuleList(linear(3, VIEW_FEATURES) for _ in self.rows)
        outputs = sum(self.additions.widths)
        at = [places[rows.cpu()] for rows in self.rows]
        self.fixed = nn.ModuleList(FrontDecoder(FEATURES, channels, outputs, place) for place in at)
        self.viewed = nn.ModuleList(FrontDecoder(FEATURES + VIEW_FEATURES, channels, 4, place) for place in at)

    def features(
        self, gaze: Float[Tensor, "eyes 3"], head_from_world: Float[Tensor, "3 4"], opening: Float[Tensor, " n"]
    ) -> Float[Tensor, "eyes 23 4 4"]:
        """Maps that both decoders read.

        Args:
            gaze: in the head's frame; none is told where it is no direction.
            head_from_world: [R | t], metres.
            opening: share of the outside that each eye texel sees past the lids.
        """
        length = gaze.norm(dim=-1, keepdim=True)
        gaze = torch.where(torch.isfinite(length) & (length > 0), gaze, torch.zeros_like(gaze))
        R, t = head_from_world[:, :3].double().cpu().numpy(), head_from_world[:, 3].double().cpu().numpy()
        pose = np.concatenate([-R.T @ t, Rotation.from_matrix(R.T).as_rotvec()])
        repeated = torch.as_tensor(pose).to(gaze)[:, None, None].expand(-1, EYE_SIDE, EYE_SIDE)
        maps = []
        for layer, direction, rows, cells in zip(self.gaze, gaze, self.rows, self.cells, strict=True):
            looks = leaky_relu(layer(direction), SLOPE).reshape(-1, EYE_SIDE, EYE_SIDE)
            own, cells = opening[rows.to(opening.device)], cells.to(opening.device)
            share, count = opening.new_zeros(2, EYE_SIDE**2)
            share = share.index_add(0, cells, own)
            count = count.index_add(0, cells, torch.ones_like(own))
            mask = (share / count.clamp_min(1)).reshape(1, EYE_SIDE, EYE_SIDE)
            maps.append(torch.cat([looks, repeated, mask]))
        return torch.stack(maps)

    def decode(self, features: Float[Tensor, "eyes 23 4 4"]) -> dict[str, Float[Tensor, " n *_"]]:
        """D_ei: additions to parameters of the eye texels."""
        parts = [decoder(own) for decoder, own in zip(self.fixed, features, strict=True)]
        return self.additions.split(self.gathered(parts))

    def view(
        self, features: Float[Tensor, "eyes 23 4 4"], toward: Float[Tensor, "eyes 3"]
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, " n"]]:
        """D_ev: factors on the albedo, and additions to the logit of the specular visibility.

        Args:
            toward: unit directions from the eyes to a camera, in the head's frame.
        """
        parts = []
        for decoder, layer, own, direction in zip(self.viewed, self.direction, features, toward, strict=True):
            view = leaky_relu(layer(direction), SLOPE)[:, None, None].expand(-1, EYE_SIDE, EYE_SIDE)
            parts.append(decoder(torch.cat([own, view])))
        values = self.gathered(parts)
        return torch.exp(MOST_GAIN * torch.tanh(values[:, :3] / MOST_GAIN)), values[:, 3]

    def gathered(self, parts: Sequence[Float[Tensor, "_ outputs"]]) -> Float[Tensor, "n outputs"]:
        """Values of each eye's texels, in the order of all eye texels."""
        rows = torch.cat(self.rows).to(parts[0].device)
        return parts[0].new_zeros(self.count, parts[0].shape[1]).index_copy(0, rows, torch.cat(list(parts)))


class FrontDecoder(nn.Module):
    """Transposed convolutions from a map of 4 x 4, and the texels' values on the last.

    Args:
        inputs, outputs: channels of the first map and of the last.
        channels: of those between.
        places: of the texels on the map (down, across, 0..1).
    """

    def __init__(self, inputs: int, channels: Sequence[int], outputs: int, places: Float[np.ndarray, "n 2"]) -> None:
        super().__init__()
        widths = [inputs, *channels, outputs]
        self.layers = nn.ModuleList(
            Upsampling(read, passed, EYE_SIDE * 2**layer, is_last=layer == len(widths) - 1)
            for layer, (read, passed) in enumerate(pairwise(widths), 1)
        )
        nearest, weights = bilinear_at(places, EYE_SIDE * 2 ** len(self.layers))
        self.register_buffer("nearest", torch.as_tensor(nearest), persistent=False)
        self.register_buffer("weights", torch.as_tensor(weights), persistent=False)

    def forward(self, features: Float[Tensor, "inputs 4 4"]) -> Float[Tensor, "n outputs"]:
        """Values of the texels."""
        x = self.layers[0](features[None])
        for layer in self.layers[1:]:
            x = layer(leaky_relu(x, SLOPE))
        return draw(x[0], self.nearest, self.weights)


def front_places(directions: Float[Tensor, "n 3"], axes: Float[Tensor, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """Places of directions on a map about an axis, down and across, in 0..1.

    As far from the middle as they are from the axis (azimuthal equidistant projection), at most to the border.
    """
    right = any_tangent(axes)
    down = torch.linalg.cross(axes, right)
    x, y = (directions * right).sum(-1), (directions * down).sum(-1)
    angle = torch.atan2(torch.hypot(x, y), (directions * axes).sum(-1))
    around = torch.atan2(y, x)
    reach = 0.5 * (angle / FRONT).clamp_max(1)
    return (0.5 + torch.stack([reach * around.sin(), reach * around.cos()], -1)).double().cpu().numpy()
