"""Files with the truth in place of what calibration and tracking found.

The survey of the lights decides where the stage's frame lies, and errs by its own noise. So the truth is moved by the
rigid motion that brings the true cameras over those that were found: each part can then be replaced by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from pipeline.base.files import read_arrays, read_json, read_table, write_arrays, write_json, write_table
from pipeline.config.budget_errors import Part
from pipeline.dials.subject import CHUNK, Subject
from pipeline.geometry.cameras import read_cameras, write_cameras
from pipeline.geometry.rigid_alignment import Alignment
from pipeline.metrics.output_errors import align_rigs

TRUTH: Mapping[Part, str] = {
    "color": "color.json", "lights": "lights.parquet", "cameras": "cameras.json", "tracking": "tracking.safetensors"
}  # fmt: skip
"""Files below a capture's truth/."""


@dataclass(frozen=True)
class Inputs:
    """Files of what was found of a subject, and of what is true.

    Attributes:
        found: file of each part, as the workflow wrote it.
        truth: folder of the truth.
    """

    found: Mapping[Part, Path]
    truth: Path

    @classmethod
    def of(cls, subject: Subject) -> Inputs:
        """The files of a subject of one chunk."""
        calibration = subject.results / "calibration"
        found = {
            "color": calibration / "color.json", "lights": calibration / "lights.parquet",
            "cameras": calibration / "cameras.json", "tracking": subject.results / f"tracking/{CHUNK}.safetensors",
        }  # fmt: skip
        return cls(found, subject.capture / "truth")

    def write(self, part: Part, folder: Path) -> Path:
        """Write one part with the truth in its place, and return the file."""
        path = folder / self.found[part].name
        WRITERS[part](self, path)
        return path

    def alignment(self) -> Alignment:
        """True frame from the found one."""
        return align_rigs(read_cameras(self.found["cameras"]), read_cameras(self.truth / TRUTH["cameras"]))

    def brought(self, points: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
        """True points in the found frame."""
        motion = self.alignment()
        return (points - motion.t) @ motion.R


def _write_color(inputs: Inputs, path: Path) -> None:
    found, true = read_json(inputs.found["color"]), read_json(inputs.truth / TRUTH["color"])["raw_from_true"]
    matrices = {name: np.linalg.inv(np.array(true[name])).tolist() for name in found["cameras"]}
    write_json(path, found | {"cameras": matrices})


def _write_lights(inputs: Inputs, path: Path) -> None:
    found, axes = read_table(inputs.found["lights"]), ["x", "y", "z"]
    true = read_table(inputs.truth / TRUTH["lights"]).set_index("light").loc[found.light, axes]
    found[axes] = inputs.brought(true.to_numpy(np.float64))
    write_table(path, found)


def _write_cameras(inputs: Inputs, path: Path) -> None:
    found, true = read_cameras(inputs.found["cameras"]), read_cameras(inputs.truth / TRUTH["cameras"])
    motion = inputs.alignment()
    moved = {
        name: replace(true[name], R=true[name].R @ motion.R, t=true[name].R @ motion.t + true[name].t) for name in found
    }
    write_cameras(path, moved)


def _write_tracking(inputs: Inputs, path: Path) -> None:
    found, true = read_arrays(inputs.found["tracking"]), read_arrays(inputs.truth / TRUTH["tracking"])
    row = {int(frame): number for number, frame in enumerate(true["frames"])}
    vertices = true["vertices"][[row[int(frame)] for frame in found["frames"]]].astype(np.float64)
    write_arrays(path, dict(found) | {"vertices": inputs.brought(vertices).astype(np.float32)})


WRITERS: Mapping[Part, Callable[[Inputs, Path], None]] = {
    "color": _write_color, "lights": _write_lights, "cameras": _write_cameras, "tracking": _write_tracking
}  # fmt: skip
