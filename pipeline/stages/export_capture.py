"""Write a calibrated capture in the layout of another program.

In: the capture, its index and its calibration; for Goliath's layout also lights, patterns and tracked meshes. Out, in
one folder, by layout. colmap: sparse/0, a model whose cameras are one rig, images/ and masks/. nerfstudio:
transforms.json, images/ and masks/. goliath: SUBJECT--Head, which `source: goliath` reads. Colours are those of the
average camera; lenses stay as they are. `docs/export.md` says what each holds, and what it cannot hold.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_table
from pipeline.base.whole_files import written_folder
from pipeline.config.export_capture import ExportCapture
from pipeline.export.colmap_folder import write_colmap_folder
from pipeline.export.goliath_folder import write_goliath_folder
from pipeline.export.nerfstudio_folder import write_nerfstudio_folder
from pipeline.export.recording import Recording, read_recording
from pipeline.geometry.template_file import read_template

log = logging.getLogger("export_capture")

MEASURED = ("tracked", "refined", "carried", "given")
"""Status of frames whose mesh is no interpolation between others."""

MOTION = ("frames", "root_rotation", "root_translation", "vertices")


def run(
    *,
    subject: str,
    layout: Literal["colmap", "nerfstudio", "goliath"],
    capture: Path,
    index: Path,
    cameras: Path,
    color: Path,
    out: Path,
    lights: Path | None = None,
    patterns: Path | None = None,
    tracking: tuple[Path, ...] = (),
    settings: ExportCapture = ExportCapture(),
) -> None:
    """Write the files.

    Args:
        subject: what the capture is called.
        layout: colmap, nerfstudio or goliath.
        capture: folder of the capture.
        index: folder of index_capture.
        cameras: calibration/cameras.json.
        color: calibration/color.json.
        out: folder to write.
        lights: calibration/lights.parquet, for goliath.
        patterns: patterns.parquet of book_patterns, for goliath.
        tracking: chunks of track_mesh, in order, for goliath.
        settings: see the flags below.
    """
    recording = read_recording(capture, index, cameras, color, settings.frames)
    with written_folder(out, "export_capture") as folder:
        if layout == "colmap":
            write_colmap_folder(folder, recording, settings.exposure)
        elif layout == "nerfstudio":
            write_nerfstudio_folder(folder, recording, settings.exposure)
        else:
            _write_goliath(folder, recording, settings.exposure, subject, lights, patterns, tracking)
    log.info("%s: %d images, %d cameras", layout, len(recording.images), len(recording.cameras))


def _write_goliath(
    folder: Path, recording: Recording, exposure: float, subject: str, lights: Path | None, patterns: Path | None,
    tracking: tuple[Path, ...],
) -> None:  # fmt: skip
    if lights is None or patterns is None or not tracking:
        raise InputError("--lights, --patterns, --tracking: expected all three for the layout goliath, found fewer")
    described = recording.facts["template"]
    template = read_template(recording.source.folder / described["mesh"], float(described["scale_to_m"]))
    write_goliath_folder(
        folder, recording, exposure, subject, read_table(lights), read_table(patterns), _measured(tracking), template
    )


def _measured(tracking: tuple[Path, ...]) -> dict[str, np.ndarray]:
    """Motion of the frames that were measured, of all chunks."""
    chunks = []
    for path in tracking:
        arrays, table = read_arrays(path), read_table(path.with_suffix(".parquet"))
        kept = np.isin(arrays["frames"], table.frame[table.status.isin(MEASURED)].to_numpy())
        chunks.append({name: arrays[name][kept] for name in MOTION})
    return {name: np.concatenate([chunk[name] for chunk in chunks]) for name in MOTION}


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
