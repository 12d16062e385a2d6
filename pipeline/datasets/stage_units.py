"""Units of poses: cameras stand among the lights of a stage, and are about as far apart."""

from __future__ import annotations

import logging
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float64

from pipeline.base.errors import InputError

log = logging.getLogger(__name__)

NEAR = 2.0
"""Largest factor between the extents of cameras and of lights: they hang on one frame, and cameras on one side alone
are less far from their mean. Units that sets confuse differ by 4 and more."""


def unit_of_stage(
    cameras: Float64[np.ndarray, "cameras 3"], lights: Float64[np.ndarray, "lights 3"], units: Mapping[float, str],
    where: str,
) -> tuple[float, str]:  # fmt: skip
    """The unit in which cameras are as far apart as lights, and a sentence with all numbers.

    Args:
        cameras: their centres, in one of the units.
        lights: their places, metres.
        units: name of each candidate by its metres.

    Raises:
        InputError: if they are so in none of the units.
    """
    ratios = {metres: metres * extent(cameras) / extent(lights) for metres in units}
    said = ", ".join(f"{units[metres]} {ratio:.3g}" for metres, ratio in ratios.items())
    log.info("%s: extent of the cameras over that of the lights, poses read in %s", where, said)
    best = min(ratios, key=lambda metres: abs(np.log(ratios[metres])))
    if not 1 / NEAR < ratios[best] < NEAR:
        raise InputError(
            f"{where}: expected cameras about as far apart as the lights, found that they are so many times as far: "
            f"{said}; are these the lights of this calibration?"
        )
    return best, f"poses in {units[best]}, as far apart as the lights ({said} times)"


def extent(points: Float64[np.ndarray, "points 3"]) -> float:
    """Median distance of points from their mean."""
    return float(np.median(np.linalg.norm(points - points.mean(0), axis=1)))
