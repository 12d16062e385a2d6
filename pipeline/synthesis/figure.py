"""The procedural figure as a whole: mesh, skin, texture, and its pose over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64, Int64

from pipeline.base.files import write_table
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.appearance import Unwrapped, albedo_at, bake, unwrap
from pipeline.synthesis.gltf_writer import FIRST_JOINT_NODE, Skin, write_glb
from pipeline.synthesis.implicit_surface import even_out, smooth_union, surface_nets
from pipeline.synthesis.motion import pose_at
from pipeline.synthesis.skeleton import Skeleton, human_skeleton, human_solids
from pipeline.synthesis.skinning import joint_transforms, pose_vertices, smooth_weights
from pipeline.synthesis.subject import Material, Moment, template_mesh, template_source

BOX_LOW_M = np.array([-0.9, -0.1, -0.3])
BOX_HIGH_M = np.array([0.9, 1.9, 0.35])
"""A box around the rest pose with a hand's breadth to spare."""

FLOOR_Y_M = -0.88
"""Height of the ground in the stage frame: puts the figure's middle at the stage's centre."""


@dataclass(frozen=True)
class Figure:
    """A skinned figure that walks and reaches: a `Subject`, whose keypoints are its joints.

    Attributes:
        weights: skin of the uncut mesh.
        keypoint_depth_m: half the torso's width.
    """

    skeleton: Skeleton
    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    weights: Float64[np.ndarray, "v joints"]
    unwrapped: Unwrapped
    texture: Float32[np.ndarray, "size size 3"]
    materials: tuple[Material, ...]
    kind: Literal["body"] = "body"
    keypoint_depth_m: float = 0.16
    detected_when_hidden: bool = True
    eyes: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.skeleton.names

    def posed(self, rotations: np.ndarray, root_translation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Uncut vertices [v, 3] and joint positions [joints, 3] of a pose, in metres.

        Local joint rotations are unit quaternions, wxyz.
        """
        world_from_joint = joint_transforms(self.skeleton, rotations, root_translation)
        return pose_vertices(self.vertices, self.weights, self.skeleton, world_from_joint), world_from_joint[:, :3, 3]

    def at(self, time_s: float, segment: str) -> Moment:
        """The figure at a time within a segment."""
        pose = pose_at(self.skeleton, time_s, segment, FLOOR_Y_M)
        vertices, joints = self.posed(pose.rotations, pose.root_translation)
        truth = {"joints": joints, "joint_rotations": pose.rotations, "root_translation": pose.root_translation}
        return Moment(vertices, joints, truth)

    def write_template(self, folder: Path, settings: SynthesizeCapture) -> None:
        """template.glb with the skin, and keypoints.csv, which names the joints' nodes."""
        skin = Skin(self.weights[template_source(self, settings.uvs)], self.skeleton)
        write_glb(folder / "template.glb", **template_mesh(self, settings), skin=skin)
        nodes = FIRST_JOINT_NODE + np.arange(len(self.skeleton.names))
        write_table(folder / "keypoints.csv", pd.DataFrame({"keypoint": self.skeleton.names, "node_index": nodes}))

    def eye_truth(self) -> dict[str, dict[str, object]]:
        """None: its eyes are painted."""
        return {}


def build_figure(subject: str, vertex_spacing_m: float, texture_size: int, gloss_alpha: float) -> Figure:
    """Build the figure; equal arguments give an equal figure."""
    skeleton, solids = human_skeleton(), human_solids()

    def field(points: np.ndarray) -> np.ndarray:
        return smooth_union(points, solids)

    vertices, faces = surface_nets(field, BOX_LOW_M, BOX_HIGH_M, vertex_spacing_m)
    vertices = even_out(vertices, faces, field)
    weights = smooth_weights(vertices, faces, solids, skeleton)
    unwrapped = unwrap(vertices, faces, texture_size)
    owner = weights.argmax(axis=1)

    def albedo(corners: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        owners = owner[corners[np.arange(len(corners)), barycentric.argmax(axis=1)]]
        return albedo_at(np.einsum("kc,kcd->kd", barycentric, vertices[corners]), owners, skeleton, subject)

    texture = bake(unwrapped, texture_size, albedo)
    return Figure(skeleton, vertices, faces, weights, unwrapped, texture, (Material(slice(None), gloss_alpha),))
