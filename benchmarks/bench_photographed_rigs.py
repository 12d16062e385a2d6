"""Calibrations of photographed rigs beside those of their authors: a page of docs and its picture.

    python -m benchmarks.bench_photographed_rigs --data ../shared/data

The data are described on that page. Where images were not taken at once, the authors' poses are no truth: how far poses
scatter when some of the shots are left out says which of two is to be believed.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import textwrap
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from benchmarks.photographed_rigs import (
    CALISCOPE_BOARD,
    caliscope_cameras,
    opencv_left_focal,
    prepare_caliscope,
    prepare_checkerboard,
)
from pipeline.base.files import read_json, read_table
from pipeline.capture.gray import read_view_gray
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.stages.calibrate_cameras import run

PAGE = Path("docs/photographed_rigs.md")
PICTURE = Path("docs/pictures/rig_caliscope.jpg")

VARIANTS = {
    "known, at once": ("known", False),
    "known, times": ("known", True),
    "refine, times": ("refine", True),
    "estimate, times": ("estimate", True),
}
"""Lenses, and whether the images' times count."""

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
smaller than the spread when groups of shots are left out; those of *known* take the authors' lenses for true.
"""


def angle_deg(a: Camera, b: Camera, other_a: Camera, other_b: Camera) -> float:
    """Angle between the relative rotations of two pairs of cameras, degrees."""
    turn = (b.R @ a.R.T) @ (other_b.R @ other_a.R.T).T
    return float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))


def caliscope_section(data: Path, folder: Path) -> str:
    """Four cameras on stands, a board moved by hand: authors, and the four variants."""
    authors, found, quality = caliscope_cameras(data), {}, {}
    for label, (intrinsics, times) in VARIANTS.items():
        at = prepare_caliscope(data, folder / label.replace(", ", "_"), intrinsics, times)
        # By default, images taken for simultaneous are refused, as if a camera had been knocked; so are lenses whose
        # error bars are above a per cent.
        run(**at, threads=2, settings=CalibrateCameras(largest_shift_px=1e3, largest_focal_error=1.0))
        found[label] = read_cameras(at["out"] / "rig.json")
        quality[label] = read_table(at["out"] / "quality_cameras.parquet").set_index("camera")
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
        _pairs(authors, found, quality),
        "![Detected corners as circles, projected ones as crosses](pictures/rig_caliscope.jpg)\n",
        wrapped(
            "*The four cameras' views of one moment: circles are detected corners, crosses those of the calibrated rig "
            "(known, times). Photographs: caliscope, © 2024 Donald \"Mac\" Prible, BSD-2-Clause.*"
        ),
    ])  # fmt: skip


def wrapped(text: str) -> str:
    """A paragraph in lines of 120 letters."""
    return textwrap.fill(text, 120) + "\n"


def _table(title: str, authors: Mapping[str, Camera], rows: list[dict], first: dict[str, str] | None = None) -> str:
    rows = [{"": "authors", **first}, *rows] if first else rows
    lines = ["| " + " | ".join([title, *authors]) + " |", "|---" * (1 + len(authors)) + "|"]
    lines += ["| " + " | ".join(str(row[name]) for name in ("", *authors)) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _pairs(
    authors: Mapping[str, Camera], found: Mapping[str, Mapping[str, Camera]], quality: Mapping[str, pd.DataFrame]
) -> str:
    lines = [f"| cameras | authors, mm | {' | '.join(found)} |", "|---" * (2 + len(found)) + "|"]
    for a, b in itertools.combinations(authors, 2):
        cells = [
            f"{1000 * np.linalg.norm(cameras[a].center - cameras[b].center):.1f} "
            f"± {1000 * np.hypot(*quality[label].center_sigma_m[[a, b]]):.1f} mm, "
            f"{angle_deg(cameras[a], cameras[b], authors[a], authors[b]):.2f} "
            f"± {np.sqrt(3) * np.hypot(*quality[label].turn_sigma_deg[[a, b]]):.2f}°"
            for label, cameras in found.items()
        ]
        base = 1000 * np.linalg.norm(authors[a].center - authors[b].center)
        lines.append(f"| {a}, {b} | {base:.1f} | {' | '.join(cells)} |")
    told = (
        "Baselines, and angles between the relative rotations and the authors', each with the angle (root mean square) "
        "that our error bars make of it, theirs being unknown:"
    )
    return f"{wrapped(told)}\n" + "\n".join(lines) + "\n"


def checkerboard_section(data: Path, folder: Path) -> str:
    """A stereo pair and a checkerboard, of OpenCV's samples."""
    at = prepare_checkerboard(data, folder / "checkerboard")
    run(**at, threads=2)
    cameras = read_cameras(at["out"] / "rig.json")
    quality = read_table(at["out"] / "quality_cameras.parquet").set_index("camera")
    left, right = cameras["left"], cameras["right"]
    focal = {name: f"{c.K[0, 0]:.2f} ± {c.K[0, 0] * quality.focal_sigma[name]:.2f}" for name, c in cameras.items()}
    baseline = 1000 * np.linalg.norm(left.center - right.center)
    rows = [
        ("focal length of the left camera, px", f"{opencv_left_focal(data):.2f}", focal["left"]),
        ("focal length of the right camera, px", "", focal["right"]),
        ("reprojection error of the left camera, px RMS", "0.41", f"{quality.rms_px['left']:.2f}"),
        ("baseline, mm", "83.6", f"{baseline:.2f} ± {1000 * np.sqrt(2) * quality.center_sigma_m['left']:.2f}"),
    ]
    told = "\n".join(f"| {name} | {theirs} | {ours} |" for name, theirs, ours in rows)
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
    PAGE.write_text("\n".join([HEAD, *sections]))


if __name__ == "__main__":
    main()
