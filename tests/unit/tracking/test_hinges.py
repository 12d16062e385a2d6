"""Hinges of a template: what they cost, and a limb whose twist they alone tell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.geometry.kinematics import Pose, TrackedPoints, point_positions, tracked_points
from pipeline.geometry.skin import Template
from pipeline.geometry.template_file import read_joint_names, read_template
from pipeline.tracking.hinges import hinge_axes
from pipeline.tracking.motion_prior import DECORRELATION_S, HINGE_PLAY_RAD, MotionPrior, prior_cost
from pipeline.tracking.pose_solver import position_term, solve_poses
from tests.support.figures.walking import BONES, write_template

NAMES = [bone[0] for bone in BONES]
ELBOW = NAMES.index("left_forearm")
FRAMES, STEP_S = 4, 1 / 24
VERTICES_OF_A_TUBE = 62


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_template(tmp_path / "t.glb", units_per_m=100.0)


@pytest.fixture
def template(file: Path) -> Template:
    return read_template(file, 0.01)


@pytest.fixture
def prior_with(file: Path, template: Template) -> Callable[[dict], MotionPrior]:
    times = STEP_S * np.arange(FRAMES)
    return lambda hinges: MotionPrior(times, 30.0, 10.0, 1.0, hinges=hinge_axes(hinges, file, template))


@pytest.fixture
def points(template: Template) -> TrackedPoints:
    """All joints, and the tip of the left forearm, which lies on its axis."""
    tip = ELBOW * VERTICES_OF_A_TUBE + VERTICES_OF_A_TUBE - 1
    joints = np.append(np.arange(len(BONES)), -1)
    return tracked_points(template, joints, np.append(np.full(len(BONES), -1), tip))


def bent(points: TrackedPoints, turn: Rotation, joint: int = ELBOW) -> Pose:
    """The rest pose with one joint turned from its rest, in all frames."""
    pose = points.rest_pose(FRAMES)
    rotations = pose.joint_rotations.copy()
    rotations[:, joint] = (Rotation.from_quat(rotations[0, joint], scalar_first=True) * turn).as_quat(scalar_first=True)
    return replace(pose, joint_rotations=rotations)


def test_bending_a_hinge_costs_what_it_costs_without_and_turning_it_otherwise_more(
    points: TrackedPoints, prior_with: Callable
) -> None:
    free, hinged = prior_with({}), prior_with({"left_forearm": "z"})
    about = bent(points, Rotation.from_rotvec([0.0, 0.0, 1.2]))
    across = bent(points, Rotation.from_rotvec([0.3, 0.0, 0.0]))
    elsewhere = bent(points, Rotation.from_rotvec([0.3, 0.0, 0.0]), NAMES.index("right_forearm"))
    extra = [prior_cost(hinged, points, pose) - prior_cost(free, points, pose) for pose in (about, across, elsewhere)]
    expected = 0.5 * (0.3 / HINGE_PLAY_RAD) ** 2 * FRAMES * STEP_S / DECORRELATION_S
    assert extra == pytest.approx([0.0, expected, 0.0], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("axis", "degrees"), [("z", 20.0), ("negative_z", -20.0)])
def test_bending_a_hinge_backwards_costs_as_turning_it_otherwise(
    points: TrackedPoints, prior_with: Callable, axis: str, degrees: float
) -> None:
    hinged, free = prior_with({"left_forearm": axis}), prior_with({})
    ways = [bent(points, Rotation.from_rotvec([0.0, 0.0, sign * np.radians(degrees)])) for sign in (1.0, -1.0)]
    extra = [prior_cost(hinged, points, pose) - prior_cost(free, points, pose) for pose in ways]
    expected = 0.5 * (np.radians(20.0) / HINGE_PLAY_RAD) ** 2 * FRAMES * STEP_S / DECORRELATION_S
    assert extra == pytest.approx([0.0, expected], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(("axis", "angle"), [("z", 1.2), ("negative_z", -1.2)])
def test_hinge_tells_the_twist_that_keypoints_do_not(
    template: Template, points: TrackedPoints, prior_with: Callable, axis: str, angle: float
) -> None:
    """The elbow bends about an axis that is oblique to the forearm, so that bending also turns it about itself."""
    truth = bent(points, Rotation.from_rotvec([0.0, 0.0, angle]))
    forearm = np.arange(ELBOW * VERTICES_OF_A_TUBE, (ELBOW + 1) * VERTICES_OF_A_TUBE)
    surface = tracked_points(template, np.full(len(forearm), -1), forearm)
    seen = point_positions(points, truth)
    term = position_term(seen, np.full(seen.shape[:2], 1e-3))

    def off(hinges: dict) -> float:
        pose, _ = solve_poses(points, term, prior_with(hinges), points.rest_pose(FRAMES), 60)
        assert np.abs(point_positions(points, pose) - seen).max() < 1e-3
        return np.linalg.norm(point_positions(surface, pose) - point_positions(surface, truth), axis=-1).max()

    assert off({}) > 8e-3
    assert off({"left_forearm": axis}) < 1.5e-3


def test_names_are_those_of_the_file(file: Path, template: Template) -> None:
    assert read_joint_names(file, template) == NAMES


@pytest.mark.parametrize(
    ("rigged", "known"), [(True, "pelvis, spine, head"), (False, "none, as the template has no skin")]
)
def test_hinges_that_no_joint_has_are_all_named(tmp_path: Path, rigged: bool, known: str) -> None:
    file = write_template(tmp_path / "t.glb", rigged=rigged)
    with pytest.raises(InputError) as refused:
        hinge_axes({"elbow_l": "x", "elbow_r": "y"}, file, read_template(file, 1.0))
    message = str(refused.value)
    assert "track_mesh.hinges.elbow_l" in message and "track_mesh.hinges.elbow_r" in message and known in message
