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

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.glossy import GlossySamples
from pipeline.avatar.appearance.transfer import TRANSFER, start_harmonics
from pipeline.avatar.eyes.eye_decoders import EyeDecoders
from pipeline.avatar.eyes.eye_parts import EyeAlbedo
from pipeline.avatar.eyes.eye_spheres import EyeSpheres
from pipeline.avatar.eyes.lid_occlusion import light_past_lids, trace_lids
from pipeline.avatar.frames.gaze import frame_gaze
from pipeline.avatar.frames.inputs import FrameInputs, white_once
from pipeline.avatar.frames.prepared import Decoded, LidOcclusion, PosedEyes, PreparedFrame, ViewedParameters
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import PosedTexels
from pipeline.avatar.texels.texel_parameters import EXPRESSED, TexelParameters
from pipeline.config.training_losses import Bound
from pipeline.eyes.eye_fit import FittedEye
from pipeline.geometry.rotations import multiply_quaternions, quaternion_from_matrix
from pipeline.geometry.texels import Atlas
from pipeline.lighting.lobes import unit
from pipeline.rendering.splat_types import Gaussians

FROZEN = {"offset": (0.0, 0.0, 0.0), "rotation": (1.0, 0.0, 0.0, 0.0), "normal_offset": (0.0, 0.0, 0.0)}
"""Parameters of eye texels that stay as they are."""

EYE_DECODED = tuple(name for name in EXPRESSED if name not in ("offset", "normal_offset"))
"""Parameters that the eyes' decoders may change: places and normals are those of the spheres (RGCA 10)."""

START_ROUGHNESS = 0.05
START_VISIBILITY = 0.39
"""A wet surface, nearly a mirror. A dielectric mirrors F0 = 0.04 of a light, which the lobe spreads over 2 pi sigma^2
of solid angle: v C / sigma = F0 / (2 pi sigma^2) gives v = 0.39 for sigma = 0.05."""

FILL_MM = 0.1
"""Scales of eye Gaussians that RGCA 16 lets pass, for texels of a sixth of a millimetre."""


class Eyes(EyeSpheres):
    """All eyes of an avatar; see `EyeSpheres` for what they are made of.

    Args:
        scales: start scales of all Gaussians, metres: no eye Gaussian is asked to be smaller.
    """

    def __init__(self, atlas: Atlas, fitted: Mapping[str, FittedEye], scales: Float[Tensor, "texels 3"]) -> None:
        super().__init__(atlas, fitted)
        self.register_buffer("start_scales", scales[self.chosen].clone(), persistent=False)
        self.albedo, self.decoders = EyeAlbedo(len(self.chosen)), None
        self.lit_apart = self.shadow_learned = self.lids_learned = False
        self._lids: WeakKeyDictionary[PosedTexels, LidOcclusion] = WeakKeyDictionary()
        self._traced: WeakKeyDictionary[FrameInputs, tuple[LidOcclusion, Tensor | None]] = WeakKeyDictionary()

    def add_decoders(self, spec: AvatarSpec, parameters: TexelParameters) -> None:
        """Decode what eye texels are, in place of an albedo by view (RGCA 10)."""
        own = {name: tensor[self.chosen] for name, tensor in parameters.named(EYE_DECODED).items()}
        self.albedo, self.lids_learned = None, spec.lids == "learned"
        self.decoders = EyeDecoders(self.directions, self.eye, self.axes, own, spec.eye_channels)

    def place(self, decoded: Decoded, inputs: FrameInputs) -> tuple[Decoded, PosedEyes]:
        """Freeze the parameters of eye texels, and put these texels on the spheres of their eyes.

        How a disc lies says little about an eye: its quaternion has no gradient, its point and its normal have.
        """
        motion = inputs.head_from_world, frame_gaze(inputs, self.parts, self.axes)
        (sizes, places, turns), (points, frames) = self.placed(*motion), self.pose(*motion)
        lids, harmonics = self.traced(inputs)
        features = None if self.decoders is None else self.decoders.features(motion[1], motion[0], lids.opening)
        if self.lids_learned:
            lids = LidOcclusion(torch.ones_like(lids.opening), None)
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
        if features is not None:
            added = self.decoders.decode(features)
            whole = {name: torch.zeros_like(getattr(parameters, name)) for name in added}
            parameters = parameters.plus({name: whole[name].index_add(0, self.chosen, added[name]) for name in added})
        eyes = PosedEyes(turns, *balls, lids, harmonics, features)
        return replace(decoded, parameters=parameters, posed=placed), eyes

    def viewed(self, frame: PreparedFrame, center: Float[Tensor, " 3"], viewed: ViewedParameters) -> ViewedParameters:
        """Parameters with what the eyes' decoders add for a camera at `center` (RGCA 10)."""
        if self.decoders is None:
            return viewed
        inputs = frame.incident.inputs
        toward = unit(center - frame.eyes.centers[: len(self.axes)].detach()) @ inputs.head_from_world[:, :3].T
        gain, visibility = self.decoders.view(frame.eyes.features, toward)
        if viewed.visibility is None:
            return replace(viewed, eye_gain=gain)
        return replace(viewed, visibility=viewed.visibility.index_add(0, self.chosen, visibility), eye_gain=gain)

    @torch.no_grad()
    def traced(self, inputs: FrameInputs) -> tuple[LidOcclusion, Tensor | None]:
        """Lids and, where eyes are lit apart, the light that passes them.

        Lids are traced once for a pose, the light once for a frame; both are kept.
        """
        if inputs not in self._traced:
            motion = inputs.head_from_world, frame_gaze(inputs, self.parts, self.axes)
            (_, _, turns), (points, frames) = self.placed(*motion), self.pose(*motion)
            lids, harmonics = self._lids.get(inputs.posed), None
            if lids is None:
                lids = self._lids[inputs.posed] = trace_lids(inputs.mesh[0], self.skin_faces, points, frames)
            if self.lit_apart:
                skin = None if self.shadow_learned or self.lids_learned else lids.skin
                lights = white_once(inputs.lights if inputs.sky is None else inputs.sky.pixels)
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

    def without(self, values: Float[Tensor, " texels *_"]) -> Float[Tensor, " texels *_"]:
        """Values of the texels with those of eyes zero."""
        return values.index_fill(0, self.chosen, 0.0)

    def under_lids(self, eyes: PosedEyes, values: Float[Tensor, " texels *_"]) -> Float[Tensor, " texels *_"]:
        """Light of the texels that passes the lids.

        All of it, where what came to them had passed already, or where shadows are simulated.
        """
        if self.lit_apart or self.shadow_learned:
            return values
        share = eyes.lids.opening.reshape(-1, *[1] * (values.ndim - 1))
        return values.index_copy(0, self.chosen, values[self.chosen] * share)

    def seen_from(
        self, frame: PreparedFrame, center: Float[Tensor, " 3"], color: Float[Tensor, "texels 3"],
        gain: Float[Tensor, "eye_texels 3"] | None = None,
    ) -> Float[Tensor, "texels 3"]:  # fmt: skip
        """Diffuse colour with the albedo that the eyes show a camera; by `gain`, if it was decoded."""
        if gain is not None:
            return color.index_copy(0, self.chosen, color[self.chosen] * gain)
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
