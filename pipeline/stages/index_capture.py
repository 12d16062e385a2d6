"""Index a native capture: from `capture.yaml` to validated tables.

They have a digest of every file that it names.

The whole capture is checked first: every key, row and image (each is decoded). All that is wrong is said at once,
before anything is written. Images stay where they are; the index says where, and the digest of what they hold, so that
later stages rerun when content changes and only then. Format: `pipeline.capture.schema.capture_yaml`.

Images of a large capture are decoded by jobs of their own, each those of some chunks of frames; the index that is made
of their tables is the same.
"""

from __future__ import annotations

import logging
import shutil
from pathlib import Path

from pipeline.base.command import run_as_command
from pipeline.base.files import write_json, write_table
from pipeline.base.verdicts import verdict_table
from pipeline.base.whole_files import workplace, written_whole
from pipeline.capture.index.detected_files import DetectedFiles
from pipeline.capture.index.image_checks import nothing_known
from pipeline.capture.index.inspected_images import InspectedImages, inspect_frames
from pipeline.capture.index.keypoint_tables import KEYPOINT_FILES
from pipeline.capture.index.validation import index_folder
from pipeline.config.index_capture import IndexCapture

log = logging.getLogger("index_capture")


def run(
    *,
    capture: Path,
    out: Path,
    detected_keypoints: Path | None = None,
    detected_masks: Path | None = None,
    inspected: tuple[Path, ...] = (),
    chunk: int | None = None,
    chunks: int = 1,
    chunk_size: int = 64,
    settings: IndexCapture = IndexCapture(),
) -> None:
    """Validate a capture folder and write its index tables.

    Args:
        capture: the capture folder; capture.yaml lies at its root.
        out: the folder for cameras, frames, lights, patterns, images, keypoints_2d, meshes, eyes,
            eye_points and gaze.parquet,
            capture.json, verdicts_images.csv and calibration_cameras, calibration_lights and calibration_color.json;
            with `chunk`, for CHUNK.parquet.
        detected_keypoints: keypoints_2d.parquet of detect_landmarks, in place of the capture's.
        detected_masks: masks.parquet of segment_subject, in place of the capture's.
        inspected: tables that were written with `chunk`: the images in them are not read again.
        chunk: inspect only the images of these sorted frames, from chunk * chunk_size, and write a table of them.
        chunks: number of chunks that are inspected, if any.
        chunk_size: frames per chunk.
        settings: see the flags below.
    """
    if chunk is not None:
        table = out / f"{chunk:04d}.parquet"
        found = inspect_frames(capture, table, chunk * chunk_size, chunks * chunk_size, settings.decode_threads)
        log.info("chunk %d and %d more: %d images and masks inspected", chunk, chunks - 1, found)
        return
    for name, detected in (("keypoints", detected_keypoints), ("masks", detected_masks)):
        if detected is not None:
            log.info("%s are those that were detected: %s", name, detected)
    known = InspectedImages(inspected) if inspected else nothing_known
    detected = DetectedFiles(detected_keypoints, detected_masks)
    out.parent.mkdir(parents=True, exist_ok=True)
    with workplace(out.parent) as place:
        index = index_folder(capture, settings.decode_threads, known, detected, place)
        for name in KEYPOINT_FILES:
            with written_whole(out / name) as temporary:
                shutil.move(place / name, temporary)
    if not index.keypoints and index.tables["meshes"].empty:
        log.warning(
            "capture.yaml: keypoints_2d: none, or empty: calibration runs, but track_mesh will refuse; after "
            "`make detect` they are looked for in the images"
        )
    for name, table in index.tables.items():
        write_table(out / f"{name}.parquet", table)
    write_table(out / "verdicts_images.csv", verdict_table(index.verdicts))
    for name, content in index.contents.items():
        write_json(out / f"{name}.json", content)
    log.info("%d images of %d cameras", len(index.tables["images"]), len(index.tables["cameras"]))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
