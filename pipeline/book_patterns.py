"""Which LED was on in which frame of the images, is the LED log in step with them, and which split is a frame in.

In: the capture's index, calibrated lights and cameras, and the images themselves. The brightness that the log
predicts at the subject's centre (sum of I / d^2) is compared with what the cameras saw, for a constant offset
between the two numberings (`pipeline.lighting.sync`) and for single frames that do not fit. Out: patterns.parquet,
frames.parquet, sync.json and a timeline, sync.png.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.base.progress import progress
from pipeline.capture.images import read_image, read_mask
from pipeline.config.book_patterns import BookPatterns
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.lighting.patterns import (
    book_frames,
    book_patterns_rgb,
    observed_brightness,
    predicted_brightness,
    shift_patterns,
    subject_center,
    suspicious_frames,
)
from pipeline.lighting.sync import OUT_OF_SYNC, SyncCheck, check_sync
from pipeline.lighting.timeline import draw_timeline

log = logging.getLogger("book_patterns")

SUBJECT = 128
"""Mask values from here on are subject: at least half of the pixel."""


def run(
    *, capture: Path, index: Path, lights: Path, cameras: Path, out: Path, settings: BookPatterns = BookPatterns()
) -> None:
    """Book light patterns and splits per frame, and check that LED log and images are in step.

    Args:
        capture: folder of the capture, for its images.
        index: folder of index_capture.
        lights: lights.parquet of calibrate_lights.
        cameras: cameras.json of calibrate_lights (stage frame, sensor resolution).
        out: folder for patterns.parquet, frames.parquet, sync.json and sync.png.
        settings: see the flags below.
    """
    tables = {name: read_table(index / f"{name}.parquet") for name in ("frames", "patterns", "images")}
    facts = read_json(index / "capture.json")["images"]
    stage_lights, rig = read_table(lights), read_cameras(cameras)
    chosen = choose_cameras(tables["images"], settings.sync_cameras)
    complain_about(tables["patterns"], stage_lights, lights, chosen, rig, cameras)
    rig = {name: rig[name].downsampled(float(facts["downsample_from_sensor"])) for name in chosen}

    means = measure_brightness(capture, tables["images"], chosen, facts)
    pixels = {name: xy.to_numpy(np.float64) for name, xy in means.groupby("camera")[["x", "y"]].mean().iterrows()}
    center = subject_center(rig, pixels)
    predicted = predicted_brightness(tables["patterns"], stage_lights, tables["frames"].frame, center)
    observed = observed_brightness(means)
    check = check_sync(predicted, observed, settings.max_offset_frames)
    log.info("%s: %s", check.verdict, check.why)

    applied = check.offset_frames if settings.on_desync == "fix" else 0
    patterns, frames = shift_patterns(tables["patterns"], tables["frames"], applied)
    booked = book_frames(frames, tables["images"], patterns, stage_lights.light.tolist())
    booked["predicted"] = predicted.reindex(booked.frame + applied).to_numpy()
    booked["observed"] = observed.reindex(booked.frame).to_numpy()
    booked["suspicious"] = suspicious_frames(booked, settings.suspicious_sigma)
    table = book_patterns_rgb(patterns, booked)
    report(booked, len(tables["frames"]))
    write_json(out / "sync.json", sync_facts(check, applied, center))
    draw_timeline(out / "sync.png", booked, table, stage_lights.light.tolist(), check)
    if check.verdict == OUT_OF_SYNC and settings.on_desync == "error":
        raise InputError(
            f"{index}/patterns.parquet: frame: expected the numbering of the images, found patterns "
            f"{check.offset_frames:+d} frames away ({check.why}; see {out}/sync.png); subtract {check.offset_frames} "
            "from `frame` in the capture's patterns file, or set book_patterns.on_desync to fix (or to ignore)"
        )
    write_table(out / "patterns.parquet", table)
    write_table(out / "frames.parquet", booked)


def choose_cameras(images: pd.DataFrame, at_most: int) -> list[str]:
    """Cameras evenly spread over the sorted list of those that have images."""
    names = sorted(images.camera.unique())
    return [names[i] for i in np.unique(np.linspace(0, len(names) - 1, min(at_most, len(names))).round().astype(int))]


def complain_about(
    patterns: pd.DataFrame,
    lights: pd.DataFrame,
    lights_file: Path,
    chosen: list[str],
    rig: dict[str, Camera],
    cameras_file: Path,
) -> None:
    """Raises:
    InputError: naming all lights and cameras that have no calibration, before any image is read.
    """
    complaints = Complaints("book_patterns")
    for light in sorted(set(patterns.light) - set(lights.light)):
        complaints.add(lights_file, light, expected="a position, as it is lit in patterns.parquet", found="no row")
    for camera in [name for name in chosen if name not in rig]:
        complaints.add(cameras_file, camera, expected="a calibrated camera, as it has images", found="none")
    complaints.raise_if_any()


def measure_brightness(capture: Path, images: pd.DataFrame, cameras: list[str], facts: dict) -> pd.DataFrame:
    """Mean of the subject per image: camera, frame, brightness, and the subject's mean pixel x, y.

    Without masks the whole image is averaged (the background of a stage is dark) and x, y is the image's centre.
    Images without a finite subject pixel are left out.
    """
    rows = []
    for row in progress(list(images[images.camera.isin(cameras)].itertuples()), "book_patterns"):
        image = read_image(capture / row.path, facts["transfer"], facts["black_level"])
        subject = np.isfinite(image).all(2)
        if isinstance(row.mask_path, str):
            subject &= read_mask(capture / row.mask_path) >= SUBJECT
        if not subject.any():
            continue
        y, x = (indices.mean() + 0.5 for indices in np.nonzero(subject))
        rows.append((row.camera, row.frame, float(image[subject].mean(dtype=np.float64)), x, y))
    return pd.DataFrame(rows, columns=["camera", "frame", "brightness", "x", "y"])


def report(booked: pd.DataFrame, frames: int) -> None:
    """Log the splits, and warn of what a person should look at."""
    log.info("%d frames: %s, %d fully lit", len(booked), booked.split.value_counts().to_dict(), booked.fully_lit.sum())
    if len(booked) < frames:
        log.warning("%d frames dropped: after the fix their pattern is outside the log", frames - len(booked))
    if booked.suspicious.any():
        log.warning(
            "brightness does not fit the log in frames %s: see sync.png", booked.frame[booked.suspicious].tolist()
        )


def sync_facts(check: SyncCheck, applied: int, center: np.ndarray) -> dict:
    """Content of sync.json; undefined correlations are null."""

    def or_null(value: float) -> float | None:
        return value if np.isfinite(value) else None

    return {
        "offset_frames": check.offset_frames,
        "correlation": or_null(check.correlation),
        "verdict": check.verdict,
        "why": check.why,
        "sigmas": check.sigmas,
        "applied_offset_frames": applied,
        "correlations": {str(k): or_null(v) for k, v in sorted(check.correlations.items())},
        "subject_center_m": center.tolist(),
    }


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
