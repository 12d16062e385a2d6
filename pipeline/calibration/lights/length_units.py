"""Check that three lengths are in one unit.

The calibration board's squares, the ball's radius, the surveyed lights.

The board gives the rig its unit. Cameras that see one ball from two sides measure its radius in that unit, and the
calibrated lights beside the surveyed ones give the third. A rigid alignment alone would hide that they differ.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.calibration.lights.mirror_ball import outline_cone
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rigid_alignment import fit_scale

log = logging.getLogger(__name__)

BALL_ERROR = 0.01
"""Relative error of a rig's size by a ball: its outlines are good to half a pixel, of a radius of 50."""

UNITS = {1000.0: "millimetres", 100.0: "centimetres", 39.37: "inches", 3.281: "feet"}
"""How many of each are a metre."""

SAME_UNIT = 0.15
"""Relative difference up to which a factor is named after a unit: the nearest two, 39 and 100, are far apart."""


def radius_in_rig(
    cameras: Mapping[str, Camera], outlines: Mapping[tuple[str, str], Float64[np.ndarray, "_ 2"]]
) -> float | None:
    """Radius of the ball in the cameras' unit, median over positions.

    None if no two cameras see one position.

    Each outline gives a cone; the axes of one position meet at its centre, and the radius is distance times the sine
    of the half angle. `outlines`: per (position, camera), pixels.
    """
    found = []
    for position in sorted({position for position, _ in outlines}):
        seen = [(cameras[name], outline) for (p, name), outline in outlines.items() if p == position]
        cones = [outline_cone(camera, outline) for camera, outline in seen]
        # The point with the least squared distance to all axes.
        across = [np.eye(3) - np.outer(axis, axis) for axis, _ in cones]
        if len(seen) < 2 or np.linalg.cond(sum(across)) > 1e6:
            continue
        center = np.linalg.solve(sum(across), sum(a @ c.center for a, (c, _) in zip(across, seen, strict=True)))
        distances = [np.linalg.norm(center - camera.center) for camera, _ in seen]
        found += [d * np.sin(half) for d, (_, half) in zip(distances, cones, strict=True)]
    return float(np.median(found)) if found else None


def unit_complaint(ball: float, survey: float, tolerance: float) -> tuple[str, str, str, str, str] | None:
    """Complaint of the one length in another unit; None if they agree.

    As (file, key, expected, found, what to do).

    Args:
        ball: radius of the ball as the rig measures it, over the radius that capture.yaml says.
        survey: size of the surveyed stage over that of the same lights in the rig.
        tolerance: relative difference that is none.
    """

    def differs(ratio: float) -> bool:
        return abs(math.log(ratio)) > tolerance

    if not differs(ball) and not differs(survey):
        return None
    expected = "board, mirror ball and surveyed lights in one unit, metres"
    if not differs(ball):
        found = f"lights {_times(survey)} in lights.csv as in the rig that the board measured, and the ball on its side"
        return "lights.csv", "x, y, z", expected, found, f"convert lights.csv to metres: divide x, y, z by {survey:.4g}"
    if not differs(survey):
        found = f"a ball {_times(ball)} in the rig as radius_m says, and the surveyed lights on the rig's side"
        return (
            "capture.yaml",
            "calibration.lights.radius_m",
            expected,
            found,
            f"multiply radius_m by {ball:.4g}, or all the others",
        )
    if not differs(ball * survey):
        found = f"a rig {_times(ball)} as ball and surveyed lights say, which agree with each other"
        return (
            "capture.yaml",
            "calibration.cameras.square_m",
            expected,
            found,
            f"divide square_m and marker_m by {ball:.4g}",
        )
    found = f"a ball {_times(ball)} in the rig as radius_m says, and surveyed lights {_times(survey)} as in the rig"
    return (
        "capture.yaml",
        "calibration",
        expected,
        found,
        "measure square_m, radius_m and the distance of two lights again, in metres",
    )


def size_by_lights(
    facts: pd.DataFrame, cameras: Mapping[str, Camera], survey: pd.DataFrame
) -> tuple[pd.DataFrame, dict[str, Camera]]:
    """Make lights and cameras of a rig without boards as large as the survey says.

    If that knows better than the ball.

    The rig had its size from the ball's radius, which outlines tell to `BALL_ERROR`.

    Args:
        facts: of `measure_lights`, with the column `why`, empty for lights that are measured well.
        survey: light, x, y, z.
    """
    well = facts[facts.why == ""]
    surveyed = survey.set_index("light").loc[well.index, list("xyz")].to_numpy(np.float64)
    try:
        scale, sigma = fit_scale(well[list("xyz")].to_numpy(np.float64), surveyed)
    except ValueError:
        return facts, dict(cameras)
    if sigma / scale > BALL_ERROR:
        log.info("size of the rig: the surveyed lights tell it to %.1f %%; the ball's stays", 100 * sigma / scale)
        return facts, dict(cameras)
    log.info("size of the rig by the surveyed lights: %.4f +- %.4f times that by the ball", scale, sigma)
    larger = facts.copy()
    larger[["x", "y", "z", "sigma_m"]] *= scale
    larger[[column for column in facts if str(column).startswith("cov_")]] *= scale**2
    return larger, {name: replace(camera, t=scale * camera.t) for name, camera in cameras.items()}


def _times(ratio: float) -> str:
    """`100 times as large (centimetres for metres?)`."""
    names = [
        f" ({name} for metres?)" if ratio > 1 else f" (metres for {name}?)"
        for factor, name in UNITS.items()
        if abs(math.log(max(ratio, 1 / ratio) / factor)) < SAME_UNIT
    ]
    return f"{ratio:.4g} times as large{''.join(names)}"
