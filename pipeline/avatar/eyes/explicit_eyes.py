"""Explicit eyes of an avatar: Gaussians on two spheres per eye (RGCA section 3.4).

They are frozen there, and turn with the gaze.

Position and normal of an eye's Gaussians follow from nine numbers per eye, which training refines, and from where the
eye looks; their albedo depends on the direction they are seen from, since the iris is seen through a cornea that
refracts. What eyes mirror is traced per pixel (`corneal_reflections`), and so is what of the outside they see past the
lids.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.appearance.glossy import GlossySamples
from pipeline.avatar.appearance.transfer import TRANSFER, start_harmonics
from pipeline.avatar.eyes.eye_parts import EyeAlbedo, eye_texels
from pipeline.avatar.eyes.lid_occlusion import light_past_lids, trace_lids
from pipeline.avatar.frames.gaze import frame_gaze
from pipeline.avatar.frames.inputs import FrameInputs, white_once
from pipeline.avatar.frames.prepared import Decoded, LidOcclusion, PosedEyes, PreparedFrame
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels, pose_texels
from pipeline.config.train_avatar import Bound
from pipeline.eyes.eye_fit import FittedEye
from pipeline.eyes.eye_shape import EyeSurface, eye_surface, turn_to
from pipeline.geometry.mesh import unit_or
from pipeline.geometry.rotations import matrix_from_quaternion, multiply_quaternions, quaternion_from_matrix
from pipeline.geometry.texels import Atlas, any_tangent
from pipeline.lighting.lobes import unit
from pipeline.rendering.splat_types import Gaussians

FROZEN = {"offset": (0.0, 0.0, 0.0), "rotation": (1.0, 0.0, 0.0, 0.0), "normal_offset": (0.0, 0.0, 0.0)}
"""Parameters of eye texels that stay as they are."""

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
        self.register_buffer("tangents", rest.tangent_frames[chosen, :, 0], persistent=False)
        self.register_buffer("start_scales", scales[chosen].clone(), persistent=False)
        self.fitted, self.parts = dict(fitted), [np.asarray(fitted[name].vertices) for name in names]
        corners = np.isin(atlas.faces, np.concatenate(self.parts))
        self.skin_faces = atlas.faces[~corners.all(1)].astype(np.int64)
        self.shift, self.growth, self.turn = (nn.Parameter(torch.zeros(len(names), 3)) for _ in range(3))
        self.albedo = EyeAlbedo(len(chosen))
        self.lit_apart = self.shadow_learned = False
        self._traced: WeakKeyDictionary[FrameInputs, tuple[LidOcclusion, Tensor | None]] = WeakKeyDictionary()

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

    def place(self, decoded: Decoded, inputs: FrameInputs) -> tuple[Decoded, PosedEyes]:
        """Freeze the parameters of eye texels, and put these texels on the spheres of their eyes.

        How a disc lies says little about an eye: its quaternion has no gradient, its point and its normal have.
        """
        motion = inputs.head_from_world, frame_gaze(inputs, self.parts, self.axes)
        (sizes, places, turns), (points, frames) = self.placed(*motion), self.pose(*motion)
        lids, harmonics = self.traced(inputs)
        quaternions = quaternion_from_matrix(frames.detach().double().cpu().numpy())
        rows = (points, frames, torch.as_tensor(quaternions).to(points))
        old = (decoded.posed.points, decoded.posed.tangent_frames, decoded.posed.quaternions)
        placed = PosedTexels(*(a.index_copy(0, self.chosen, b) for a, b in zip(old, rows, strict=True)))
        corneas = places + sizes[:, 2:] * (turns @ self.axes[..., None])[..., 0]
        balls = torch.cat([places, corneas]), torch.cat([sizes[:, 0], sizes[:, 1]])
        constants = {name: points.new_tensor(values).repeat(len(points), 1) for name, values in FROZEN.items()}
        if decoded.posed.world_from_head is not None:  # rotations are kept in that frame, not in the sphere's
            placed = replace(placed, world_from_head=decoded.posed.world_from_head)
            constants["rotation"] = in_head(rows[2], decoded.posed.world_from_head)
        frozen = {
            name: tensor.index_copy(0, self.chosen, constants[name])
            for name, tensor in decoded.parameters.named(FROZEN).items()
        }
        parameters = replace(decoded.parameters, **frozen)
        return replace(decoded, parameters=parameters, posed=placed), PosedEyes(turns, *balls, lids, harmonics)

    @torch.no_grad()
    def traced(self, inputs: FrameInputs) -> tuple[LidOcclusion, Tensor | None]:
        """Lids and, where eyes are lit apart, the light that passes them.

        Traced once for a frame, and kept.
        """
        if inputs not in self._traced:
            motion = inputs.head_from_world, frame_gaze(inputs, self.parts, self.axes)
            (_, _, turns), (points, frames) = self.placed(*motion), self.pose(*motion)
            lids, harmonics = trace_lids(inputs.mesh[0], self.skin_faces, points, frames), None
            if self.lit_apart:
                skin, lights = None if self.shadow_learned else lids.skin, white_once(inputs.lights)
                harmonics = light_past_lids(skin, points, frames[..., 2], turns[self.eye], lights)
            self._traced[inputs] = lids, harmonics
        return self._traced[inputs]

    def mirrors(self, eyes: PosedEyes, samples: GlossySamples | None) -> Float[Tensor, "texels 2"] | None:
        """Layer of what eyes mirror, of samples of all texels; None without.

        It has visibility, and roughness as far as it is visible; neither where lids are shut over the eye.
        """
        if samples is None:
            return None
        visibility = samples.visibility[self.chosen] * (eyes.lids.opening > 0)
        seen = torch.stack([visibility, visibility * samples.roughness[self.chosen]], -1)
        return seen.new_zeros(len(samples), 2).index_copy(0, self.chosen, seen)

    def without_gloss(
        self, added: Float[Tensor, "texels channels"] | None, samples: GlossySamples | None
    ) -> tuple[Float[Tensor, "texels channels"] | None, GlossySamples | None]:
        """Light and samples of a glossy surface that leave out the eyes, whose mirrors show it.

        The normals, too: blended, they would make skin beside an eye shine as the eye does.
        """
        added = None if added is None else self.without(added)
        if samples is None:
            return added, None
        without = {name: self.without(getattr(samples, name)) for name in ("visibility", "normals")}
        return added, replace(samples, **without)

    def without(self, values: Float[Tensor, "texels *_"]) -> Float[Tensor, "texels *_"]:
        """Values of the texels with those of eyes zero."""
        return values.index_fill(0, self.chosen, 0.0)

    def under_lids(self, eyes: PosedEyes, values: Float[Tensor, "texels *_"]) -> Float[Tensor, "texels *_"]:
        """Light of the texels that passes the lids.

        All of it, where what came to them had passed already, or where shadows are simulated.
        """
        if self.lit_apart or self.shadow_learned:
            return values
        share = eyes.lids.opening.reshape(-1, *[1] * (values.ndim - 1))
        return values.index_copy(0, self.chosen, values[self.chosen] * share)

    def seen_from(
        self, frame: PreparedFrame, center: Float[Tensor, " 3"], color: Float[Tensor, "texels 3"]
    ) -> Float[Tensor, "texels 3"]:
        """Diffuse colour with the albedo that the eyes show a camera at `center`."""
        toward = unit(center - frame.gaussians.means.detach()[self.chosen])
        inward = (frame.eyes.turns.detach()[self.eye].mT @ toward[..., None])[..., 0]
        return color.index_copy(0, self.chosen, color[self.chosen] * self.albedo(inward))

    @torch.no_grad()
    def start(self, spec: AvatarSpec, parameters: Collection[str]) -> dict[str, Tensor | float]:
        """Values that eye texels start with, by parameter.

        A lobe or the width of GGX, and an open transfer, if there are any.

        Where each texel has harmonics of its own light, eyes have those of the light that passes the lids, each lamp by
        itself, in a frame that turns with the eye. Their transfer starts as that of the bare spheres: what lids hide at
        rest would count twice.
        """
        self.lit_apart, self.shadow_learned = spec.shading in ("harmonics", "linear") and spec.near_field, spec.shadow
        values: dict[str, Tensor | float] = {}
        if "log_roughness" in parameters:
            values["log_roughness"] = math.log(START_ROUGHNESS)
            values["visibility"] = math.log(START_VISIBILITY / (1 - START_VISIBILITY))
        if "log_ggx_width" in parameters:
            values["log_ggx_width"] = math.log(START_ROUGHNESS)
        if self.lit_apart:
            bare = start_harmonics(self.surface(self.sizes).normals, spec.degrees)
            for name, start in zip(TRANSFER, bare, strict=True):
                if start.numel():
                    values |= {name: start, f"start_{name}": start}
        return values

    def losses(
        self, gaussians: Gaussians, visibility: Tensor | None, bound: Bound = "log"
    ) -> dict[str, Float[Tensor, ""]]:
        """The terms of RGCA 16, unweighted.

        Scales (mm) no larger than closes the surface, opacity and visibility 1.

        Args:
            visibility: logits of the specular visibility, if there is a lobe.
            bound: "paper": scales no larger than 0.1 mm, whether that closes the surface or not.
        """
        most = (1e3 * self.start_scales * (bound == "log")).clamp_min(FILL_MM)
        terms = {
            "eye_scale": torch.relu(1e3 * gaussians.scales[self.chosen] - most).square().mean(),
            "eye_opacity": (1 - gaussians.opacities[self.chosen]).square().mean(),
        }
        if visibility is not None:
            terms["eye_visibility"] = (1 - torch.sigmoid(visibility[self.chosen])).square().mean()
        return terms


def in_head(quaternions: Float[Tensor, "n 4"], world_from_head: Float[Tensor, "3 3"]) -> Float[Tensor, "n 4"]:
    """Rotations in the world as rotations in the head's frame."""
    back = world_from_head.detach().double().cpu().numpy().T
    return multiply_quaternions(torch.as_tensor(quaternion_from_matrix(back)).to(quaternions)[None], quaternions)
