"""Photographed rigs calibrated without any board, beside the same rigs by their boards: a part of a page of docs.

    python -m benchmarks.bench_feature_rigs --data ../shared/data

Writes the part between the marks `feature rigs` of docs/photographed_rigs.md, and its picture. Sizes come from one
distance, which the boards give; lenses, where they are known, from the authors or from the boards.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pycolmap

from benchmarks.bench_photographed_rigs import LENIENT, PAGE, angle_deg, wrapped
from benchmarks.feature_rigs import IMAGES, prepare_stereo_pair, prepare_webcams
from benchmarks.marked_page import write_between
from benchmarks.photographed_rigs import caliscope_cameras, prepare_caliscope, prepare_checkerboard
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table
from pipeline.calibration.cameras.feature_calibration import starting_lenses
from pipeline.calibration.cameras.feature_matches import PairMatches, count_matches, join_moments, write_features
from pipeline.calibration.cameras.rig_inputs import RigPriors
from pipeline.capture.images import ImageSource
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.stages.calibrate_cameras import run

PICTURE = Path("docs/pictures/feature_matches.jpg")

PLACED = ("cam_0", "cam_3", "cam_2")
"""Of caliscope's webcams; the first and the last give the rig its size."""

SHOWN = ("cam_0", "cam_3")
"""Pair whose matches are drawn, of the moment that has most."""

BEFORE = """\
A rig needs no board if its cameras see points of the subject, or of the room, alike (`calibration.cameras.method:
features`, [your capture](your_capture.md#cameras-without-any-board)). Both rigs above once more: their boards are
objects like all others. No masks: features are of all that is seen. The size is that of one distance, which the
boards give. Error bars are the jackknife's, over parts of the images.
"""

READING = """\
With the authors' lenses, rotations are as far from the boards' as their error bars say; baselines are many times
farther off. Posters in the margin of cam_0's images fit least, where no board was ever seen: what is wrong there with
a given lens is in no error bar. Nor is what a lens that is estimated leaves out, which has one coefficient and its
principal point in the middle of the image, where the authors' are tens of pixels off it: rotations then differ by far
more than their bars. Boards are better wherever there are any.
"""

SHARED = """\
*Features that cam_0 and cam_3 share at one moment, each in a colour of its own: posters on the wall, the board, a
pair of glasses. Photographs: caliscope, © 2024 Donald "Mac" Prible, BSD-2-Clause.*
"""


@dataclass(frozen=True)
class Calibrated:
    """A rig as calibrate_cameras wrote it."""

    cameras: dict[str, Camera]
    pairs: pd.DataFrame
    quality: pd.DataFrame


def calibrated(arguments: Mapping[str, Path]) -> Calibrated:
    """Calibrate, also lenses that are too uncertain to be used by default."""
    run(**arguments, threads=1, settings=LENIENT)
    out = arguments["out"]
    pairs = read_table(out / "pairs_cameras.parquet").set_index(["first", "second"])
    quality = read_table(out / "quality_cameras.parquet").set_index("camera")
    return Calibrated(read_cameras(out / "rig.json"), pairs, quality)


def refusal(arguments: Mapping[str, Path], strict: bool) -> list[str]:
    """What a refused calibration says of its cameras.

    Args:
        strict: judged as by default; else only what cannot be done is refused.
    """
    try:
        run(**arguments, threads=1, **({} if strict else {"settings": LENIENT}))
    except InputError as error:
        return [line.strip().removeprefix("calibration.cameras: ") for line in str(error).splitlines()[1:]]
    raise SystemExit(f"{arguments['capture']}: expected a rig that is refused")


def matches_of(arguments: Mapping[str, Path], lenses: Mapping[str, Camera], folder: Path) -> list[PairMatches]:
    """Features that every two cameras share; `folder` keeps COLMAP's tables of them."""
    views = read_json(arguments["index"] / "calibration_cameras.json")["views"]
    folder.mkdir(parents=True)
    features = write_features(ImageSource.from_index(arguments["capture"], IMAGES), views, folder, 1)
    sizes = {name: (lens.width, lens.height) for name, lens in lenses.items()}
    join_moments(features, starting_lenses(sizes, 1.0, RigPriors(list(lenses.values()))), folder)
    return count_matches(list(lenses), folder)


def match_table(matches: Sequence[PairMatches]) -> str:
    """How many features every two cameras share."""
    lines = ["| features | alike | of which fit one pose |", "|---|---|---|"]
    for pair in matches:
        flat = ", all on one plane" if pair.flat else ""
        lines.append(f"| {pair.first}, {pair.second} | {pair.found} | {pair.verified}{flat} |")
    return "\n".join(lines) + "\n"


def pair_tables(boards: Calibrated, variants: Mapping[str, Calibrated]) -> str:
    """Baselines and relative rotations by features, beside those by boards."""
    lines = [f"| baseline, mm | boards | {' | '.join(variants)} |", "|---" * (2 + len(variants)) + "|"]
    turns = [f"| relative rotation | boards | {' | '.join(variants)} |", lines[1]]
    for a, b in itertools.combinations(next(iter(variants.values())).cameras, 2):
        row = boards.pairs.loc[(a, b)]
        own = [each.pairs.loc[(a, b)] for each in variants.values()]
        cells = [f"{1000 * r.baseline_m:.1f} ± {1000 * r.baseline_sigma_m:.1f}" for r in (row, *own)]
        lines.append(f"| {a}, {b} | {' | '.join(cells)} |")
        apart = [
            angle_deg(each.cameras[a], each.cameras[b], boards.cameras[a], boards.cameras[b])
            for each in variants.values()
        ]
        cells = [f"{row.turn_deg:.2f}° ± {row.turn_sigma_deg:.2f}°"]
        cells += [f"{r.turn_deg:.2f}° ± {r.turn_sigma_deg:.2f}°; {off:.2f}°" for r, off in zip(own, apart, strict=True)]
        turns.append(f"| {a}, {b} | {' | '.join(cells)} |")
    said = "Angle of each relative rotation, its standard deviation about one axis, and how far it is from the boards':"
    return "\n".join(lines) + "\n\n" + said + "\n\n" + "\n".join(turns) + "\n"


def lens_table(boards: Calibrated, variants: Mapping[str, Calibrated]) -> str:
    """Focal lengths, features used and reprojection errors."""
    names = list(next(iter(variants.values())).cameras)
    lines = [f"| focal length, px; features; RMS, px | {' | '.join(names)} |", "|---" * (1 + len(names)) + "|"]
    cells = [f"{boards.cameras[name].K[0, 0]:.1f}; ; {boards.quality.rms_px[name]:.2f}" for name in names]
    lines.append(f"| boards | {' | '.join(cells)} |")
    for label, each in variants.items():
        cells = [
            f"{camera.K[0, 0]:.1f} ± {camera.K[0, 0] * each.quality.focal_sigma[name]:.1f}; "
            f"{each.quality.corners[name]}; {each.quality.rms_px[name]:.2f}"
            for name, camera in each.cameras.items()
        ]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def webcam_section(data: Path, folder: Path) -> str:
    """Caliscope's four webcams, of which three can be placed."""
    authors = caliscope_cameras(data)
    boards = calibrated(prepare_caliscope(data, folder / "boards", "known"))
    metres = float(boards.pairs.baseline_m[tuple(sorted((PLACED[0], PLACED[-1])))])
    every = prepare_webcams(data, folder / "all", authors, 1.0, "known")
    matches = matches_of(every, authors, folder / "matches")
    draw_matches(every, folder / "matches", list(authors), PICTURE)
    lenses = {name: authors[name] for name in PLACED}
    variants = {
        f"features, lenses {intrinsics}": calibrated(
            prepare_webcams(data, folder / intrinsics, lenses, metres, intrinsics)
        )
        for intrinsics in ("known", "estimate")
    }
    refused = "\n".join(f"> {line}" for line in refusal(every, strict=False))
    return "\n".join([
        "### Three of the four webcams\n",
        wrapped(
            "Eight moments of the videos. Baselines and rotations by boards are those of *known, times*; *known* has "
            "the authors' lenses, *estimate* finds a focal length and one coefficient of distortion for each."
        ),
        match_table(matches),
        wrapped("cam_1 stands 56 to 84 degrees from the others, and with it the rig is refused:"),
        refused + "\n",
        pair_tables(boards, variants),
        lens_table(boards, variants),
        "![Features that two webcams share](pictures/feature_matches.jpg)\n",
        wrapped(SHARED),
        wrapped(READING),
    ])  # fmt: skip


def stereo_section(data: Path, folder: Path) -> str:
    """OpenCV's stereo pair, with the lenses of the boards and without any."""
    boards = calibrated(prepare_checkerboard(data, folder / "boards"))
    metres = float(boards.pairs.baseline_m.iloc[0])
    known = prepare_stereo_pair(data, folder / "known", boards.cameras, metres, "known")
    matches = matches_of(known, boards.cameras, folder / "matches")
    variants = {"features, lenses known": calibrated(known)}
    estimated = prepare_stereo_pair(data, folder / "estimate", boards.cameras, metres, "estimate")
    refused = "\n".join(f"> {line}" for line in refusal(estimated, strict=True))
    (a, b), found = ("left", "right"), variants["features, lenses known"].cameras
    ways = [rig[a].R @ (rig[b].center - rig[a].center) / metres for rig in (found, boards.cameras)]
    toward = np.degrees(np.arccos(np.clip(ways[0] @ ways[1] / np.prod(np.linalg.norm(ways, axis=1)), -1, 1)))
    return "\n".join([
        "### The stereo pair\n",
        wrapped(
            "Its baseline is the given distance; what is measured is the turn, and the direction in which the right "
            f"camera stands: {toward:.2f} degrees from that by the boards. Lenses are those of the boards."
        ),
        match_table(matches),
        pair_tables(boards, variants),
        lens_table(boards, variants),
        wrapped(
            "With lenses that nothing tells it is refused: nearly parallel views of two cameras fit any focal length."
        ),
        refused + "\n",
    ])  # fmt: skip


def draw_matches(arguments: Mapping[str, Path], folder: Path, cameras: Sequence[str], path: Path) -> None:
    """Write two cameras' images of one moment beside each other, with lines between verified matches."""
    views = read_json(arguments["index"] / "calibration_cameras.json")["views"]
    first, second = (cameras.index(name) + 1 for name in SHOWN)
    with pycolmap.Database.open(folder / "rig.db") as joined, pycolmap.Database.open(folder / "moments.db") as single:
        pairs = joined.read_two_view_geometry(first, second).inlier_matches
        pixels = [joined.read_keypoints(number)[:, :2] for number in (first, second)]
        ids = {image.name: image.image_id for image in single.read_all_images()}
        counts = {
            name: np.cumsum([0, *(len(single.read_keypoints(ids[f"{place:06d}.png"]))
                                  for place, view in enumerate(views) if view["camera"] == name)])
            for name in SHOWN
        }  # fmt: skip
    moments = np.searchsorted(counts[SHOWN[0]], pairs[:, 0], side="right") - 1
    best = int(np.bincount(moments).argmax())
    shown = [
        cv2.imread(str(arguments["capture"] / [view for view in views if view["camera"] == name][best]["path"]))
        for name in SHOWN
    ]
    panel = cv2.resize(np.concatenate(shown, 1), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    colors = np.random.default_rng(0).integers(80, 256, (len(pairs), 3))
    for (a, b), color in zip(pairs[moments == best], colors, strict=False):
        ends = [0.5 * pixels[0][a], 0.5 * (pixels[1][b] + [shown[0].shape[1], 0])]
        start, end = (tuple(np.round(16 * (place - 0.5)).astype(int).tolist()) for place in ends)
        cv2.line(panel, start, end, color.tolist(), 1, cv2.LINE_AA, 4)
        for place in (start, end):
            cv2.circle(panel, place, 3 * 16, color.tolist(), 1, cv2.LINE_AA, 4)
    cv2.imwrite(str(path), panel, [cv2.IMWRITE_JPEG_QUALITY, 80])


def main() -> None:
    """Calibrate both rigs and write the part of the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    data = parser.parse_args().data
    with tempfile.TemporaryDirectory() as name:
        parts = [
            wrapped(BEFORE),
            webcam_section(data / "rig_caliscope", Path(name) / "webcams"),
            stereo_section(data / "calib_opencv_chessboard", Path(name) / "pair"),
        ]
    write_between(PAGE, "feature rigs", ["\n".join(parts).rstrip()])


if __name__ == "__main__":
    main()
