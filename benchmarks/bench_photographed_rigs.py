"""Calibrations of photographed rigs beside those of their authors: a page of docs and its picture.

    python -m benchmarks.bench_photographed_rigs --data ../shared/data

The data are described on that page. Where images were not taken at once, the authors' poses are no truth: how far poses
scatter when some of the shots are left out says which of two is to be believed.
"""

from __future__ import annotations

import argparse
import itertools
import shutil
import tempfile
import textwrap
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from benchmarks.marked_page import read_between
from benchmarks.photographed_rigs import (
    CALISCOPE_BOARD,
    caliscope_cameras,
    opencv_left_focal,
    opencv_pair,
    prepare_caliscope,
    prepare_checkerboard,
)
from pipeline.base.files import read_json, read_table, write_json
from pipeline.capture.gray import read_view_gray
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.stages.calibrate_cameras import run

PAGE = Path("docs/photographed_rigs.md")
PICTURE = Path("docs/pictures/rig_caliscope.jpg")

BOARDLESS = """
## Without any board

<!-- feature rigs: begin -->
{part}<!-- feature rigs: end -->

Written by `python -m benchmarks.bench_feature_rigs`.
"""
"""Part that `bench_feature_rigs` writes."""

VARIANTS = {
    "known, at once": ("known", False),
    "known, times": ("known", True),
    "refine, times": ("refine", True),
    "estimate, times": ("estimate", True),
}
"""Lenses, and whether the images' times count."""

REFITTED, LEFT_OUT = ("known, times", "refine, times"), 6
"""Variants that are calibrated anew without groups of shots, and the number of these groups."""

LENIENT = CalibrateCameras(largest_shift_px=1e3, largest_focal_error=1.0)
"""By default, images taken for simultaneous are refused, as if a camera had been knocked; so are lenses whose error
bars are above a per cent."""

HEAD = """\
# Photographed rigs

<!-- Written by `python -m benchmarks.bench_photographed_rigs`: change it there. -->

Calibrations of real cameras by this pipeline, beside those of the people who recorded them. But for one picture, the
photographs are not part of the repository.
"""


CALISCOPE = """\
Videos of 111 frames, from mprib/caliscope (`tests/sessions/charuco_calibration`, BSD-2): a board of {squares_x} x
{squares_y} squares, printed white on black, which the capture does not say. Six images a second; the images of one
moment are up to a tenth of a second apart, and the hand moves. *At once* takes them for simultaneous, as the authors
did (refused by default: a camera seems to have been knocked). *Times* estimates each camera's lag and each image's
error. *Known*, *refine* and *estimate* say what becomes of the authors' lenses. Error bars are standard deviations, no
smaller than the spread when groups of shots are left out; those of *known* take the authors' lenses for true. On
planted rigs errors are as large as these bars (`tests/unit/calibration/cameras/test_relative_poses.py`).
"""


def angle_deg(a: Camera, b: Camera, other_a: Camera, other_b: Camera) -> float:
    """Angle between the relative rotations of two pairs of cameras, degrees."""
    turn = (b.R @ a.R.T) @ (other_b.R @ other_a.R.T).T
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def caliscope_section(data: Path, folder: Path) -> str:
    """Four cameras on stands, a board moved by hand: authors, and the four variants."""
    authors, found, quality, pairs, refitted = caliscope_cameras(data), {}, {}, {}, {}
    for label, (intrinsics, times) in VARIANTS.items():
        at = prepare_caliscope(data, folder / label.replace(", ", "_"), intrinsics, times)
        run(**at, threads=2, settings=LENIENT)
        found[label] = read_cameras(at["out"] / "rig.json")
        quality[label] = read_table(at["out"] / "quality_cameras.parquet").set_index("camera")
        pairs[label] = read_table(at["out"] / "pairs_cameras.parquet").set_index(["first", "second"])
        if label in REFITTED:
            refitted[label] = spread_over_bars(at, found[label], pairs[label], folder / "left_out")
        if label == "known, times":
            draw_corners(at, PICTURE)
    return "\n".join([
        "## Four webcams (caliscope)\n",
        wrapped(CALISCOPE.format(**CALISCOPE_BOARD)),
        _table("Focal length, px", authors, [
            {"": label, **{name: f"{camera.K[0, 0]:.1f} ± {camera.K[0, 0] * quality[label].focal_sigma[name]:.1f}"
                           for name, camera in cameras.items()}}
            for label, cameras in found.items()
        ], {name: f"{camera.K[0, 0]:.1f}" for name, camera in authors.items()}),
        _table("Reprojection error, px RMS, and error of the centre within the rig, mm", authors, [
            {"": label, **{name: f"{row.rms_px:.2f}; ± {1000 * row.center_sigma_m:.2f}"
                           for name, row in quality[label].iterrows()}}
            for label in found
        ]),
        _baselines(authors, pairs),
        _turns(authors, found, pairs),
        _refitted(refitted),
        "![Detected corners as circles, projected ones as crosses](pictures/rig_caliscope.jpg)\n",
        wrapped(
            "*The four cameras' views of one moment: circles are detected corners, crosses those of the calibrated rig "
            "(known, times). Photographs: caliscope, © 2024 Donald \"Mac\" Prible, BSD-2-Clause.*"
        ),
    ])  # fmt: skip


def spread_over_bars(
    at: Mapping[str, Path], cameras: Mapping[str, Camera], pairs: pd.DataFrame, folder: Path
) -> tuple[float, float]:
    """Jackknife's spread over error bars, root mean square over the pairs: of relative rotations, and of baselines.

    Each time a sixth of the shots, successive ones, is left out, and all is calibrated anew.
    """
    calibration = read_json(at["index"] / "calibration_cameras.json")
    shots = np.unique(read_table(at["out"] / "residuals_cameras.parquet").view)
    turns, lengths = np.zeros(len(pairs)), np.zeros(len(pairs))
    for out in np.array_split(shots, LEFT_OUT):
        shutil.copytree(at["index"], folder / "index", dirs_exist_ok=True)
        views = [view for view in calibration["views"] if view["view"] not in out]
        write_json(folder / "index/calibration_cameras.json", {**calibration, "views": views})
        run(capture=at["capture"], index=folder / "index", out=folder / "out", threads=2, settings=LENIENT)
        rest = read_cameras(folder / "out/rig.json")
        turns += [angle_deg(rest[a], rest[b], cameras[a], cameras[b]) ** 2 / 3 for a, b in pairs.index]
        apart = [np.linalg.norm(rest[a].center - rest[b].center) for a, b in pairs.index]
        lengths += (np.array(apart) - pairs.baseline_m) ** 2
    share = (LEFT_OUT - 1) / LEFT_OUT
    squares = (share * turns / pairs.turn_sigma_deg**2, share * lengths / pairs.baseline_sigma_m**2)
    return tuple(float(np.sqrt(np.mean(square))) for square in squares)


def _refitted(found: Mapping[str, tuple[float, float]]) -> str:
    told = ", ".join(f"{turns:.2f} and {lengths:.2f} ({label})" for label, (turns, lengths) in found.items())
    return wrapped(
        f"Calibrated anew {LEFT_OUT} times, each time without another sixth of the shots: the jackknife's spread over "
        f"the error bars, root mean square over the six pairs, is, of rotations and baselines, {told}."
    )


def wrapped(text: str) -> str:
    """A paragraph in lines of 120 letters."""
    return textwrap.fill(text, 120) + "\n"


def _table(title: str, authors: Mapping[str, Camera], rows: list[dict], first: dict[str, str] | None = None) -> str:
    rows = [{"": "authors", **first}, *rows] if first else rows
    lines = ["| " + " | ".join([title, *authors]) + " |", "|---" * (1 + len(authors)) + "|"]
    lines += ["| " + " | ".join(str(row[name]) for name in ("", *authors)) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _baselines(authors: Mapping[str, Camera], pairs: Mapping[str, pd.DataFrame]) -> str:
    lines = [f"| baseline, mm | authors | {' | '.join(pairs)} |", "|---" * (2 + len(pairs)) + "|"]
    for a, b in itertools.combinations(authors, 2):
        cells = [
            f"{1000 * table.baseline_m[a, b]:.1f} ± {1000 * table.baseline_sigma_m[a, b]:.1f}"
            for table in pairs.values()
        ]
        base = 1000 * np.linalg.norm(authors[a].center - authors[b].center)
        lines.append(f"| {a}, {b} | {base:.1f} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _turns(
    authors: Mapping[str, Camera], found: Mapping[str, Mapping[str, Camera]], pairs: Mapping[str, pd.DataFrame]
) -> str:
    lines = [f"| relative rotation | authors | {' | '.join(pairs)} |", "|---" * (2 + len(pairs)) + "|"]
    for a, b in itertools.combinations(authors, 2):
        cells = [
            f"{table.turn_deg[a, b]:.2f}° ± {table.turn_sigma_deg[a, b]:.2f}°; "
            f"{angle_deg(found[label][a], found[label][b], authors[a], authors[b]):.2f}°"
            for label, table in pairs.items()
        ]
        turn = np.degrees(np.linalg.norm(cv2.Rodrigues(authors[b].R @ authors[a].R.T)[0]))
        lines.append(f"| {a}, {b} | {turn:.2f}° | {' | '.join(cells)} |")
    said = (
        "Angle of each relative rotation, its standard deviation about one axis, and how far it is from the authors':"
    )
    return said + "\n\n" + "\n".join(lines) + "\n"


def checkerboard_section(data: Path, folder: Path) -> str:
    """A stereo pair and a checkerboard, of OpenCV's samples."""
    at = prepare_checkerboard(data, folder / "checkerboard")
    run(**at, threads=2)
    cameras, (pair,) = (
        read_cameras(at["out"] / "rig.json"),
        read_table(at["out"] / "pairs_cameras.parquet").itertuples(),
    )
    quality = read_table(at["out"] / "quality_cameras.parquet").set_index("camera")
    focal = {name: f"{c.K[0, 0]:.2f} ± {c.K[0, 0] * quality.focal_sigma[name]:.2f}" for name, c in cameras.items()}
    theirs = opencv_pair(data)
    rows = [
        ("focal length of the left camera, px", f"{opencv_left_focal(data):.2f}", focal["left"]),
        ("focal length of the right camera, px", f"{theirs.right_focal_px:.2f}", focal["right"]),
        ("reprojection error of the left camera, px RMS", f"{theirs.left_rms_px:.2f}", f"{quality.rms_px['left']:.2f}"),
        (
            "baseline, mm",
            f"{theirs.baseline_mm:.2f}",
            f"{1000 * pair.baseline_m:.2f} ± {1000 * pair.baseline_sigma_m:.2f}",
        ),
        ("turn between the cameras", f"{theirs.turn_deg:.2f}°", f"{pair.turn_deg:.2f}° ± {pair.turn_sigma_deg:.2f}°"),
    ]
    told = "\n".join(f"| {name} | {other} | {ours} |" for name, other, ours in rows)
    return (
        "## A stereo pair (OpenCV's samples)\n\n"
        + wrapped(
            "Thirteen pairs of photographs of a checkerboard of 10 x 7 squares (`samples/data`, Apache-2.0): "
            "the intrinsics that come with them, and cv2.calibrateCamera and cv2.stereoCalibrate."
        )
        + f"\n| | OpenCV | here |\n|---|---|---|\n{told}\n"
    )


def draw_corners(at: Mapping[str, Path], path: Path) -> None:
    """Write the four cameras' images of the shot that most see, with detected and projected corners."""
    residuals = read_table(at["out"] / "residuals_cameras.parquet")
    seen = residuals.groupby("view").camera.nunique()
    view = int(residuals[residuals.view.isin(seen[seen == seen.max()].index)].groupby("view").size().idxmax())
    entries = read_json(at["index"] / "calibration_cameras.json")["views"]
    names = sorted(residuals.camera.unique())
    panels = [
        _panel(read_view_gray(at["capture"], entry), residuals[(residuals.camera == name) & (residuals.view == view)])
        for name in names
        for entry in entries
        if entry["camera"] == name and entry["view"] == view
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.concatenate([np.concatenate(panels[:2], 1), np.concatenate(panels[2:], 1)]))


def _panel(gray: np.ndarray, corners: pd.DataFrame, side: int = 480) -> np.ndarray:
    """The board's part of an image, enlarged to a square of `side` pixels."""
    middle = corners[["x", "y"]].to_numpy().mean(0)
    half = 0.75 * max(np.ptp(corners.x), np.ptp(corners.y), 40)
    scale = side / (2 * half)
    move = np.array([[scale, 0, -scale * (middle[0] - half)], [0, scale, -scale * (middle[1] - half)]])
    move[:, 2] += scale / 2 - 0.5  # from pixel centres at (0.5, 0.5) to OpenCV's
    shown = cv2.cvtColor(cv2.warpAffine(gray, move, (side, side), flags=cv2.INTER_CUBIC), cv2.COLOR_GRAY2BGR)
    for row in corners.itertuples():
        seen = np.array([row.x, row.y])
        at = (scale * (seen - middle + half) - 0.5) * 16
        hit = at + 16 * scale * np.array([row.residual_x, row.residual_y])
        cv2.circle(shown, tuple(np.round(at).astype(int).tolist()), 9 * 16, (60, 220, 60), 1, cv2.LINE_AA, 4)
        for dx, dy in ((7, 0), (0, 7)):
            ends = [np.round(hit + 16 * sign * np.array([dx, dy])).astype(int).tolist() for sign in (-1, 1)]
            cv2.line(shown, tuple(ends[0]), tuple(ends[1]), (60, 60, 255), 1, cv2.LINE_AA, 4)
    return shown


def main() -> None:
    """Calibrate all rigs and write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    data = parser.parse_args().data
    with tempfile.TemporaryDirectory() as name:
        sections = [
            caliscope_section(data / "rig_caliscope", Path(name)),
            checkerboard_section(data / "calib_opencv_chessboard", Path(name)),
        ]
    boardless = BOARDLESS.format(part=read_between(PAGE, "feature rigs"))
    PAGE.write_text("\n".join([HEAD, *sections]) + boardless)


if __name__ == "__main__":
    main()
