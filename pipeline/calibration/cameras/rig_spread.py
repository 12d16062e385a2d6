"""Error bars of a rig from its spread when groups of shots are left out: the jackknife.

Error bars of a least-squares fit take the errors of all corners for independent. Where the images of a view were not
taken at once, they are not: the corners of an image share its time, images that follow each other share velocities, and
a hand does not move on parabolas. What all of that does to the result shows when some of the shots are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64

from pipeline.calibration.cameras.board_views import BoardViews
from pipeline.calibration.cameras.rig import Rig, adjust_rig, shape_projection
from pipeline.calibration.cameras.rig_calibration import Calibrated
from pipeline.calibration.cameras.rig_start import connected_groups
from pipeline.geometry.cameras import Camera

GROUPS = 6
"""Groups of successive shots that are left out in turn; the spread of so many is good to a third."""


def with_spread(calibrated: Calibrated, views: BoardViews) -> Calibrated:
    """The calibration with error bars of its rig that are no smaller than its spread.

    Args:
        views: those it was calibrated from.
    """
    rig = calibrated.rig
    shots = np.unique(views.shot)
    parts = [_without(rig, views, out, calibrated.distortion) for out in np.array_split(shots, GROUPS)]
    rigs = [part for part in parts if part is not None]
    if len(rigs) < 2:
        return calibrated
    focal = np.array([[camera.K[0, 0] for camera in part] for part in rigs])
    shape = shape_projection(rig.cameras)
    centers = np.stack([shape @ np.concatenate([camera.center for camera in part]) for part in rigs])
    focal_sigma = _jackknife(focal) / np.array([camera.K[0, 0] for camera in rig.cameras])
    center_sigma = np.sqrt((_jackknife(centers) ** 2).reshape(-1, 3).mean(1))
    wider = replace(
        rig, focal_sigma=np.maximum(rig.focal_sigma, focal_sigma),
        center_sigma_m=np.maximum(rig.center_sigma_m, center_sigma),
    )  # fmt: skip
    return replace(calibrated, rig=wider)


def _without(
    rig: Rig, views: BoardViews, out: Int64[np.ndarray, " shots"], distortion: Sequence[int]
) -> list[Camera] | None:
    """The cameras adjusted without some shots, in the rig's frame as far as one view tells it.

    None if the other shots do not join all cameras.
    """
    seen = views.observations.select(~np.isin(views.shot[views.observations.view], out))
    kept, view = np.unique(seen.view, return_inverse=True)
    if len(np.unique(seen.camera)) < len(rig.cameras):
        return None
    observations = replace(seen, view=view.astype(np.int64))
    if len(connected_groups(observations, len(rig.cameras))) > 1:
        return None
    # View 0 is the frame of an adjustment.
    frame = rig.rig_from_board[kept[0]]
    cameras = [replace(c, R=c.R @ frame[:3, :3], t=c.R @ frame[:3, 3] + c.t) for c in rig.cameras]
    boards = np.linalg.inv(frame) @ rig.rig_from_board[kept]
    found = adjust_rig(observations, views.corners_m, cameras, boards, distortion, known=rig.model.known).cameras
    back = np.linalg.inv(frame)
    return [replace(c, R=c.R @ back[:3, :3], t=c.R @ back[:3, 3] + c.t) for c in found]


def _jackknife(values: Float64[np.ndarray, " groups *rest"]) -> Float64[np.ndarray, "*rest"]:
    """Standard deviation of what is computed from all groups, from its values without each (Tukey 1958)."""
    return np.sqrt((len(values) - 1) * values.var(0))
