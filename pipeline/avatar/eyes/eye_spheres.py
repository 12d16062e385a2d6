"""Texels of eyes on two spheres each, which turn with the gaze (RGCA section 3.4)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.eyes.eye_parts import eye_texels
from pipeline.avatar.texels.posed_texels import pose_texels
from pipeline.eyes.eye_fit import FittedEye
from pipeline.eyes.eye_shape import EyeSurface, eye_surface, turn_to
from pipeline.geometry.mesh import unit_or
from pipeline.geometry.rotations import matrix_from_quaternion
from pipeline.geometry.texels import Atlas, any_tangent

MOST_SHIFT_M, MOST_GROWTH, MOST_TURN = 0.002, 0.1, 0.1
"""How far training may move a centre (metres), change a size (in log) and turn an axis (rad): a few times what fits are
off by. The optical axis of an eye is 5 degrees, 0.09 rad, off the line of sight that a gaze means. A cornea of 0.65 of
the eyeball stays smaller than it."""


class EyeSpheres(nn.Module):
    """Spheres of all eyes, which training refines; the order of eyes is that of their names.

    Args:
        atlas: the texels; an eye's are those whose face has all corners in it.
        fitted: eyes in the frame of the template at rest.

    Raises:
        InputError: if an eye names vertices that are not there, or has no texel.
    """

    def __init__(self, atlas: Atlas, fitted: Mapping[str, FittedEye]) -> None:
        super().__init__()
        names = sorted(fitted)
        chosen, eye = eye_texels(atlas, {name: fitted[name].vertices for name in names})
        rest = pose_texels(atlas, atlas.rest_vertices)
        constants = {
            "centers": [fitted[name].center for name in names],
            "axes": [fitted[name].axis for name in names],
            "sizes": [
                (s.radius_m, s.cornea_radius_m, s.cornea_offset_m) for s in (fitted[name].shape for name in names)
            ],
        }
        for name, values in constants.items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32), persistent=False)
        self.register_buffer("chosen", torch.as_tensor(chosen), persistent=False)
        self.register_buffer("eye", torch.as_tensor(eye), persistent=False)
        directions = unit_or(rest.points[chosen] - self.centers[self.eye], self.axes[self.eye])
        self.register_buffer("directions", directions, persistent=False)
        self.register_buffer("tangents", rest.tangent_frames[chosen, :, 0], persistent=False)
        self.fitted, self.parts = dict(fitted), [np.asarray(fitted[name].vertices) for name in names]
        corners = np.isin(atlas.faces, np.concatenate(self.parts))
        self.skin_faces = atlas.faces[~corners.all(1)].astype(np.int64)
        self.shift, self.growth, self.turn = (nn.Parameter(torch.zeros(len(names), 3)) for _ in range(3))

    def refined(self) -> tuple[Float[Tensor, "eyes 3"], Float[Tensor, "eyes 3"], Float[Tensor, "eyes 3 3"]]:
        """Centres, sizes (r_e, r_c, d) in metres, and turns of the axes, as training has them.

        The turns are the same for all gazes.
        """
        half = MOST_TURN / 2 * torch.tanh(self.turn)
        correction = matrix_from_quaternion(torch.cat([torch.ones_like(half[:, :1]), half], -1))
        centers = self.centers + MOST_SHIFT_M * torch.tanh(self.shift)
        return centers, self.sizes * torch.exp(MOST_GROWTH * torch.tanh(self.growth)), correction

    def surface(self, sizes: Float[Tensor, "eyes 3"]) -> EyeSurface:
        """Texels on eyes at rest, relative to their centres."""
        return eye_surface(self.directions, self.axes[self.eye], *sizes[self.eye].unbind(-1))

    def placed(
        self, head: Float[Tensor, "3 4"], gaze: Float[Tensor, "eyes 3"]
    ) -> tuple[Float[Tensor, "eyes 3"], Float[Tensor, "eyes 3"], Float[Tensor, "eyes 3 3"]]:
        """Sizes of the eyes, their centres in the world (metres), and their turns from rest.

        Args:
            head: [R | t], head from world.
            gaze: directions in the head's frame.
        """
        centers, sizes, correction = self.refined()
        turns = head[:, :3].T @ turn_to(self.axes, gaze) @ correction
        return sizes, (centers - head[:, 3]) @ head[:, :3], turns

    def pose(
        self, head: Float[Tensor, "3 4"], gaze: Float[Tensor, "eyes 3"]
    ) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3 3"]]:
        """Points of the eye texels (metres) and their frames in the world; see `placed`."""
        sizes, places, turns = self.placed(head, gaze)
        surface = self.surface(sizes)
        normal = surface.normals
        across = self.tangents - (self.tangents * normal).sum(-1, keepdim=True) * normal
        tangent = unit_or(across, any_tangent(normal.detach()))
        frames = torch.stack([tangent, torch.linalg.cross(normal, tangent), normal], -1)
        turn = turns[self.eye]
        return (turn @ surface.points[..., None])[..., 0] + places[self.eye], turn @ frames
