"""The eyes of a synthesised head as they were photographed: what no stage reads, for comparisons with what was made.

Everything is in the frame of the capture's truth, in metres and float64. A place in a picture goes from there to the
pixels of a calibrated camera by way of the recorded image, so that errors of calibration count, but not the choice of
frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.mirror_glints import glint_points
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_json, read_table
from pipeline.eyes.eye_shape import EyeShape
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.rotations import matrix_from_quaternion
from pipeline.geometry.template_file import read_template
from pipeline.lighting.visibility import Occluders

CLEAR = 0.15
"""Radians between a mirror point and the crease of cornea and eyeball, seen from its sphere's centre, within which the
crease cuts the glint whatever the pixels: a normal turned by 0.15 rad turns the mirrored ray by 0.3, six times the
width of the lobe of a wet eye."""

MEASURED = "measured"
CUT = CREASE, OUTLINE, EDGE = "near the crease", "at the eye's outline", "at the skin's edge"
NOT_SEEN = UNLIT, TWO, HIDDEN = "not mirrored", "two glints", "hidden by skin"
"""What becomes of a glint. It is measured; or, within a pixel, something cuts it: cornea or eyeball where they meet,
the outline of the eye, or skin, so that the middle of what shows is not the mirror point; or it is not seen, or twice.
Not mirrored: camera or light are behind the sphere, or the place is on the part of a sphere that lies inside the
other."""

AROUND = 8
"""Points around a glint that are asked for whether skin hides them."""


@dataclass(frozen=True)
class TrueEyes:
    """All of a capture's truth that says where glints are.

    Attributes:
        shapes, centers: of each eye by name; centres in the head at rest.
        cameras: at sensor resolution, with their distortion.
        lights: positions by name.
        motions: world from head, [R | t], by frame.
        gaze: turn of both eyes from straight ahead, by frame.
        vertices: posed template by frame, and `skin`, its faces without those of eyes.
    """

    shapes: Mapping[str, EyeShape]
    centers: Mapping[str, np.ndarray]
    cameras: Mapping[str, Camera]
    lights: Mapping[str, np.ndarray]
    motions: Mapping[int, np.ndarray]
    gaze: Mapping[int, np.ndarray]
    vertices: Mapping[int, np.ndarray]
    skin: np.ndarray

    @cached_property
    def _occluders(self) -> dict[int, Occluders]:
        return {}

    def occluders(self, frame: int) -> Occluders:
        """The skin of a frame."""
        if frame not in self._occluders:
            self._occluders[frame] = Occluders(self.vertices[frame], self.skin)
        return self._occluders[frame]

    def looks(self, frame: int) -> np.ndarray:
        """Unit direction, in the head's frame, in which the eyes looked when the frame was taken."""
        return self.gaze[frame] @ [0.0, 0.0, 1.0]

    def placed(self, eye: str, frame: int, looks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centre of an eye and unit direction of its axis in the world; `looks` is in the head's frame."""
        R, t = self.motions[frame][:, :3], self.motions[frame][:, 3]
        return R @ self.centers[eye] + t, R @ looks

    def glint(
        self, eye: str, frame: int, looks: np.ndarray, camera: str, light: str, pixel_m: float
    ) -> tuple[str, np.ndarray | None]:
        """What becomes of a glint, see `MEASURED` to `HIDDEN`, and where it is, unless it is not seen.

        `pixel_m`: width of a pixel at the eye.
        """
        center, axis = self.placed(eye, frame, looks)
        shape, seen_from, lit_by = self.shapes[eye], self.cameras[camera].center, self.lights[light]
        found = glint_points(center, axis, shape, seen_from, lit_by)
        if len(found) != 1:
            return (TWO if found else UNLIT), None
        point, normal = found[0], self.normal(found[0], eye, frame, looks)
        free = self.passing(point, normal, frame, (seen_from, lit_by), pixel_m)
        if not free[0]:
            return HIDDEN, None
        if not glint_points(center, axis, shape, seen_from, lit_by, CLEAR, pixel_m):
            return CREASE, point
        radius = shape.cornea_radius_m if self.on_cornea(point, eye, frame, looks) else shape.radius_m
        toward = (seen_from - point) / np.linalg.norm(seen_from - point)
        if radius * (1 - np.linalg.norm(np.cross(normal, toward))) < pixel_m:
            return OUTLINE, point
        return (MEASURED if free.all() else EDGE), point

    def on_cornea(self, point: np.ndarray, eye: str, frame: int, looks: np.ndarray) -> bool:
        """Whether a point of an eye's surface lies on its cornea."""
        center, axis = self.placed(eye, frame, looks)
        shape = self.shapes[eye]
        from_cornea = np.linalg.norm(point - center - shape.cornea_offset_m * axis)
        return abs(from_cornea - shape.cornea_radius_m) < abs(np.linalg.norm(point - center) - shape.radius_m)

    def normal(self, point: np.ndarray, eye: str, frame: int, looks: np.ndarray) -> np.ndarray:
        """The unit normal at a point of an eye's surface."""
        center, axis = self.placed(eye, frame, looks)
        offset = self.shapes[eye].cornea_offset_m if self.on_cornea(point, eye, frame, looks) else 0.0
        outward = point - center - offset * axis
        return outward / np.linalg.norm(outward)

    def passing(
        self, point: np.ndarray, normal: np.ndarray, frame: int, ends: tuple[np.ndarray, ...], spread_m: float
    ) -> np.ndarray:
        """Whether a point of an eye, and then points around it at a distance of `spread_m`, see all `ends` past the
        skin."""
        aside, turn = np.linalg.svd(normal[None])[2][1:], 2 * np.pi * np.arange(AROUND) / AROUND
        ring = spread_m * np.stack([np.cos(turn), np.sin(turn)], 1) @ aside
        points = point + np.concatenate([np.zeros((1, 3)), ring])
        normals, free = np.tile(normal, (len(points), 1)), np.ones(len(points), bool)
        for end in ends:
            way = end - points
            way /= np.linalg.norm(way, axis=1, keepdims=True)
            free &= self.occluders(frame).first_faces(points, normals, way)[0] < 0
        return free

    def image_point(self, point: np.ndarray, camera: str, calibrated: Camera) -> np.ndarray:
        """Where a point of the world lies in the undistorted pictures of a calibrated camera, (x / z, y / z, 1):
        through the true camera to the recorded image, and back through the calibrated one. Both at sensor resolution.
        """
        recorded, _ = self.cameras[camera].project(point)
        return np.append(calibrated.undistort(recorded[None])[0], 1.0)


def read_true_eyes(capture: Path) -> TrueEyes:
    """The truth of a capture.

    Raises:
        InputError: if it was not synthesised, or has no eyes.
    """
    truth = capture / "truth"
    if not (truth / "eyes.json").exists():
        raise InputError(f"{truth}/eyes.json: expected the truth of a synthesised head with eyes, found none")
    sizes, tracked = read_json(truth / "eyes.json"), read_arrays(truth / "tracking.safetensors")
    arrays = {name: array.astype(np.float64) for name, array in tracked.items() if name != "frames"}
    shift = arrays["root_translation"][..., None]
    motions = np.concatenate([matrix_from_quaternion(arrays["root_rotation"]), shift], 2)
    frames, lights = tracked["frames"].tolist(), read_table(truth / "lights.parquet").set_index("light")
    faces = read_template(capture / "template/template.glb", 1.0).faces
    eyes = pd.read_csv(capture / "template/eyes.csv").vertex.to_numpy()
    return TrueEyes(
        {name: EyeShape(s["radius_m"], s["cornea_radius_m"], s["cornea_offset_m"]) for name, s in sizes.items()},
        {name: np.array(s["center_m"]) for name, s in sizes.items()},
        read_cameras(truth / "cameras.json"),
        {name: row.to_numpy(np.float64) for name, row in lights[["x", "y", "z"]].iterrows()},
        dict(zip(frames, motions, strict=True)),
        dict(zip(frames, matrix_from_quaternion(arrays["gaze"]), strict=True)),
        dict(zip(frames, arrays["vertices"], strict=True)),
        faces[~np.isin(faces, eyes).all(1)],
    )
