"""The explicit eyes of an avatar: Gaussians frozen on two spheres per eye that turn with the gaze (RGCA section 3.4).

Position and normal of an eye's Gaussians follow from nine numbers per eye, which training refines, and from where the
eye looks; their albedo depends on the direction they are seen from, since the iris is seen through a cornea that
refracts. What eyes mirror is traced per pixel (`eye_glints`), and so is what of the outside they see past the lids.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.eyes.eye_albedo import EyeAlbedo
from pipeline.avatar.eyes.eye_glints import mirror_layer
from pipeline.avatar.eyes.eye_texels import eye_texels
from pipeline.avatar.eyes.gaze import gaze_of
from pipeline.avatar.eyes.lid_occlusion import light_past_lids, trace_lids
from pipeline.avatar.pose import FrameInputs, PosedTexels, pose_texels, white_once
from pipeline.avatar.shading import start_harmonics
from pipeline.eyes.eye_fit import FittedEye
from pipeline.eyes.eye_shape import EyeSurface, eye_surface, turn_to
from pipeline.geometry.mesh import unit_or
from pipeline.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from pipeline.geometry.texels import Atlas, any_tangent
from pipeline.lighting.lobes import unit

MOST_SHIFT_M, MOST_GROWTH, MOST_TURN = 0.002, 0.1, 0.1
"""How far training may move a centre (metres), change a size (in log) and turn an axis (rad): a few times what fits are
off by. The optical axis of an eye is 5 degrees, 0.09 rad, off the line of sight that a gaze means. A cornea of 0.65 of
the eyeball stays smaller than it."""

START_ROUGHNESS = 0.05
START_VISIBILITY = 0.39
"""A wet surface, nearly a mirror. A dielectric mirrors F0 = 0.04 of a light, which the lobe spreads over 2 pi sigma^2
of solid angle: v C / sigma = F0 / (2 pi sigma^2) gives v = 0.39 for sigma = 0.05."""

FILL_MM = 0.1
"""Scales of eye Gaussians that RGCA 16 lets pass, for texels of a sixth of a millimetre."""


class Eyes(nn.Module):
    """All eyes of an avatar; the order of eyes is that of their names.

    Args:
        atlas: the texels; an eye's are those whose face has all corners in it.
        fitted: eyes in the frame of the template at rest.
        scales: start scales of all Gaussians, metres: no eye Gaussian is asked to be smaller.

    Raises:
        InputError: if an eye names vertices that are not there, or has no texel.
    """

    def __init__(self, atlas: Atlas, fitted: Mapping[str, FittedEye], scales: Float[Tensor, "texels 3"]) -> None:
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
        self.register_buffer("tangents", rest.frames[chosen, :, 0], persistent=False)
        self.register_buffer("start_scales", scales[chosen].clone(), persistent=False)
        self.fitted, self.parts = dict(fitted), [np.asarray(fitted[name].vertices) for name in names]
        corners = np.isin(atlas.faces, np.concatenate(self.parts))
        self.skin_faces = atlas.faces[~corners.all(1)].astype(np.int64)
        self.shift, self.growth, self.turn = (nn.Parameter(torch.zeros(len(names), 3)) for _ in range(3))
        self.albedo = EyeAlbedo(len(chosen))
        self.lit_apart = self.shadow_learned = False

    def refined(self) -> tuple[Float[Tensor, "eyes 3"], Float[Tensor, "eyes 3"], Float[Tensor, "eyes 3 3"]]:
        """Centres, sizes (r_e, r_c, d) in metres, and turns of the axes that are the same for all gazes."""
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
        """Sizes of the eyes, their centres in the world (metres), and their turns from rest to there.

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

    def place(self, frame: dict, posed: PosedTexels, inputs: FrameInputs) -> tuple[dict, PosedTexels]:
        """The frame's parameters with those of eye texels frozen, and all texels posed, those of eyes on their spheres.

        How a disc lies says little about an eye: its quaternion has no gradient, its point and its normal have.
        """
        motion = inputs.head_from_world, gaze_of(inputs, self.parts, self.axes)
        (sizes, places, turns), (points, frames) = self.placed(*motion), self.pose(*motion)
        quaternions = quaternion_from_matrix(frames.detach().double().cpu().numpy())
        rows = (points, frames, torch.as_tensor(quaternions).to(points))
        old = (posed.points, posed.frames, posed.quaternions)
        placed = PosedTexels(*(a.index_copy(0, self.chosen, b) for a, b in zip(old, rows, strict=True)))
        if inputs.lids is None:
            inputs.lids = trace_lids(inputs.mesh[0], self.skin_faces, points.detach(), frames.detach())
            if self.lit_apart:
                own = points.detach(), frames.detach()[..., 2], turns.detach()[self.eye]
                skin = None if self.shadow_learned else inputs.lids.skin
                light = light_past_lids(skin, *own, inputs.lights[0], white_once(inputs.lights[1]))
                inputs.eye_light = self.chosen, light
        frozen = {"offset": (0.0, 0.0, 0.0), "rotation": (1.0, 0.0, 0.0, 0.0), "normal_offset": (0.0, 0.0, 0.0)}
        corneas = places + sizes[:, 2:] * (turns @ self.axes[..., None])[..., 0]
        balls = torch.cat([places, corneas]), torch.cat([sizes[:, 0], sizes[:, 1]])
        frame = frame | {"posed": placed, "eye_turns": turns, "eye_balls": balls, "lids": inputs.lids}
        for name in frozen.keys() & frame.keys():
            frame[name] = frame[name].index_copy(0, self.chosen, points.new_tensor(frozen[name]).repeat(len(points), 1))
        return frame, placed

    def split_mirrors(
        self, frame: Mapping[str, Tensor], roughness: Float[Tensor, " texels"], visibility: Float[Tensor, " texels"]
    ) -> tuple[Float[Tensor, " texels"], Float[Tensor, "texels 2"]]:
        """Specular visibility without the eyes, and the layer of what the eyes mirror, if lids are not shut over it."""
        seen = mirror_layer(roughness[self.chosen], visibility[self.chosen] * (frame["lids"].opening > 0))
        layer = seen.new_zeros(len(visibility), 2).index_copy(0, self.chosen, seen)
        return self.without(visibility), layer

    def without(self, values: Float[Tensor, "texels *_"]) -> Float[Tensor, "texels *_"]:
        """Values of the texels with those of eyes zero."""
        return values.index_fill(0, self.chosen, 0.0)

    def under_lids(self, frame: Mapping[str, Tensor], values: Float[Tensor, "texels *_"]) -> Float[Tensor, "texels *_"]:
        """What of the texels' light passes the lids; all of it, where what came to them had passed already."""
        if self.lit_apart:
            return values
        share = frame["lids"].opening.reshape(-1, *[1] * (values.ndim - 1))
        return values.index_copy(0, self.chosen, values[self.chosen] * share)

    def seen_from(
        self, frame: Mapping[str, Tensor], center: Float[Tensor, " 3"], color: Float[Tensor, "texels 3"]
    ) -> Float[Tensor, "texels 3"]:
        """Diffuse colour with the albedo that the eyes show a camera at `center`."""
        toward = unit(center - frame["means"].detach()[self.chosen])
        inward = (frame["eye_turns"].detach()[self.eye].mT @ toward[..., None])[..., 0]
        return color.index_copy(0, self.chosen, color[self.chosen] * self.albedo(inward))

    @torch.no_grad()
    def start(self, avatar: nn.Module) -> None:
        """Set what eyes start with in an avatar's own parameters: a lobe, and an open transfer, if it has them.

        Where each texel has harmonics of its own light, eyes have those of the light that passes the lids, each lamp by
        itself, in a frame that turns with the eye. Their transfer starts as that of the bare spheres: what lids hide at
        rest would count twice.
        """
        if hasattr(avatar, "log_roughness"):
            avatar.log_roughness[self.chosen] = math.log(START_ROUGHNESS)
            avatar.visibility[self.chosen] = math.log(START_VISIBILITY / (1 - START_VISIBILITY))
        spec = avatar.spec
        self.lit_apart, self.shadow_learned = spec.shading in ("harmonics", "linear") and spec.near_field, spec.shadow
        if self.lit_apart:
            bare = start_harmonics(self.surface(self.sizes).normals, spec.degrees)
            for name, values in zip(("transfer_color", "transfer_mono"), bare, strict=True):
                if values.numel():
                    avatar.get_parameter(name)[self.chosen] = values
                    avatar.get_buffer(f"start_{name}")[self.chosen] = values

    def losses(self, avatar: nn.Module, frame: Mapping[str, Tensor]) -> dict[str, Float[Tensor, ""]]:
        """The terms of RGCA 16, unweighted: scales (mm) no larger than closes the surface, opacity and visibility 1."""
        most = (1e3 * self.start_scales).clamp_min(FILL_MM)
        terms = {
            "eye_scale": torch.relu(1e3 * frame["scales"][self.chosen] - most).square().mean(),
            "eye_opacity": (1 - frame["opacities"][self.chosen]).square().mean(),
        }
        if hasattr(avatar, "visibility"):
            terms["eye_visibility"] = (1 - torch.sigmoid(avatar.visibility[self.chosen])).square().mean()
        return terms
