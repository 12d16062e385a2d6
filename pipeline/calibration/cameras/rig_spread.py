"""Error bars of a rig from its spread when groups of shots are left out.

Error bars of a least-squares fit take the errors of all corners for independent, and they are not: the corners of an
image share its blur, its board's bend, and what no lens model has. Where the images of a view were not taken at once,
they share its time, too; images that follow each other share velocities, and a hand does not move on parabolas. What
all of that does to the result shows when some of the shots are left out: by one Newton step, since little changes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.rig import Rig, center_rows, robust_slope, shape_projection
from pipeline.calibration.cameras.rig_calibration import Calibrated

GROUPS, MOVING_GROUPS = 12, 6
"""Groups of shots that are left out in turn; the spread of twelve is good to a fifth, of six to a third. Of boards that
move they are successive shots, longer than what these share. Otherwise every twelfth: a camera that sees the board for
a while loses no more than a twelfth of that."""

TAKEN, TAKEN_MOVING = 0.5, 0.999
"""Share of a group's information that is taken away along with its pull. With half of it, errors over error bars of
independent shots are 1; with none they are too large in small rigs, with all of it, the jackknife (Tukey 1958), too
small (CR2, CR0 and CR3: Bell and McCaffrey 2002). Neighbours of a moving board are not independent: there it is all but
what keeps poses of views determined."""

RIDGE = 1e-12
"""Of each parameter's information, which is added: what nothing determines stays where it is."""


NOTHING = 1e-12
"""Error bar up to which there is none: of lenses that are given, and, but for rounding, of the shape of one camera."""


def with_spread(calibrated: Calibrated, shot: Int64[np.ndarray, " views"]) -> Calibrated:
    """The calibration with error bars of its rig that are no smaller than its spread.

    Of boards that rest, than the spread of all cameras together.

    Args:
        shot: of each view, its number in the order in which they were recorded.
    """
    rig, shots = calibrated.rig, np.unique(shot)
    moving = rig.model.observations.motion is not None
    count = min(MOVING_GROUPS if moving else GROUPS, len(shots))
    # Without a slope more than half of the corners are gross errors, and error bars say that nothing is known.
    if count < 2 or _slope(rig) <= 0:
        return calibrated
    groups = np.array_split(shots, count) if moving else [shots[k::count] for k in range(count)]
    steps = _steps_without(rig, shot[rig.model.observations.view], groups, TAKEN_MOVING if moving else TAKEN)
    focal = steps[:, [rig.model.intrinsics_columns(int(lens)).start for lens in rig.model.lens_index]]
    poses = steps @ rig.model.pose_jacobian(rig.parameters).T
    centers = poses[:, center_rows(len(rig.cameras))] @ shape_projection(rig.cameras)
    focal_sigma = np.linalg.norm(focal, axis=0) / np.array([camera.K[0, 0] for camera in rig.cameras])
    center_sigma = np.sqrt((centers**2).sum(0).reshape(-1, 3).mean(1))
    spread = poses.T @ poses
    if not moving:
        factor = _common_factor(rig, focal_sigma, center_sigma)
        focal_sigma, center_sigma = factor * rig.focal_sigma, factor * rig.center_sigma_m
        spread = factor**2 * rig.pose_covariances[0]
    wider = replace(
        rig, focal_sigma=np.maximum(rig.focal_sigma, focal_sigma),
        center_sigma_m=np.maximum(rig.center_sigma_m, center_sigma), pose_covariances=(*rig.pose_covariances, spread),
    )  # fmt: skip
    return replace(calibrated, rig=wider)


def _common_factor(rig: Rig, focal_sigma: np.ndarray, center_sigma: np.ndarray) -> float:
    """Spread over error bars, root mean square over the rig: what an image's corners share is much alike in all.

    A camera's own spread is good to a fifth alone, and would make one in ten look uncertain by chance.
    """
    spread, own = np.append(focal_sigma, center_sigma), np.append(rig.focal_sigma, rig.center_sigma_m)
    known = own > NOTHING
    return float(np.sqrt(np.mean((spread[known] / own[known]) ** 2))) if known.any() else 1.0


def _steps_without(
    rig: Rig, shot: Int64[np.ndarray, " observations"], groups: list[np.ndarray], taken: float
) -> Float64[np.ndarray, "groups parameters"]:
    """Changes of all parameters when each group of shots is left out.

    Args:
        shot: of each observation.
        taken: share of a group's information that goes with its pull.
    """
    model, free = rig.model, rig.model.free
    residual, jacobian = model.residuals(rig.parameters)
    weight = np.repeat(rig.weight, 2) / rig.sigma_px**2
    _, prior = model.priors()
    weighted = jacobian.multiply(weight[:, None]).tocsr()
    whole = (jacobian.T @ weighted).toarray() + np.diag(1 / np.square(prior[free]))
    # A robust fit gives way more than its weights say.
    softer = rig.weight.mean() / _slope(rig)
    scale = np.sqrt(np.diag(whole))
    steps = np.zeros((len(groups), len(rig.parameters)))
    for k, out in enumerate(groups):
        rows = np.flatnonzero(np.repeat(np.isin(shot, out), 2))
        part = weighted[rows]
        left = (whole - taken * (jacobian[rows].T @ part).toarray()) / np.outer(scale, scale)
        pull = part.T @ residual.ravel()[rows] / scale
        steps[k, free] = softer * np.linalg.solve(left + RIDGE * np.eye(len(free)), pull) / scale
    return steps


def _slope(rig: Rig) -> float:
    return robust_slope(rig.residual / rig.sigma_px, len(rig.model.free))
