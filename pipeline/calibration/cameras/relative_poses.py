"""Relative poses of a rig's cameras, with error bars: the same in whatever frame."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from jaxtyping import Float64

from pipeline.geometry.cameras import Camera
from pipeline.geometry.rotations import rotation_vector_from_matrix

PAIR_COLUMNS = ["first", "second", "baseline_m", "baseline_sigma_m", "turn_deg", "turn_sigma_deg"]


def pair_table(
    cameras: Mapping[str, Camera], covariances: Sequence[Float64[np.ndarray, "poses poses"]]
) -> pd.DataFrame:
    """Distance and turn of every two cameras, `PAIR_COLUMNS`, with standard deviations.

    That of the turn is of an angle about one axis, root mean square over three; that of the error's size is sqrt(3)
    times as large.

    Args:
        covariances: of all poses, as in `RigModel.pose_jacobian`; of several, the largest error bar counts.
    """
    rows = []
    for (a, first), (b, second) in itertools.combinations(enumerate(cameras), 2):
        pairs = [pair_covariance(covariance, a, b) for covariance in covariances]
        rows.append((first, second, *_relate(cameras[first], cameras[second], pairs)))
    return pd.DataFrame(rows, columns=PAIR_COLUMNS)


def pair_covariance(poses: Float64[np.ndarray, "poses poses"], a: int, b: int) -> Float64[np.ndarray, "12 12"]:
    """Part of two cameras in the covariance of all poses."""
    rows = (6 * np.array([[a], [b]]) + np.arange(6)).ravel()
    return poses[np.ix_(rows, rows)]


def turn_covariance(
    relative: Float64[np.ndarray, "3 3"], pair: Float64[np.ndarray, "12 12"]
) -> Float64[np.ndarray, "3 3"]:
    """Covariance of the turn from one camera to another, about the other's axes.

    In radians squared. With both cameras turned a little, R_b R_a^T becomes exp(turn_b - relative turn_a) R_b R_a^T.

    Args:
        relative: R_b R_a^T.
        pair: `pair_covariance` of a and b.
    """
    by_pose = np.concatenate([-relative, np.zeros((3, 3)), np.eye(3), np.zeros((3, 3))], 1)
    return by_pose @ pair @ by_pose.T


def _relate(
    a: Camera, b: Camera, covariances: Sequence[Float64[np.ndarray, "12 12"]]
) -> tuple[float, float, float, float]:
    """Baseline and turn, each with its standard deviation, of `PAIR_COLUMNS`."""
    between, relative = b.center - a.center, b.R @ a.R.T
    baseline = float(np.linalg.norm(between))
    along = between / max(baseline, np.finfo(np.float64).tiny)
    by_length = np.concatenate([np.zeros(3), -along, np.zeros(3), along])
    length = max(float(by_length @ covariance @ by_length) for covariance in covariances)
    turn = max(float(np.trace(turn_covariance(relative, covariance))) / 3 for covariance in covariances)
    angle = np.linalg.norm(rotation_vector_from_matrix(relative))
    # Rounding may leave less than nothing of what does not vary.
    sigma, turn_sigma = np.sqrt(np.maximum([length, turn], 0))
    return baseline, float(sigma), float(np.degrees(angle)), float(np.degrees(turn_sigma))
