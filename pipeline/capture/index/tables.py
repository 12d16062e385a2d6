"""Tables of a capture, checked row by row: cameras, frames, lights, patterns, keypoints, ..."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import Complaints, listed
from pipeline.capture.index.csv_tables import (
    FLOAT32,
    Kind,
    column_names,
    complain_repeats,
    complain_rows,
    complain_unknown,
    read_csv,
)

log = logging.getLogger(__name__)

SLACK_FRAMES = 16
"""Frames that a pattern table may reach beyond the first and last image: a badly synchronised stage counts its patterns
from another start, which book_patterns finds and mends. More than this is a table of something else."""

CAMERA_COLUMNS: Mapping[str, Kind] = {
    "camera": "name", "width": "whole", "height": "whole", "sensor_width": "whole", "sensor_height": "whole",
}  # fmt: skip
FRAME_COLUMNS: Mapping[str, Kind] = {"frame": "whole", "timestamp_s": "number", "segment": "text"}
EXPOSURE_COLUMNS = ("exposure_s", "gain")
"""Optional columns of frames: the time that all cameras were exposed for, and the factor of their amplifiers."""
LIGHT_COLUMNS: Mapping[str, Kind] = {"light": "name", "x": "number", "y": "number", "z": "number"}
INTENSITIES = ["intensity_r", "intensity_g", "intensity_b"]
WHITE_PATTERN_COLUMNS: Mapping[str, Kind] = {"frame": "whole", "light": "name", "intensity": "number"}
COLORED_PATTERN_COLUMNS: Mapping[str, Kind] = {
    "frame": "whole",
    "light": "name",
    **dict.fromkeys(INTENSITIES, "number"),
}

OTHER_CLOCK = 0.1
"""Relative difference between frames.csv and fps from which it is worth a look: nominal and true rates differ by 0.1 %
(30 and 29.97), neighbouring ones by 4 % (24 and 25). Frames that were left out before numbering differ by more."""

OTHER_UNIT = 1000**0.5
"""Ratio of the two that is another unit: halfway, in logarithms, between equal and milliseconds for seconds."""


def read_cameras_csv(root: Path, path: str, downsample: int | None, complaints: Complaints) -> pd.DataFrame | None:
    """Cameras in the file's order; sizes in pixels, the sensor `downsample` times the image."""
    table = read_csv(root, path, CAMERA_COLUMNS, complaints)
    if table is None:
        return None
    if table.empty:
        complaints.add(path, "camera", expected="at least one row", found="none")
    complain_repeats(complaints, path, table, ["camera"])
    for column in ("width", "height", "sensor_width", "sensor_height"):
        if (bad := table[column] <= 0).any():
            complain_rows(complaints, path, column, bad, "a positive number of pixels", table[column])
    for camera in table.itertuples() if downsample else ():
        expected = (camera.width * downsample, camera.height * downsample)
        if expected != (camera.sensor_width, camera.sensor_height):
            complaints.add(
                path, f"{camera.camera}: sensor_width x sensor_height",
                expected=f"{expected[0]} x {expected[1]}, images.downsample_from_sensor ({downsample}) times the image",
                found=f"{camera.sensor_width} x {camera.sensor_height}",
            )  # fmt: skip
    return table


def read_frames_csv(root: Path, path: str, complaints: Complaints) -> pd.DataFrame | None:
    """Frames by number, with times that grow, segments, and exposures if they are given."""
    exposed: dict[str, Kind] = {name: "number" for name in EXPOSURE_COLUMNS if name in column_names(root, path)}
    table = read_csv(root, path, {**FRAME_COLUMNS, **exposed}, complaints)
    if table is None:
        return None
    for column in exposed:
        if (bad := ~(table[column] > 0)).any():
            complain_rows(complaints, path, column, bad, "more than 0", table[column])
    if table.empty:
        complaints.add(path, "frame", expected="at least one row", found="none")
    if (bad := table["frame"] < 0).any():
        complain_rows(complaints, path, "frame", bad, "a number of 0 or more", table["frame"])
    complain_repeats(complaints, path, table, ["frame"])
    table = table.sort_values("frame", kind="stable", ignore_index=True)
    if len(late := table["frame"][1:][np.diff(table["timestamp_s"]) <= 0]):
        complaints.add(
            path, "timestamp_s", expected="times that increase with the frame number",
            found=f"no later than the frame before: frame {listed(list(late))}",
        )  # fmt: skip
    return table


def check_rate(path: str, frames: pd.DataFrame, fps: float, complaints: Complaints) -> None:
    """Complain if the times of frames do not pass at the rate that the description names.

    The rate is the median over segments of numbers passed over time passed: between segments the clock may jump.
    """
    spans = frames.groupby("segment")[["frame", "timestamp_s"]].agg(lambda values: values.iloc[-1] - values.iloc[0])
    spans = spans[(spans.timestamp_s > 0) & (spans.frame > 0)]
    if spans.empty:
        return
    rate = float((spans.frame / spans.timestamp_s).median())
    expected = f"seconds, {1 / fps:.6g} apart from frame to frame as fps says ({fps:g})"
    found = f"{1 / rate:.6g} apart, {rate:.6g} frames per second (median of {len(spans)} segments)"
    if not 1 / OTHER_UNIT < rate / fps < OTHER_UNIT:
        hint = "write times in seconds, or mend fps in capture.yaml"
        complaints.add(path, "timestamp_s", expected=expected, found=found, hint=hint)
    elif abs(rate / fps - 1) > OTHER_CLOCK:
        log.warning("%s: timestamp_s: expected %s, found %s", path, expected, found)


def read_lights_csv(root: Path, path: str, complaints: Complaints) -> pd.DataFrame | None:
    """Surveyed lights in the file's order, metres."""
    table = read_csv(root, path, LIGHT_COLUMNS, complaints)
    if table is not None:
        if table.empty:
            complaints.add(path, "light", expected="at least one row", found="none")
        complain_repeats(complaints, path, table, ["light"])
    return table


def read_patterns_csv(
    root: Path, path: str, frames: pd.DataFrame | None, lights: pd.DataFrame | None, complaints: Complaints
) -> pd.DataFrame | None:
    """One row per lit light: frame, light, intensity_r, intensity_g, intensity_b, by frame.

    A file with the one column `intensity` is of white lights: all three are equal. Rows of intensity 0 say what is true
    of unlisted lights, and are left out. Frames up to `SLACK_FRAMES` before the first and after the last image may
    be named: see there.
    """
    table = read_csv(root, path, _pattern_columns(root, path, complaints), complaints)
    if table is None:
        return None
    for column in [column for column in table if column.startswith("intensity")]:
        if (bad := table[column] < 0).any():
            complain_rows(complaints, path, column, bad, "0 or more", table[column])
        if (faint := (table[column] > 0) & (table[column] < FLOAT32.tiny)).any():
            expected = f"0, or at least {FLOAT32.tiny:.3g}, the smallest number that float32 holds exactly"
            complain_rows(complaints, path, column, faint, expected, table[column])
    if "intensity" in table:
        table = table.assign(**dict.fromkeys(INTENSITIES, table["intensity"])).drop(columns="intensity")
    complain_repeats(complaints, path, table, ["frame", "light"])
    if lights is not None:
        complain_unknown(complaints, path, "light", table["light"], lights["light"], "the table of lights")
    if frames is not None and len(frames):
        first, last = int(frames["frame"].min()), int(frames["frame"].max())
        around = [*range(first - SLACK_FRAMES, first), *range(last + 1, last + 1 + SLACK_FRAMES)]
        complain_unknown(complaints, path, "frame", table["frame"], [*frames["frame"], *around], "the table of frames")
        if beyond := set(table["frame"]) & set(around):
            log.warning("%s: frames without images: %s; are the counts out of step?", path, listed(sorted(beyond)))
    lit = (table[INTENSITIES] != 0).any(axis=1)
    return table[lit].sort_values(["frame", "light"], kind="stable", ignore_index=True)


def _pattern_columns(root: Path, path: str, complaints: Complaints) -> Mapping[str, Kind]:
    """Columns of the spelling that a file of patterns uses; complains if it uses both."""
    names = column_names(root, path)
    colored = any(column in names for column in INTENSITIES)
    if colored and "intensity" in names:
        complaints.add(
            path, "columns", expected=f"intensity (white lights), or {', '.join(INTENSITIES)} (coloured ones)",
            found="both", hint="keep one of the two",
        )  # fmt: skip
    return COLORED_PATTERN_COLUMNS if colored else WHITE_PATTERN_COLUMNS
