"""A rig from its observations: where to start, how much distortion, one adjustment, and whether all views fit it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.moved_cameras import find_moved, split_camera
from pipeline.calibration.cameras.rig import Rig, adjust_rig
from pipeline.calibration.cameras.rig_distortion import FULL, choose_distortion, distortion_evidence
from pipeline.calibration.cameras.rig_model import Observations
from pipeline.calibration.cameras.rig_start import connected_groups, possible_starts, view_rows
from pipeline.geometry.cameras import Camera

STARTS = 4
"""Starts that are adjusted at most: two joins that nothing but the noise decides. Most rigs have one."""

ROUNDS = 2
"""Once with each camera's own lens, and if views stay astray once more with the lenses that came out of it: a lens from
a few views alone may be off by several per cent, and with it the poses by which cameras are joined."""

ASTRAY_PX = 10.0
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
    """What does not fit one rig that stands still.

    Attributes:
        movements: cameras that moved.
        astray: per camera with such views, the shots that fit none of its poses.
    """

    movements: list[Movement]
    astray: dict[int, list[int]]


def calibrate_rig(
    observations: Observations,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    distortion: Literal["auto", 0, 1, 2, 5],
) -> Calibrated:
    """Calibrate cameras of `sizes` (width, height), all connected by shared views."""
    full = _adjust_from_starts(observations, corners_m, sizes)
    evidence = distortion_evidence(full)
    chosen = choose_distortion(evidence) if distortion == "auto" else [distortion] * len(sizes)
    if all(number == FULL for number in chosen):
        return Calibrated(full, chosen, evidence, full)
    rig = adjust_rig(observations, corners_m, full.cameras, full.rig_from_board, chosen)
    return Calibrated(rig, chosen, evidence, full)


def inspect_rig(
    calibrated: Calibrated,
    corners_m: Float64[np.ndarray, "corners 3"],
    sizes: Sequence[tuple[int, int]],
    shot: Int64[np.ndarray, " views"],
) -> Inspection:
    """Every camera that moved, found one by one, each then taken for two cameras of one lens; and what still is astray.

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
        lenses = [rig.cameras[k] for k in owner]
        rig = _adjust_from_starts(observations, corners_m, [sizes[k] for k in owner], lenses, owner)
        movements.append(Movement(suspects, moved.time, *_difference(rig, before, after)))
    astray: dict[int, list[int]] = {}
    for camera, view in _astray(rig):
        astray.setdefault(owner[camera], []).append(int(shot[view]))
    return Inspection(movements, {camera: sorted(set(shots)) for camera, shots in astray.items()})


def _adjust_from_starts(
    observations: Observations,
    corners_m: np.ndarray,
    sizes: Sequence[tuple[int, int]],
    lenses: Sequence[Camera] | None = None,
    lens: Sequence[int] | None = None,
) -> Rig:
    """The best of a few adjustments with all coefficients: from the possible starts, and again with their lenses.

    Args:
        lenses: cameras whose intrinsics to start with; None: those that each camera has from its own views.
        lens: as in `adjust_rig`.
    """
    rigs: list[Rig] = []
    for _ in range(ROUNDS):
        starts = possible_starts(observations, corners_m, sizes, lenses)[:STARTS]
        rigs += [adjust_rig(observations, corners_m, s.cameras, s.rig_from_board, FULL, lens) for s in starts]
        rigs = [min(rigs, key=_robust_cost)]
        if not _astray(rigs[0]):
            break
        lenses = rigs[0].cameras
    return rigs[0]


def _robust_cost(rig: Rig) -> float:
    """Cauchy's cost at one scale for all rigs: the noise of each grows with what it takes for noise."""
    return float(np.log1p((rig.residual**2).sum(1)).sum())


def _astray(rig: Rig) -> list[tuple[int, int]]:
    """(Camera, view) of which more than half of the corners are farther off than `ASTRAY_PX`."""
    error = np.linalg.norm(rig.residual, axis=1)
    return [key for key, rows in view_rows(rig.model.observations).items() if np.median(error[rows]) > ASTRAY_PX]


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
