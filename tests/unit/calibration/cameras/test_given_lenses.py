"""Lenses that are given and somewhat wrong: refined ones against planted truth, over twenty rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

from pipeline.calibration.cameras.intrinsics_priors import given_prior_sigma
from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_inputs import RigPriors
from tests.support.rigs.cameras import (
    BOARD,
    boards_in_stage,
    center_errors,
    observe,
    planted_cameras,
    without_small_views,
)

RIGS, CAMERAS, VIEWS, NOISE_PX = 20, 3, 5, 0.3

GIVEN = 0.01
"""Error of a given focal length over itself, by which go those of all else."""


def misremembered(camera, random):
    """The camera with a lens that is off by as much as `given_lens_error` says."""
    sigma = given_prior_sigma(camera, GIVEN)
    f, aspect, cx, cy, *terms = camera.intrinsics() + sigma * random.normal(size=len(sigma))
    return replace(camera, K=np.array([[f, 0, cx], [0, f * aspect, cy], [0, 0, 1]]), dist=np.array(terms))


@pytest.fixture(scope="module")
def errors():
    """Of each rig: relative errors of focal lengths and their covariance's, and errors of centres, by what is known."""
    found = {"known": [], "refine": [], "estimate": []}
    for seed in range(RIGS):
        random = np.random.default_rng(seed)
        cameras, boards = planted_cameras(CAMERAS, random, arc=1.2), boards_in_stage(VIEWS, random, arc=1.2)
        seen, numbers = without_small_views(observe(cameras, boards, NOISE_PX, random))
        boards = boards[numbers]
        given = [misremembered(camera, random) for camera in cameras]
        # In the frame of the first board: no error is one of the start.
        frame = boards[0]
        start = [replace(g, R=g.R @ frame[:3, :3], t=g.R @ frame[:3, 3] + g.t) for g in given]
        for use, known in (
            ("known", RigPriors(given, 0.0)), ("refine", RigPriors(given, GIVEN)), ("estimate", RigPriors()),
        ):  # fmt: skip
            rig = adjust_rig(seen, BOARD.corners_m(), start, np.linalg.inv(frame) @ boards, 5, known=known)
            focal = np.array([f.K[0, 0] / true.K[0, 0] - 1 for f, true in zip(rig.cameras, cameras, strict=True)])
            found[use].append((focal, rig.focal_sigma, center_errors(rig.cameras, cameras), rig.center_sigma_m))
    return {use: [np.stack(part) for part in zip(*rows, strict=True)] for use, rows in found.items()}


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_refined_lenses_are_better_than_given_and_than_estimated_ones(errors):
    """Five views of a board tell a focal length to a per cent or so, as the given lenses do."""
    focal = {use: rms(rows[0]) for use, rows in errors.items()}
    assert focal["refine"] < 0.8 * focal["known"] and focal["refine"] < 0.8 * focal["estimate"]
    centers = {use: rms(rows[2]) for use, rows in errors.items()}
    assert centers["refine"] < 0.8 * centers["known"] and centers["refine"] < 0.8 * centers["estimate"]


def test_refined_lenses_are_as_far_off_as_their_error_bars_say(errors):
    focal, sigma, center, center_sigma = errors["refine"]
    # Focal lengths of one rig go together: as few as one number per rig are independent.
    low, high = scipy.stats.chi2.ppf([5e-4, 1 - 5e-4], RIGS) / RIGS
    assert low < rms(focal / sigma) ** 2 < high
    assert low < rms(center / center_sigma[..., None]) ** 2 < high


def test_given_lenses_are_known_no_less_well_than_ordinary_ones():
    (camera,) = planted_cameras(1, np.random.default_rng(0))
    f = camera.K[0, 0]
    ordinary = [np.inf, 0.01, 0.03 * 640, 0.03 * 640, 0.5, 0.5, 0.01, 0.01, 0.5]
    assert given_prior_sigma(camera, 0.01) == pytest.approx(
        [0.01 * f, 1e-3, 0.01 * f, 0.01 * f, 0.05, 0.05, 1e-3, 1e-3, 0.05]
    )
    assert given_prior_sigma(camera, 0.5) == pytest.approx([0.5 * f, *ordinary[1:]])


def test_known_lenses_stay(errors):
    focal, sigma, *_ = errors["known"]
    assert rms(focal) == pytest.approx(GIVEN, rel=0.25) and not sigma.any()
