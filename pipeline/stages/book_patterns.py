"""Book light patterns and splits, and check that the LED log is in step with the images.

It says which LED was on in which frame, and which split a frame is in.

In: the capture's index, calibrated lights and cameras, and the images themselves. What the log predicts for the
brightness of the subject in each camera is compared with what the cameras saw (`pipeline.sync.sync`): the two
numberings may be apart, images lost or stored twice, LEDs dead or stuck, single frames under another pattern. The same
comparison judges exposures, the images' transfer function and where lights are said to be. Out: patterns.parquet,
frames.parquet, sync.json, verdicts_patterns.csv and a timeline, sync.png.
"""

from __future__ import annotations

import logging
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, listed
from pipeline.base.files import read_json, read_table, write_json, write_table
from pipeline.base.verdicts import log_verdicts, verdict_table
from pipeline.config.book_patterns import BookPatterns
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.sync.brightness import BrightnessModel, directions_from, observed_table, read_log
from pipeline.sync.image_means import measure_brightness
from pipeline.sync.image_verdicts import image_verdicts
from pipeline.sync.log_alternatives import Rig
from pipeline.sync.patterns import find_leaks, mend_patterns, synced_frames, synced_patterns
from pipeline.sync.subject_proxy import Ellipsoid, fit_ellipsoid, shading_response
from pipeline.sync.sync import FAULTY, UNEXPLAINED, SyncCheck, check_sync

log = logging.getLogger("book_patterns")


def run(
    *, capture: Path, index: Path, lights: Path, cameras: Path, out: Path, settings: BookPatterns = BookPatterns()
) -> None:
    """Book light patterns and splits per frame, and check that LED log and images agree.

    Args:
        capture: folder of the capture, for its images.
        index: folder of index_capture.
        lights: lights.parquet of calibrate_lights.
        cameras: cameras.json of calibrate_lights (stage frame, sensor resolution).
        out: folder for patterns.parquet, frames.parquet, sync.json, verdicts_patterns.csv and sync.png.
        settings: see the flags below.
    """
    tables = {name: read_table(index / f"{name}.parquet") for name in ("frames", "patterns", "images")}
    facts = read_json(index / "capture.json")["images"]
    stage_lights, rig = read_table(lights), read_cameras(cameras)
    chosen = choose_cameras(tables["images"], settings.sync_cameras)
    complain_about(tables["patterns"], stage_lights, lights, chosen, rig, cameras)
    rig = {name: rig[name].downsampled(float(facts["downsample_from_sensor"])) for name in chosen}

    means = measure_brightness(capture, tables["images"], chosen, facts)
    subject = fit_subject(rig, means)
    names = seeing_cameras(means)
    model = build_model(tables, stage_lights, rig, subject, means, names)
    check = check_sync(model, settings.max_offset_frames, settings.fault_sigma)
    places = Rig(stage_lights[["x", "y", "z"]].to_numpy(np.float64), np.stack([rig[c].center for c in names]), subject)
    verdicts = [
        check.timing, *check.lights, *image_verdicts(model, check, means, names, places, settings.fault_sigma),
    ]  # fmt: skip
    log_verdicts(log, [verdict for verdict in verdicts if verdict.kind != "light" or verdict.grade != "good"])
    write_table(out / "verdicts_patterns.csv", verdict_table(verdicts))

    patterns, frames, lit = tables["patterns"], tables["frames"], stage_lights.light.tolist()
    fixed = settings.on_desync == "fix" and check.verdict == FAULTY
    if fixed:
        patterns, frames = mend_patterns(patterns, frames, check.frames, check.constants)
        lit = [light for light in lit if check.constants.get(light, np.ones(3)).any()]
    synced = synced_frames(frames, tables["images"], patterns, lit)
    found = check.frames.set_index("frame").reindex(synced.frame)
    synced["predicted"] = found["predicted" if fixed else "logged"].to_numpy()
    synced["observed"] = found.observed.to_numpy()
    synced["suspicious"] = found.suspicious.eq(True).to_numpy()
    table = synced_patterns(patterns, synced)
    report(synced, len(tables["frames"]))
    write_json(out / "sync.json", sync_facts(check, fixed, subject))
    from pipeline.sync.timeline import draw_timeline  # Matplotlib, once there is something to draw.

    draw_timeline(out / "sync.png", check, synced, table, stage_lights.light.tolist())
    complain_of_faults(check, settings, index / "patterns.parquet", out / "sync.png")
    complain_of_leaks(find_leaks(synced, table), settings, index / "patterns.parquet")
    write_table(out / "patterns.parquet", table)
    write_table(out / "frames.parquet", synced)


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
    """Refuse lights and cameras that have no calibration, before any image is read.

    Raises:
        InputError: naming all lights and cameras that have no calibration, before any image is read.
    """
    complaints = Complaints("book_patterns")
    for light in sorted(set(patterns.light) - set(lights.light)):
        complaints.add(lights_file, light, expected="a position, as it is lit in patterns.parquet", found="no row")
    for camera in [name for name in chosen if name not in rig]:
        complaints.add(cameras_file, camera, expected="a calibrated camera, as it has images", found="none")
    complaints.raise_if_any()


def fit_subject(rig: dict[str, Camera], means: pd.DataFrame) -> Ellipsoid:
    """The ellipsoid of the subject's mean place and size over all frames."""
    average = means.groupby("camera")[["x", "y", "xx", "xy", "yy"]].mean()
    pixels = {camera: row[["x", "y"]].to_numpy(np.float64) for camera, row in average.iterrows()}
    spread = {camera: row[["xx", "xy", "xy", "yy"]].to_numpy(np.float64).reshape(2, 2)
              for camera, row in average.iterrows()}  # fmt: skip
    return fit_ellipsoid(rig, pixels, spread)


def seeing_cameras(means: pd.DataFrame) -> list[str]:
    """Cameras that see any light at all; every camera if none does."""
    brightest = means.groupby("camera")[["r", "g", "b"]].max().max(axis=1)
    if blind := brightest.index[brightest <= 0].tolist():
        log.warning("no light at all in the images of %s", listed(blind))
    return sorted(brightest.index[brightest > 0]) or sorted(brightest.index)


def build_model(
    tables: dict[str, pd.DataFrame],
    lights: pd.DataFrame,
    rig: dict[str, Camera],
    subject: Ellipsoid,
    means: pd.DataFrame,
    names: list[str],
) -> BrightnessModel:
    """The log and the images in one numbering of cameras, `names`, and lights."""
    frames, seen = observed_table(means, names)
    places = lights[["x", "y", "z"]].to_numpy(np.float64)
    centers = np.stack([rig[name].center for name in names])
    return BrightnessModel(
        read_log(tables["patterns"], tables["frames"].frame, lights.light.tolist()), frames, seen,
        shading_response(subject, places, centers),
        directions_from(subject.center, centers), directions_from(subject.center, places),
    )  # fmt: skip


def report(synced: pd.DataFrame, frames: int) -> None:
    """Log the splits."""
    splits, lit, patterns = synced.split.value_counts().to_dict(), synced.fully_lit.sum(), synced.pattern.nunique()
    log.info("%d frames: %s, %d fully lit, %d different patterns", len(synced), splits, lit, patterns)
    if len(synced) < frames:
        log.warning("%d frames dropped: it is not known what was on in them", frames - len(synced))


def complain_of_faults(check: SyncCheck, settings: BookPatterns, file: Path, picture: Path) -> None:
    """Refuse faults of the log, as `on_desync` wants.

    Raises:
        InputError: naming every fault, as `on_desync` wants; always, unless told to ignore it, if nothing can be fixed.
    """
    if settings.on_desync == "ignore" or (settings.on_desync == "fix" and check.verdict != UNEXPLAINED):
        return
    complaints = Complaints(f"{file}: log and images disagree, see {picture}")
    if check.verdict == UNEXPLAINED:
        hint = "is it this capture's log? More than max_offset_frames away? book_patterns.on_desync: ignore goes on"
        complaints.add(file, "frame", expected="patterns that the images show", found=check.why, hint=hint)
    for fault in check.faults if check.verdict == FAULTY else []:
        key = f"light {fault.name}" if fault.kind in ("dead_light", "stuck_light") else f"frame {fault.name}"
        hint = "correct the capture's patterns file, or set book_patterns.on_desync to fix (or ignore)"
        if fault.kind == "offset":
            hint = f"subtract {fault.value:g} from its frame numbers, or set book_patterns.on_desync to fix (or ignore)"
        complaints.add(file, key, expected="what the images show", found=fault.why, hint=hint)
    complaints.raise_if_any()


def complain_of_leaks(leaks: list[tuple[int, int]], settings: BookPatterns, file: Path) -> None:
    """Refuse patterns that are in training and test, as `on_leak` wants.

    Raises:
        InputError: naming the frames, if `on_leak` says so.
    """
    complaints = Complaints(f"{file}: held-out light is trained on")
    for test in dict.fromkeys(test for test, _ in leaks):
        trained = [train for other, train in leaks if other == test]
        complaints.add(
            file, f"frame {test}", expected="light that no training frame shows, as it is held out",
            found=f"the same lights in the same proportions in training frame {listed(trained)}",
            hint="hold those out too (splits.test_patterns holds out all frames of a pattern), or set "
            "book_patterns.on_leak to warn",
        )  # fmt: skip
    if settings.on_leak == "error":
        complaints.raise_if_any()
    for message in complaints.messages:
        log.warning("%s", message)


def sync_facts(check: SyncCheck, fixed: bool, subject: Ellipsoid) -> dict:
    """Content of sync.json."""
    offsets = check.frames.offset_frames
    starts = offsets.ne(offsets.shift()) & (offsets.index > 0)
    return {
        "verdict": check.verdict,
        "why": check.why,
        "fixed": fixed,
        "offset_frames": int(offsets.iloc[0]),
        "offset_changes": [
            {"frame": int(row.frame), "offset_frames": int(row.offset_frames)}
            for row in check.frames[starts].itertuples()
        ],
        "faults": [asdict(fault) for fault in check.faults],
        "sigmas_ahead_of_offset": {f"{k:+d}": value for k, value in sorted(check.sigmas_ahead.items())},
        "lights": [asdict(light) for light in check.lights],
        "subject_center_m": subject.center.tolist(),
        "subject_semiaxes_m": np.linalg.norm(subject.axes, axis=0).tolist(),
    }


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
