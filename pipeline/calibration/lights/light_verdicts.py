"""Verdicts on every mirror ball and every light: good, weak or failed, and why."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.base.errors import listed
from pipeline.base.verdicts import Verdict
from pipeline.calibration.lights.mirror_ball import Ball
from pipeline.config.calibrate_lights import CalibrateLights

AGREES_WEIGHT = 0.2
"""Cauchy weight of a highlight below which it speaks for another place: 4.8 standard deviations off."""

WEAK_DISAGREEMENT = 10.0
"""Standard deviations between what single cameras' outlines say of a ball. Outlines are good to 0.02 px in their
middle: cameras calibrated to 0.1 px disagree by 5."""


def ball_verdicts(
    balls: Mapping[str, Ball], cameras_by_position: Mapping[str, list[str]], refused: Mapping[tuple[str, str], str],
    settings: CalibrateLights,
) -> list[Verdict]:  # fmt: skip
    """Verdict on each ball position.

    `refused`: what the images of (position, camera) without an outline hold instead.
    """
    verdicts = []
    for position in sorted({*balls, *(position for position, _ in refused)}):
        without = "; ".join(f"{camera}: {why}" for (p, camera), why in refused.items() if p == position)
        if (ball := balls.get(position)) is None:
            verdicts.append(Verdict("ball", position, "failed", f"no outline; {without}"))
            continue
        sigma_mm = 1000 * np.sqrt(np.trace(ball.covariance) / 3)
        eyes = len(cameras_by_position[position])
        said = [f"outlines in {eyes} cameras, RMS {ball.rms_px:.3f} px, centre +-{sigma_mm:.2f} mm"]
        said += [without] if without else []
        flaws = []
        if eyes == 1:
            flaws.append("one camera only: its distance comes from its size alone")
        if ball.rms_px > settings.weak_outline_px:
            flaws.append("the outlines are no circles: a stand in the way, a wrong radius or an unfit transfer")
        if ball.disagreement > WEAK_DISAGREEMENT:
            flaws.append(f"cameras disagree by {ball.disagreement:.0f} standard deviations: check them and radius_m")
        grade = "weak" if flaws or without else "good"
        verdicts.append(Verdict("ball", position, grade, "; ".join(said + flaws)))
    return verdicts


def why_not_measured(light: pd.Series, settings: CalibrateLights) -> str:
    """Reason for which a light keeps its surveyed position, or nothing.

    `light` is a row of what `light_verdicts` takes.
    """
    if light.images == 0:
        return "no image of it with a usable ball"
    if light.highlights == 0:
        return f"no highlight in {light.images} images: is the LED dead?"
    if light.highlights < settings.least_highlights:
        return f"highlights in only {light.highlights} of {light.images} images"
    if light.rival > 0:
        return f"two lights shine in its images: {light.agreeing} agree on one place, {light.rival} on another"
    if light.agreeing < settings.least_highlights:
        return f"only {light.agreeing} of {light.highlights} highlights agree on one place"
    if not light.sigma_m <= settings.largest_sigma_m:
        return f"{light.highlights} highlights leave it uncertain by {1000 * light.sigma_m:.0f} mm per axis"
    return ""


def light_verdicts(lights: pd.DataFrame, settings: CalibrateLights) -> list[Verdict]:
    """One per row.

    Args:
        lights: light (its name), images, highlights, agreeing, rival, sigma_m, status, away_m (from its surveyed
            position), looks_like (name or ""), no_intensity (why, or ""), no_color (why, or "").
    """
    swaps = dict(zip(lights.light, lights.looks_like, strict=True))
    verdicts = []
    for row in lights.itertuples():
        unknown = f"; no intensity: {row.no_intensity}" if row.no_intensity else ""
        unknown += f"; no colour: {row.no_color}" if row.no_color and not row.no_intensity else ""
        if row.status == "surveyed":
            why = why_not_measured(pd.Series(row._asdict()), settings)
            verdicts.append(Verdict("light", row.light, "failed", f"{why}; keeps its surveyed position{unknown}"))
            continue
        said = f"{row.highlights} highlights, +-{1000 * row.sigma_m:.1f} mm, {1000 * row.away_m:.0f} mm from the survey"
        flaws = []
        if row.sigma_m > settings.weak_sigma_m:
            flaws.append("uncertain: add ball positions or cameras")
        if 2 * row.agreeing < row.highlights:
            flaws.append(f"only {row.agreeing} of its highlights agree")
        if row.away_m > settings.suspicious_distance_m:
            flaws.append(_mixed_up(row.light, row.looks_like, swaps))
        verdicts.append(Verdict("light", row.light, "weak" if flaws else "good", "; ".join([said, *flaws]) + unknown))
    return verdicts


def _mixed_up(light: str, other: str, swaps: Mapping[str, str]) -> str:
    if not other:
        return "far from its surveyed position: was it moved?"
    if swaps.get(other) == light:
        pair = " and ".join(sorted((light, other)))
        return f"names of {pair} look swapped, in lights.csv or among the ball images"
    return f"where the survey has {other}: are names mixed up in lights.csv or among the ball images?"


def resemblances(
    names: list[str], measured: Float64[np.ndarray, "lights 3"], surveyed: Float64[np.ndarray, "lights 3"], limit: float
) -> list[str]:
    """Name the light whose surveyed place a displaced light is at.

    For each light further than `limit` from its own surveyed place: whose place it is at (within `limit`), or "".
    """
    lost = np.flatnonzero(np.linalg.norm(measured - surveyed, axis=1) > limit)
    found = [""] * len(names)
    if not len(lost):
        return found
    from scipy.optimize import linear_sum_assignment  # Half a second, for captures with a light that was moved.

    distance = np.linalg.norm(measured[lost, None] - surveyed[lost], axis=2)
    for i, j in zip(*linear_sum_assignment(np.minimum(distance, limit)), strict=True):
        if distance[i, j] < limit:
            found[lost[i]] = names[lost[j]]
    return found


def refusals(refused: Mapping[tuple[str, str], str]) -> str:
    """All images without a ball in one line for a message."""
    return listed([f"{why} (ball {position}, {camera})" for (position, camera), why in refused.items()], limit=3)
