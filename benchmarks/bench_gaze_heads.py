"""Limits of estimate_gaze on heads they were not set on: other draws, colours and gloss, and a real face.

    python -m benchmarks.bench_gaze_heads [--frames 4] [--close-ups 2] [--face ../shared/data/face_near_lights]

Fully lit frames of procedural heads by the cameras in front of them, with noise and colour responses; meshes and
cameras are the true ones, so that what counts is whether pixels are taken for an iris. Eyes ought to be estimated;
skin, over which spheres as large as eyes are laid, ought not to be. On the real face, whose eyes are closed, such
spheres lie everywhere.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from benchmarks.bench_gaze import PATCHES_M, RADIUS_M
from benchmarks.closed_eyes import (
    HALVES,
    LIDS,
    face_camera,
    lid_places,
    read_pictures,
    sphere_pixels,
    sphere_places,
)
from benchmarks.face_lights import IMAGES
from benchmarks.painted_heads import Look, painted, photograph_head, settings_for
from pipeline.eyes.eye_shape import usual_shape
from pipeline.eyes.gaze_estimate import GazeEstimate, estimate_gaze
from pipeline.stages.synthesize_capture import build_subject
from pipeline.synthesis.eyeball import EYE_NAMES, EYE_RADIUS_M
from pipeline.synthesis.head_appearance import IRIS, SKIN

SIZES = {5: Path("config/subjects/subjectB.yaml"), 15: Path("benchmarks/head_close_up.yaml")}
"""Width of an iris, pixels, and the settings of such a head."""

FIRST_S, LAST_S = 0.1, 1.7
"""Times of segment a, in which the head turns to either side and back and its eyes go about."""

LOOKS = {
    "colours as before, another draw": Look("another", tuple(SKIN), tuple(IRIS), 0.3),
    "dark skin, brown iris, glossier": Look("dark", (0.11, 0.06, 0.04), (0.06, 0.03, 0.015), 0.2),
    "pale skin, light grey iris, duller": Look("pale", (0.72, 0.52, 0.43), (0.27, 0.32, 0.34), 0.45),
    "olive skin, hazel iris": Look("olive", (0.40, 0.25, 0.15), (0.20, 0.13, 0.05), 0.3),
}

COLUMNS = ("head", "iris, px", "eyes estimated", "explained", "gaze off, rms", "skin taken for eyes", "explained")

FACE_PICTURES = {"two pictures, of half of the lamps each": HALVES, "one picture per lamp": [(n,) for n in IMAGES]}
"""Lamps that are added up, by what is said of them."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=4, help="of each small head")
    parser.add_argument("--close-ups", type=int, default=2, help="of each large head")
    parser.add_argument("--face", type=Path, default=Path("../shared/data/face_near_lights"), help="a real face")
    options = parser.parse_args()
    print(f"| {' | '.join(COLUMNS)} |\n" + "|---" * len(COLUMNS) + "|")
    for name, look in LOOKS.items():
        for (width, file), frames in zip(SIZES.items(), (options.frames, options.close_ups), strict=True):
            if frames:
                print(f"| {name} | {width} | {' | '.join(head_cells(look, file, frames))} |", flush=True)
    print("\n| a real face, eyes closed | where | taken for eyes | explained |\n|---|---|---|---|")
    for name, together in FACE_PICTURES.items():
        spots = {**{lid: lid_places(lid) for lid in LIDS}, "all over the face": sphere_places(options.face)}
        for spot, places in spots.items():
            found = face_estimates(options.face, together, places)
            print(f"| {name} | {spot} | {counted(found)} | {explained(found)} |", flush=True)


def head_cells(look: Look, file: Path, frames: int) -> list[str]:
    """Eyes and skin of one head, as `COLUMNS` has them."""
    settings = settings_for(look, file)
    head = painted(build_subject(look.seed, settings), look)
    with tempfile.TemporaryDirectory() as folder:
        shown = photograph_head(head, look.seed, settings, np.linspace(FIRST_S, LAST_S, frames).tolist(), Path(folder))
    eyes = {name: estimate_gaze(shown.pixels[name], usual_shape(EYE_RADIUS_M)) for name in EYE_NAMES}
    skin = {name: estimate_gaze(shown.pixels[name], usual_shape(RADIUS_M)) for name in PATCHES_M}
    off = [
        angle_deg(estimate.direction, true)
        for found in eyes.values()
        for estimate, true in zip(found, shown.gaze, strict=True)
        if estimate.status == "estimated"
    ]
    all_eyes, all_skin = ([estimate for found in part.values() for estimate in found] for part in (eyes, skin))
    names = [name for name, found in skin.items() if any(estimate.status == "estimated" for estimate in found)]
    return [
        counted(all_eyes), explained(all_eyes), f"{np.sqrt(np.mean(np.square(off))):.1f}°" if off else "none",
        counted(all_skin) + (f": {', '.join(names)}" if names else ""), explained(all_skin),
    ]  # fmt: skip


def face_estimates(
    folder: Path, together: Sequence[tuple[int, ...]], places: Float64[np.ndarray, "places 2"]
) -> list[GazeEstimate]:
    """Estimates of spheres laid over places of the real face, each for itself."""
    pictures, camera = read_pictures(folder, together), face_camera(folder)
    shape = usual_shape(RADIUS_M)
    return [estimate_gaze([sphere_pixels(pictures, camera, place)], shape)[0] for place in places]


def counted(found: Sequence[GazeEstimate]) -> str:
    """How many have an estimate, of those that pictures show."""
    shown = [estimate for estimate in found if estimate.status != "hidden"]
    return f"{sum(estimate.status == 'estimated' for estimate in shown)} of {len(shown)}"


def explained(found: Sequence[GazeEstimate]) -> str:
    """Range of the share that an iris explains."""
    shown = [estimate.explained for estimate in found if estimate.status != "hidden"]
    return f"{min(shown):.2f} to {max(shown):.2f}" if shown else ""


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two directions, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


if __name__ == "__main__":
    main()
