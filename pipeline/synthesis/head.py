"""The procedural head: an unrigged mesh of skin and two eyeballs, texture, keypoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64, Int64
from scipy.spatial import cKDTree

from pipeline.base.files import write_table
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.appearance import Unwrapped, bake, unwrap
from pipeline.synthesis.expression import displaced, performance_at
from pipeline.synthesis.eyeball import (
    CORNEA_OFFSET_M,
    CORNEA_RADIUS_M,
    EYE_CENTERS_M,
    EYE_NAMES,
    EYE_RADIUS_M,
    Patch,
    cornea_patch,
    eye_directions,
    sclera_patch,
    template_eyeball,
)
from pipeline.synthesis.gltf_writer import write_glb
from pipeline.synthesis.hair import RADIUS_M, grow, skull
from pipeline.synthesis.head_appearance import eye_albedo, skin_albedo
from pipeline.synthesis.head_shape import head_mesh
from pipeline.synthesis.mitsuba_scenes import COAT_IOR
from pipeline.synthesis.subject import Material, Moment, Strands, Surface, template_mesh, template_source

WET_ALPHA = 0.12
"""GGX width of the gloss on the white of the eyes, which is wet but not even."""

CORNEA_IOR = 1.8
"""Refractive index of the corneas' coat. It reflects 8 % head on, three times as much as a real one: glints are to
stand out in images in which they are smaller than a pixel."""

EYE_TEXTURE_SIZE = 256
"""Of the photographed eyes' albedo: texels of 0.15 mm."""

EYE_UV_SCALE = 2.5
"""Scale of eyes against skin on the template's texture map.

An avatar's texels of eyes are as much finer, 1.5 mm on a map of 128 x 128.
"""

_PAIRED = {
    "brow_inner": (0.014, 0.033, 0.087), "brow_middle": (0.029, 0.036, 0.080), "brow_outer": (0.045, 0.031, 0.070),
    "eye_inner": (0.017, 0.009, 0.076), "eye_outer": (0.047, 0.010, 0.066),
    "eye_upper": (0.032, 0.0185, 0.077), "eye_lower": (0.032, 0.0015, 0.077),
    "nose_wing": (0.018, -0.027, 0.094), "mouth_corner": (0.0225, -0.0545, 0.080),
    "lip_upper": (0.010, -0.0425, 0.088), "lip_lower": (0.010, -0.0680, 0.087),
    "jaw": (0.054, -0.070, 0.030), "ear_top": (0.079, 0.029, -0.012), "ear_lobe": (0.077, -0.029, -0.012),
}  # fmt: skip
_MIDDLE = {
    "nose_bridge": (0.0, 0.014, 0.094), "nose_tip": (0.0, -0.022, 0.116), "nose_base": (0.0, -0.033, 0.096),
    "lip_upper": (0.0, -0.0420, 0.090), "lip_lower": (0.0, -0.0680, 0.088), "chin": (0.0, -0.098, 0.084),
}  # fmt: skip
"""Points near the rest surface to which keypoints belong.

Of a pair, the one on the left side, +x. With the pupils there are 36.
"""


@dataclass(frozen=True)
class Head:
    """An unrigged head that turns, talks and smiles: a `Subject`, whose keypoints are vertices.

    Attributes:
        skin_count: number of vertices before those of the two eyeballs, which follow in equal halves.
        patches: what of an eye is photographed, in the eye's own frame, with its gloss_alpha and ior.
        eye_texture: linear albedo that the patches' uv look up.
        strands: of hair at rest; None where it is painted.
        skull: the skin at rest below them.
        keypoint_vertices: of the uncut mesh, in the order of `keypoint_names`.
    """

    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    skin_count: int
    unwrapped: Unwrapped
    texture: Float32[np.ndarray, "size size 3"]
    materials: tuple[Material, ...]
    keypoint_names: tuple[str, ...]
    keypoint_vertices: Int64[np.ndarray, " keypoints"]
    eyes: Mapping[str, Int64[np.ndarray, " vertices"]]
    patches: tuple[tuple[Patch, float, float], ...]
    eye_texture: Float32[np.ndarray, "texels texels 3"]
    strands: Float64[np.ndarray, "strands points 3"] | None = None
    skull: Float64[np.ndarray, "skin 3"] | None = None
    kind: Literal["head"] = "head"
    keypoint_depth_m: float = 0.004
    detected_when_hidden: bool = False

    def at(self, time_s: float, segment: str) -> Moment:
        """The head at a time within a segment."""
        performance = performance_at(time_s, segment)
        eyes = self.vertices[self.skin_count :].reshape(2, -1, 3) - EYE_CENTERS_M[:, None]
        turned = performance.gaze.apply(eyes.reshape(-1, 3)).reshape(eyes.shape) + EYE_CENTERS_M[:, None]
        in_head = np.concatenate([displaced(self.vertices[: self.skin_count], performance), turned.reshape(-1, 3)])
        world = performance.turn.apply(in_head) + performance.shift_m
        photographed = strands = None
        if self.strands is not None:
            below = np.concatenate(
                [self.skull - self.vertices[: self.skin_count], np.zeros_like(turned.reshape(-1, 3))]
            )
            photographed = performance.turn.apply(in_head + below) + performance.shift_m
            moved = performance.turn.apply(self.strands.reshape(-1, 3)) + performance.shift_m  # the skull is stiff
            strands = Strands(moved.reshape(self.strands.shape), RADIUS_M)
        truth = {
            "root_rotation": performance.turn.as_quat(scalar_first=True), "root_translation": performance.shift_m,
            "gaze": performance.gaze.as_quat(scalar_first=True), "keypoints": world[self.keypoint_vertices],
        }  # fmt: skip
        look = performance.gaze.apply([0.0, 0.0, 1.0])
        surfaces = [
            Surface(
                name, turn.apply(patch.vertices) + performance.turn.apply(center) + performance.shift_m,
                turn.apply(patch.normals), patch.faces, patch.uv, self.eye_texture, alpha, ior,
            )
            for turn in (performance.turn * performance.gaze,)
            for name, center in zip(EYE_NAMES, EYE_CENTERS_M, strict=True)
            for patch, alpha, ior in self.patches
        ]  # fmt: skip
        looks = dict.fromkeys(EYE_NAMES, look)
        return Moment(world, truth["keypoints"], truth, looks, tuple(surfaces), photographed, strands)

    def write_template(self, folder: Path, settings: SynthesizeCapture) -> None:
        """Write template.glb without a skin, and keypoints.csv and eyes.csv, which name vertices."""
        write_glb(folder / "template.glb", **template_mesh(self, settings))
        source = template_source(self, settings.uvs)
        # A vertex on a seam has copies: the first stands for it.
        first = np.array([np.flatnonzero(source == vertex)[0] for vertex in self.keypoint_vertices])
        write_table(folder / "keypoints.csv", pd.DataFrame({"keypoint": self.keypoint_names, "vertex": first}))
        parts = [(name, np.flatnonzero(np.isin(source, vertices))) for name, vertices in self.eyes.items()]
        rows = [(name, vertex) for name, vertices in parts for vertex in vertices.tolist()]
        write_table(folder / "eyes.csv", pd.DataFrame(rows, columns=["eye", "vertex"]))

    def eye_truth(self) -> dict[str, dict[str, object]]:
        """Per eye: centre in the resting head, radii, and the offset of the cornea's centre, metres."""
        shape = {"radius_m": EYE_RADIUS_M, "cornea_radius_m": CORNEA_RADIUS_M, "cornea_offset_m": CORNEA_OFFSET_M}
        return {
            name: {"center_m": center.tolist(), **shape} for name, center in zip(EYE_NAMES, EYE_CENTERS_M, strict=True)
        }


def build_head(
    subject: str, vertex_spacing_m: float, texture_size: int, gloss_alpha: float, cornea_alpha: float = 0.05,
    hair_strands: int = 0,
) -> Head:  # fmt: skip
    """Build the head, with painted hair or with strands; equal arguments give an equal head."""
    skin, skin_faces = head_mesh(vertex_spacing_m)
    eye, eye_faces = template_eyeball()
    vertices = np.concatenate([skin, *(eye + center for center in EYE_CENTERS_M)])
    faces = np.concatenate([skin_faces, len(skin) + eye_faces, len(skin) + len(eye) + eye_faces])
    names, near = _keypoints()
    pupils = len(skin) + len(eye) * np.arange(len(EYE_NAMES))
    larger = np.concatenate([skin, *(EYE_UV_SCALE * eye + center for center in EYE_CENTERS_M)])
    unwrapped = unwrap(larger, faces, texture_size)

    def albedo(corners: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        return skin_albedo(np.einsum("kc,kcd->kd", barycentric, vertices[corners]), skin, subject)

    eye_colors = eye_albedo(eye_directions(EYE_TEXTURE_SIZE))
    return Head(
        vertices, faces, len(skin), unwrapped, bake(unwrapped, texture_size, albedo),
        (Material(slice(0, len(skin_faces)), gloss_alpha),), (*names, "pupil_l", "pupil_r"),
        np.concatenate([cKDTree(skin).query(near)[1], pupils]),
        {name: first + np.arange(len(eye)) for name, first in zip(EYE_NAMES, pupils, strict=True)},
        ((cornea_patch(), cornea_alpha, CORNEA_IOR), (sclera_patch(), WET_ALPHA, COAT_IOR)),
        eye_colors.reshape(EYE_TEXTURE_SIZE, EYE_TEXTURE_SIZE, 3),
        grow(subject, hair_strands, skin, skin_faces) if hair_strands else None,
        skull(skin, skin_faces) if hair_strands else None,
    )  # fmt: skip


def _keypoints() -> tuple[tuple[str, ...], Float64[np.ndarray, "k 3"]]:
    """Names of the keypoints on the skin, and points near which they lie."""
    places = dict(_MIDDLE)
    for name, (x, y, z) in _PAIRED.items():
        places |= {f"{name}_l": (x, y, z), f"{name}_r": (-x, y, z)}
    return tuple(places), np.array(list(places.values()))
