"""The rig's own bundle adjustment beside pycolmap's, and trimesh beside our readers of meshes: a page of docs.

    python -m benchmarks.bench_adjusters --captures captures/subjectA captures/head60 --results results

Corners are those detected in the captures' images, whose truth is known, and those that planted cameras see, with noise
and gross errors. All start from the same cameras, and estimate f, principal point and distortion. Seconds are of the
adjustment alone, medians over repeats that take the methods in turn.
"""

from __future__ import annotations

import argparse
import io
import statistics
import time
import tokenize
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import bundle_adjusters
from benchmarks.adjusters_page import page
from benchmarks.bench_bundle_adjustment import errors, read_corners
from benchmarks.bundle_adjusters import LOSS_PX, adjust_with_colmap
from benchmarks.mesh_readers import compare_readers
from pipeline.calibration.cameras.board_views import BoardViews
from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_start import Start, start_rig
from pipeline.geometry.cameras import Camera
from pipeline.geometry.least_squares import CAUCHY
from tests.support.rigs.cameras import BOARD, boards_in_stage, observe, planted_cameras, without_small_views

PAGE = Path("docs/bundle_adjustment.md")

PLANTED = {16: 60, 32: 100}
"""Cameras of planted rigs, and board poses."""

NOISE_PX, GROSS_SHARE, GROSS_PX = 0.2, 0.03, 20.0

OURS = ("rig.py", "rig_model.py", "intrinsics_priors.py", "rig_inputs.py", "board_motion.py")
"""Modules of ours that hold the adjustment."""

COLMAP_FUNCTIONS = ("adjust_with_colmap", "_focal_bars", "_noise_px", "_rigid")
"""Functions of `bundle_adjusters` that hand the problem to pycolmap."""

Adjust = Callable[[BoardViews, Start, float], tuple[list[Camera], np.ndarray]]


@dataclass(frozen=True)
class Row:
    """One method on one rig.

    Attributes:
        center_mm, focal_percent: root mean square errors over the cameras.
        bars: root mean square of the focal lengths' errors over their error bars; 1 is honest.
        seconds: of the adjustment.
    """

    data: str
    cameras: int
    corners: int
    method: str
    center_mm: float
    focal_percent: float
    bars: float
    seconds: float


def ours(found: BoardViews, start: Start, terms: int) -> tuple[list[Camera], np.ndarray]:
    rig = adjust_rig(found.observations, found.corners_m, start.cameras, start.rig_from_board, terms)
    return rig.cameras, rig.focal_sigma


METHODS: dict[str, Adjust] = {
    "ours": lambda found, start, scale: ours(found, start, 5),
    "pycolmap, robust": lambda found, start, scale: adjust_with_colmap(found, start, "CAUCHY", True, scale),
    "pycolmap, least squares": lambda found, start, scale: adjust_with_colmap(found, start, "TRIVIAL", True),
}


def planted(count: int, gross: float) -> tuple[BoardViews, list[Camera]]:
    """Cameras all around and what they see of a board, by OpenCV's projection."""
    random = np.random.default_rng(count)
    cameras = planted_cameras(count, random, arc=2 * np.pi)
    seen = observe(cameras, boards_in_stage(PLANTED[count], random, arc=2 * np.pi), NOISE_PX, random)
    wrong = random.random(len(seen.pixel)) < gross
    seen.pixel[wrong] += random.uniform(-GROSS_PX, GROSS_PX, (int(wrong.sum()), 2))
    chosen, numbers = without_small_views(seen)
    return BoardViews(chosen, BOARD.corners_m(), numbers, np.zeros(len(numbers), np.int64)), cameras


def compare(data: str, found: BoardViews, truth: list[Camera], repeats: int, scale_px: float = LOSS_PX) -> list[Row]:
    """A row for each method; `scale_px`: of pycolmap's loss."""
    start = start_rig(found.observations, found.corners_m, [(camera.width, camera.height) for camera in truth])
    seconds: dict[str, list[float]] = {method: [] for method in METHODS}
    solved = {}
    for _ in range(repeats):
        for method, adjust in METHODS.items():
            began = time.perf_counter()
            solved[method] = adjust(found, start, scale_px)
            seconds[method].append(time.perf_counter() - began)
    rows = []
    for method, (cameras, sigma) in solved.items():
        away = errors(cameras, truth)
        focal = np.array([c.K[0, 0] / t.K[0, 0] - 1 for c, t in zip(cameras, truth, strict=True)])
        rows.append(Row(
            data, len(truth), len(found.observations.corner), method, away["center_error_mm"],
            away["focal_error_percent"], float(np.sqrt(((focal / sigma) ** 2).mean())),
            statistics.median(seconds[method]),
        ))  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def lines_of_code(path: Path, function: str = "") -> int:
    """Lines that hold code, comments and docstrings left out: of a file, or of one function of it."""
    text = path.read_text()
    if function:
        start = text.index(f"def {function}(")
        text = text[start:].split("\n\n\n")[0]
    lines: set[int] = set()
    skip = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    previous = tokenize.NEWLINE
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        alone = token.type == tokenize.STRING and previous in (tokenize.NEWLINE, tokenize.INDENT, tokenize.NL)
        if token.type not in skip and not alone:
            lines.update(range(token.start[0], token.end[0] + 1))
        if token.type != tokenize.COMMENT:
            previous = token.type
    return len(lines)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--captures", type=Path, nargs="*", default=[])
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=PAGE)
    options = parser.parse_args()
    rows = []
    for capture in options.captures:
        found, _, truth = read_corners(capture, options.results / capture.name)
        rows += compare(f"{capture.name}, detected", found, truth, options.repeats)
    for count in PLANTED:
        for gross in (0.0, GROSS_SHARE):
            name = f"planted, {gross:.0%} gross errors" if gross else "planted"
            rows += compare(name, *planted(count, gross), options.repeats, CAUCHY * NOISE_PX)
    folder = Path("pipeline/calibration/cameras")
    lines = {
        "ours": sum(lines_of_code(folder / name) for name in OURS),
        "pycolmap": sum(lines_of_code(Path(bundle_adjusters.__file__), name) for name in COLMAP_FUNCTIONS),
        "obj": lines_of_code(Path("pipeline/geometry/mesh_files.py"), "_decode_obj"),
    }
    options.out.write_text(page(rows, lines, compare_readers(options.repeats)))


if __name__ == "__main__":
    main()
