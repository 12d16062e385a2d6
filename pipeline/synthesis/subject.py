"""Interface of a procedural subject, for the rest of this package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis.appearance import Unwrapped


@dataclass(frozen=True)
class Surface:
    """A surface that is photographed as it is, instead of faces of the template; world metres.

    Attributes:
        name: of what it belongs to.
        normals: unit, for shading.
        texture: linear albedo, row 0 at v = 0.
        gloss_alpha, ior: width of the GGX lobe of its coat, and the coat's refractive index.
    """

    name: str
    vertices: Float64[np.ndarray, "v 3"]
    normals: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    uv: Float64[np.ndarray, "v 2"]
    texture: Float32[np.ndarray, "size size 3"]
    gloss_alpha: float
    ior: float


@dataclass(frozen=True)
class Strands:
    """Hair as curves of one radius; world metres.

    Attributes:
        points: along each strand, its root first.
    """

    points: Float64[np.ndarray, "strands points 3"]
    radius_m: float


@dataclass(frozen=True)
class Moment:
    """The subject at one time, world metres.

    Attributes:
        vertices: of the mesh that is not cut along texture seams.
        keypoints: what a detector looks for.
        truth: further arrays that say how the subject was posed, by the name under which truth/ stores them.
        gaze: unit direction in which each eye looks, in the frame of the template at rest, by the eye's name.
        surfaces: eyes, whose glints are smaller than a face of the template.
        photographed: the vertices as pictures show them, where these lie below hair; None: as they are.
        strands: of hair, if it is not painted.
    """

    vertices: Float64[np.ndarray, "v 3"]
    keypoints: Float64[np.ndarray, "k 3"]
    truth: Mapping[str, np.ndarray]
    gaze: Mapping[str, np.ndarray] = field(default_factory=dict)
    surfaces: tuple[Surface, ...] = ()
    photographed: Float64[np.ndarray, "v 3"] | None = None
    strands: Strands | None = None

    @property
    def reach(self) -> Float64[np.ndarray, "points 3"]:
        """Points between which all of the subject is seen."""
        return self.vertices if self.strands is None else np.concatenate([self.vertices, *self.strands.points])


@dataclass(frozen=True)
class Material:
    """Some of a subject's faces, and what they are made of.

    Attributes:
        gloss_alpha: width of the GGX lobe of their gloss.
        solid: what they enclose may be a translucent medium; if not, they are opaque whatever the settings say.
    """

    faces: slice
    gloss_alpha: float
    solid: bool = True


@runtime_checkable
class Subject(Protocol):
    """A closed mesh with a texture that moves, and the template file that a capture holds of it.

    Attributes:
        kind: of the capture.
        vertices, faces: the rest mesh in metres, not cut along texture seams.
        unwrapped: the same mesh cut along texture seams, faces in the same order.
        texture: linear albedo, row 0 at v = 0.
        materials: of all faces but those that a moment's surfaces replace.
        keypoint_names: in the order of `Moment.keypoints`.
        keypoint_depth_m: a keypoint lies up to this far below its own skin; behind more, it is hidden.
        detected_when_hidden: whether a detector guesses hidden keypoints (joints) or leaves them out (skin).
        eyes: vertices of the uncut mesh that each eye consists of, by name.
    """

    kind: Literal["body", "head"]
    vertices: Float64[np.ndarray, "v 3"]
    faces: Int64[np.ndarray, "f 3"]
    unwrapped: Unwrapped
    texture: Float32[np.ndarray, "size size 3"]
    materials: tuple[Material, ...]
    keypoint_names: tuple[str, ...]
    keypoint_depth_m: float
    detected_when_hidden: bool
    eyes: Mapping[str, Int64[np.ndarray, " vertices"]]

    def at(self, time_s: float, segment: str) -> Moment:
        """The subject at a time within segment `a` or `b`, in the stage frame."""
        ...

    def write_template(self, folder: Path, settings: SynthesizeCapture) -> None:
        """Write template.glb, keypoints.csv and, if there are eyes, eyes.csv.

        Vertices are in the order of `template_source`.
        """
        ...

    def eye_truth(self) -> dict[str, dict[str, object]]:
        """The shape of each eye in the resting template, metres."""
        ...


def template_source(subject: Subject, uvs: bool) -> Int64[np.ndarray, " u"]:
    """For each vertex of the template file, the vertex of the uncut mesh it is a copy of."""
    return subject.unwrapped.source if uvs else np.arange(len(subject.vertices))


def template_mesh(subject: Subject, settings: SynthesizeCapture) -> dict[str, np.ndarray | float | None]:
    """The arguments of `write_glb` that do not depend on how the subject moves."""
    source = template_source(subject, settings.uvs)
    return {
        "vertices": subject.vertices[source],
        "normals": vertex_normals(subject.vertices, subject.faces)[source],
        "faces": subject.unwrapped.faces if settings.uvs else subject.faces,
        "uv": subject.unwrapped.uv if settings.uvs else None,
        "units_per_m": 1 / settings.scale_to_m,
    }


def vertex_normals(vertices: Float64[np.ndarray, "v 3"], faces: Int64[np.ndarray, "f 3"]) -> Float64[np.ndarray, "v 3"]:
    """Unit normals, area-weighted over the faces around each vertex."""
    corners = vertices[faces]
    doubled_area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], doubled_area)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
