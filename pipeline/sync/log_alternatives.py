"""Verdicts on surveyed lights and transfer function: would others explain the images better?

Both decide how bright the subject is under each pattern: light positions through its shading, the transfer function
through how brightness grows with light. Each alternative is fitted to the same frames with the same model of errors
(`led_faults.Fit`), and sqrt(2 log-likelihood ratio) says by how many sigmas it is ahead of what the capture says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from jaxtyping import Float64

from pipeline.base.verdicts import Grade, Verdict
from pipeline.sync.brightness import BrightnessModel, directions_from
from pipeline.sync.led_faults import Fit, Patterns
from pipeline.sync.subject_proxy import Ellipsoid, shading_response

TURNS_DEG = (-90.0, -60.0, -30.0, 30.0, 60.0, 90.0, 180.0)
"""Turns about the vertical that are tried: between two of them, 15 degrees off, lights are where the nearest one has
them to a quarter of the stage's radius."""

SHIFT = 0.5
"""Shifts that are tried, over the median distance of the lights from the subject: a survey whose origin is not the
stage's, such as a corner of the floor."""

FEET = 1 / 0.3048
"""Feet in a metre: the smallest factor between units of a survey."""

FARTHER = FEET**0.5
"""Distance of the median light over that of the median camera from which, or below the inverse of which, a survey is
weak: lights and cameras hang on one frame, and half way to the next unit another one is as likely. Failed beyond
`TOO_FAR`."""

TOO_FAR = 4.0
"""As `FARTHER`: light falls with the square of the distance, and nobody gives away fifteen sixteenths of it."""

GAMMA = 2.2
"""Exponent of the transfer function that is forgotten, or undone twice."""

WEAKEST_LIGHT = 0.05
"""Brightness, over the usual, below which frames say more about stray light than about the transfer function."""

PAIRS = 8
"""Pairs of lights whose exchange is confirmed by a fit of its own: those that gain most while weights stay."""

AXES = "xyz"


@dataclass(frozen=True)
class Rig:
    """Lights, cameras and the subject's stand-in, metres, world, that a survey is judged by."""

    lights: Float64[np.ndarray, "lights 3"]
    cameras: Float64[np.ndarray, "cameras 3"]
    subject: Ellipsoid


def survey_verdict(model: BrightnessModel, patterns: Patterns, rig: Rig, sigmas: float) -> Verdict:
    """Judge where the lights are said to be.

    Failed if another survey explains the images better by `sigmas`, or two lights in each other's place, or if
    lights are in another unit than cameras.
    """
    farther = _median_distance(rig.lights, rig) / _median_distance(rig.cameras, rig)
    apart = max(farther, 1 / farther)
    if apart > FARTHER:
        grade: Grade = "failed" if apart > TOO_FAR else "weak"
        found = f"lights {farther:.3g} times as far from the subject as cameras: are both in metres?"
        return Verdict("survey", "lights", grade, found)
    fit = Fit(model, patterns)
    here = fit.score
    best, ahead = "", -np.inf
    for name, lights in _other_surveys(rig):
        gained = Fit(moved_lights(model, rig, lights), patterns).score - here
        best, ahead = (name, gained) if gained > ahead else (best, ahead)
    for i, j in _likely_exchanges(fit):
        gained = Fit(_exchanged(model, i, j), patterns).score - here
        # Neighbours can hardly be told apart: that they cannot is no news.
        if gained > max(ahead, sigmas**2 / 2):
            best, ahead = f"exchanged, {model.log.lights[i]} with {model.log.lights[j]},", gained
    behind = np.sqrt(2 * abs(ahead))
    if ahead > sigmas**2 / 2:
        found = f"the images fit lights that are {best} better by {behind:.0f} sigma; check x, y, z and the names"
        return Verdict("survey", "lights", "failed", found)
    found = f"{behind:.0f} sigma ahead of all others tried; next: lights that are {best}"
    if ahead > 0:
        found = f"not told from lights that are {best}, which fit {behind:.1f} sigma better"
    return Verdict("survey", "lights", "good", found)


def moved_lights(model: BrightnessModel, rig: Rig, lights: Float64[np.ndarray, "lights 3"]) -> BrightnessModel:
    """The model if the lights were there."""
    response = shading_response(rig.subject, lights, rig.cameras)
    return replace(model, response=response, light_directions=directions_from(rig.subject.center, lights))


def _other_surveys(rig: Rig) -> Iterator[tuple[str, np.ndarray]]:
    """Surveys in other axes, turned about the vertical, and shifted, around the stage's origin."""
    for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
        if (order, signs) != ((0, 1, 2), (1, 1, 1)):
            axes = ", ".join(("-" if sign < 0 else "") + AXES[axis] for axis, sign in zip(order, signs, strict=True))
            yield f"at ({axes})", rig.lights[:, order] * signs
    for turn in TURNS_DEG:
        c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        if turn not in (-90.0, 90.0, 180.0):
            yield f"turned by {turn:g} degrees about y", rig.lights @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    far = SHIFT * _median_distance(rig.lights, rig)
    for axis, sign in product(range(3), (-1, 1)):
        yield f"shifted by {sign * far:.2f} m along {AXES[axis]}", rig.lights + sign * far * np.eye(3)[axis]


def _likely_exchanges(fit: Fit) -> list[tuple[int, int]]:
    """Pairs of lights whose exchange gains most, by the weights of the fit as it is.

    Exchanging i and j adds D = (x_i - x_j) (g_j - g_i)^T to what is predicted (x: levels, g: response), and
    tr(K^-1 R^T S^-1 D) - tr(K^-1 D^T S^-1 D) / 2 to the log-likelihood (`led_faults`).
    """
    levels, response = fit.levels, fit.model.response
    pulled, weighted = fit.inverse @ levels, fit.model.precision @ response
    cross = pulled.T @ fit.residuals @ weighted
    own = np.diag(cross)
    gained = cross + cross.T - own[:, None] - own
    gained -= _squared_differences(levels.T @ pulled) * _squared_differences(response.T @ weighted) / 2
    first, second = np.triu_indices(len(gained), 1)
    order = np.argsort(-gained[first, second], kind="stable")[:PAIRS]
    return [(int(first[k]), int(second[k])) for k in order if gained[first[k], second[k]] > 0]


def _squared_differences(products: Float64[np.ndarray, "n n"]) -> Float64[np.ndarray, "n n"]:
    """(a - b)^T M (a - b) of all pairs, from a^T M b."""
    return np.diag(products)[:, None] + np.diag(products) - products - products.T


def _exchanged(model: BrightnessModel, i: int, j: int) -> BrightnessModel:
    """The model if two lights were in each other's place."""
    order = np.arange(len(model.light_directions))
    order[[i, j]] = j, i
    return replace(model, response=model.response[:, order], light_directions=model.light_directions[order])


def _median_distance(places: np.ndarray, rig: Rig) -> float:
    return float(np.median(np.linalg.norm(places - rig.subject.center, axis=1)))


def transfer_verdict(model: BrightnessModel, patterns: Patterns, sigmas: float) -> Verdict:
    """Judge how the images store light.

    If brightness is stored as its power 1 / g, all of it follows light with that exponent. Failed if a forgotten or a
    doubled transfer function explains the images better by `sigmas`; weak if patterns are too alike to tell.
    """
    bright = patterns.kept & (model.terms(patterns.levels).sum(1) > WEAKEST_LIGHT * model.usual_level)
    kept = replace(patterns, kept=bright & (model.observed > 0).all(1))
    if kept.kept.sum() < 3:
        return Verdict("transfer", "images", "weak", "too few lit frames to tell")
    here = stored_score(model, kept, 1.0)
    forgotten, doubled = (stored_score(model, kept, power) - here for power in (GAMMA, 1 / GAMMA))
    ahead, name = max((forgotten, "srgb, and read as linear"), (doubled, "linear, and read as srgb"))
    sure = np.sqrt(2 * abs(ahead))
    if ahead > sigmas**2 / 2:
        found = f"brightness follows light as if images were {name} ({sure:.0f} sigma); check images.transfer"
        return Verdict("transfer", "images", "failed", found)
    if ahead > -(sigmas**2) / 2:
        found = f"not told from images that are {name} ({sure:.1f} sigma): show patterns with more and fewer lights"
        return Verdict("transfer", "images", "weak", found)
    return Verdict("transfer", "images", "good", f"brightness follows light, {sure:.0f} sigma ahead of others")


def stored_score(model: BrightnessModel, patterns: Patterns, power: float) -> float:
    """Log-likelihood of the images if light were the seen brightness to this power.

    With the density of the seen brightness itself: that of its power, times the derivative of the power.
    """
    seen = np.where(model.seen > 0, model.seen, 0.0)
    usual = seen[patterns.kept].mean((0, 2), keepdims=True)
    light = usual * (seen / usual) ** power
    slope = np.log(power) + (power - 1) * np.log(model.observed[patterns.kept] / usual[..., 0])
    return Fit(replace(model, seen=light), patterns).score + float(slope.sum())
