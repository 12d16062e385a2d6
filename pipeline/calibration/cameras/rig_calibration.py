"""Calibration of a rig from its observations.

Where to start, how much distortion, one adjustment, and whether all views fit it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.moved_cameras import find_moved, split_camera
from pipeline.calibration.cameras.rig import Rig, adjust_rig, settle_clock
from pipeline.calibration.cameras.rig_inputs import NOTHING_KNOWN, Observations, RigPriors
from pipeline.calibration.cameras.rig_start import connected_groups, possible_starts, view_rows
from pipeline.geometry.cameras import PINHOLE_TERMS, Camera
from pipeline.geometry.lens import Lens
from pipeline.geometry.lenses import BROWN_CONRADY

STARTS = 4
"""Starts that are adjusted at most: two joins that nothing but the noise decides. Most rigs have one."""

ROUNDS = 2
"""Once with each camera's own lens, and if views stay gross outliers once more with the lenses that came out of it: a
lens from a few views alone may be off by several per cent, and with it the poses by which cameras are joined."""

GROSS_OUTLIER_PX = 10.0
"""Median error of a view's corners above which it does not fit at all: a lens of too few coefficients leaves a few
pixels, a camera joined by the mirror image of a pose, or a movement of a degree, tens to hundreds."""


@dataclass(frozen=True)
class Calibrated:
    """A rig and how its lenses were chosen.

    Attributes:
        distortion: number of coefficients of each camera.
        evidence: per camera, `distortion_evidence` for other numbers.
        full: the same rig with all coefficients for every camera.
    """

    rig: Rig
    distortion: list[int]
    evidence: list[dict[int, float]]
    full: Rig


@dataclass(frozen=True)
class Movement:
    """A camera whose views before and after one ask for different poses.

    Attributes:
        suspects: the camera, and others that may have moved in its stead.
        shot: the first after the movement.
        shift_px: how far its corners moved, root mean square.
        shift_m, turn_deg: how far and how much it moved itself; NaN if its views after are too few to tell.
    """

    suspects: list[int]
    shot: int
    shift_px: float
    shift_m: float
    turn_deg: float


@dataclass(frozen=True)
class Inspection:
    """Views that do not fit one rig that stands still.

    Attributes:
        movements: cameras that moved.
        gross_outliers: per camera with such views, the shots that fit none of its poses.
    """

    movements: list[Movement]
    gross_outliers: dict[int, list[int]]


def calibrate_rig(
    observations: Observations,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    distortion: Literal["auto"] | int,
    lens: Lens = BROWN_CONRADY,
    known: RigPriors = NOTHING_KNOWN,
) -> Calibrated:
    """Calibrate cameras of `sizes` (width, height), all connected by shared views.

    Args:
        distortion: number of coefficients, one of the lens's `term_counts`; auto: chosen for each camera.
        lens: the model of all lenses.
        known: what is known beforehand; of given lenses all coefficients count.
    """
    full = settle_clock(_adjust_from_starts(observations, corners_m, sizes, lens, known=known))
    if known.lenses is not None:
        return Calibrated(full, [len(lens.terms)] * len(sizes), [{}] * len(sizes), full)
    evidence = distortion_evidence(full)
    chosen = choose_distortion(evidence) if distortion == "auto" else [distortion] * len(sizes)
    if all(number == len(lens.terms) for number in chosen):
        return Calibrated(full, chosen, evidence, full)
    rig = adjust_rig(observations, corners_m, full.cameras, full.rig_from_board, chosen, known=full.model.known)
    return Calibrated(rig, chosen, evidence, full)


def distortion_evidence(rig: Rig) -> list[dict[int, float]]:
    """Per camera and number of coefficients: log of the odds of that model against the full one.

    Simpler models are the full one with some terms exactly zero, so that Savage and Dickey's ratio gives the odds
    without fitting them: the posterior density of the excluded terms at zero over their prior density there (Verdinelli
    and Wasserman 1995). The posterior is the adjusted rig's, with all other parameters free to follow; the prior is
    that of the adjustment. Each camera decides for itself: one lens of a rig may be wide and another long.

    Args:
        rig: adjusted with the full model for every camera.
    """
    evidence = []
    for camera, covariance in zip(rig.cameras, rig.intrinsics_covariance, strict=True):
        prior = np.diag(np.array(camera.lens.prior_sigma) ** 2)
        of_terms, log_odds = covariance[len(PINHOLE_TERMS) :, len(PINHOLE_TERMS) :], {}
        for number in camera.lens.term_counts:
            out = np.arange(number, len(camera.dist))
            posterior = of_terms[np.ix_(out, out)]
            at_zero = _log_density(camera.dist[out], posterior) - _log_density(np.zeros(len(out)), prior[out][:, out])
            log_odds[number] = at_zero
        evidence.append(log_odds)
    return evidence


def choose_distortion(evidence: list[dict[int, float]]) -> list[int]:
    """The most probable number of coefficients of each camera; of equals the smallest."""
    return [max(odds, key=lambda number: (odds[number], -number)) for odds in evidence]


def _log_density(value: Float64[np.ndarray, " terms"], covariance: Float64[np.ndarray, "terms terms"]) -> float:
    """Log of the normal density of mean zero."""
    _, log_determinant = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (log_determinant + value @ np.linalg.solve(covariance, value)))


def inspect_rig(
    calibrated: Calibrated,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    shot: Int64[np.ndarray, " views"],
) -> Inspection:
    """Find every camera that moved, and the views that fit nowhere even so.

    Movements are found one by one; a camera that moved is then taken for two cameras of one lens.

    Views are judged by lenses of all coefficients: what a lens of fewer leaves over varies with the place of the board,
    and so with time, as if the camera moved.

    Args:
        shot: of each view, its number in the order in which they were recorded.
    """
    rig, observations = calibrated.full, calibrated.full.model.observations
    owner, movements = list(range(len(sizes))), []
    while len(movements) < len(sizes) and (moved := find_moved(rig, shot)) is not None:
        suspects = list(dict.fromkeys(owner[suspect] for suspect in moved.suspects))
        before, after = moved.suspects[0], len(owner)
        observations = split_camera(observations, shot, before, moved.time, after)
        owner.append(owner[before])
        if len(connected_groups(observations, len(owner))) > 1:
            movements.append(Movement(suspects, moved.time, moved.shift_px, np.nan, np.nan))
            break
        lenses, known = [rig.cameras[k] for k in owner], calibrated.full.model.known
        if known.lenses is not None:
            known = replace(known, lenses=[known.lenses[k] for k in owner])
        owned = [sizes[k] for k in owner]
        rig = _adjust_from_starts(observations, corners_m, owned, rig.model.lens, lenses, owner, known)
        movements.append(Movement(suspects, moved.time, *_difference(rig, before, after)))
    gross_outliers: dict[int, list[int]] = {}
    for camera, view in _gross_outliers(rig):
        gross_outliers.setdefault(owner[camera], []).append(int(shot[view]))
    return Inspection(movements, {camera: sorted(set(shots)) for camera, shots in gross_outliers.items()})


def _adjust_from_starts(
    observations: Observations,
    corners_m: np.ndarray,
    sizes: Sequence[tuple[int, int]],
    lens: Lens,
    intrinsics: Sequence[Camera] | None = None,
    lens_index: Sequence[int] | None = None,
    known: RigPriors = NOTHING_KNOWN,
) -> Rig:
    """Best of a few adjustments with all coefficients.

    From the possible starts, and again with their lenses.

    Args:
        intrinsics: cameras whose intrinsics to start with; None: those that each camera has from its own views.
        lens_index, known: as in `adjust_rig`.
    """
    rigs: list[Rig] = []
    if intrinsics is None:
        intrinsics = known.lenses
    for _ in range(ROUNDS):
        starts = possible_starts(observations, corners_m, sizes, intrinsics, lens)[:STARTS]
        number = len(lens.terms)
        rigs += [
            adjust_rig(observations, corners_m, s.cameras, s.rig_from_board, number, lens_index, known) for s in starts
        ]
        rigs = [min(rigs, key=_robust_cost)]
        if not _gross_outliers(rigs[0]) or known.fixed:
            break
        intrinsics = rigs[0].cameras
    return rigs[0]


def _robust_cost(rig: Rig) -> float:
    """Cauchy's cost at one scale for all rigs: the noise of each grows with what it takes for noise."""
    return float(np.log1p((rig.residual**2).sum(1)).sum())


def _gross_outliers(rig: Rig) -> list[tuple[int, int]]:
    """(Camera, view) of which more than half of the corners are farther off than `GROSS_OUTLIER_PX`."""
    error = np.linalg.norm(rig.residual, axis=1)
    return [key for key, rows in view_rows(rig.model.observations).items() if np.median(error[rows]) > GROSS_OUTLIER_PX]


def _difference(rig: Rig, before: int, after: int) -> tuple[float, float, float]:
    """Between two poses of one camera: shift of the corners (pixels) and of the centre (metres), angle (degrees)."""
    old, new, model = rig.cameras[before], rig.cameras[after], rig.model
    mine = model.observations.camera == after
    boards = rig.rig_from_board[model.observations.view[mine]]
    points = np.einsum("nij,nj->ni", boards[:, :3, :3], model.points[mine]) + boards[:, :3, 3]
    apart = new.project(points)[0] - old.project(points)[0]
    cosine = (np.trace(old.R @ new.R.T) - 1) / 2
    return (
        float(np.sqrt((apart**2).sum(1).mean())),
        float(np.linalg.norm(old.center - new.center)),
        float(np.degrees(np.arccos(np.clip(cosine, -1, 1)))),
    )
