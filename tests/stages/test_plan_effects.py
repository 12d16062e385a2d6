"""Decisions on scenes that were built to call for an effect, or not to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, read_json, write_arrays
from pipeline.config.effects import EFFECTS
from pipeline.config.plan_effects import PlanEffects
from pipeline.effects.scene_evidence import rotation_spread_deg
from pipeline.stages.plan_effects import run
from tests.support.captures.posed import BALL_HEIGHT, BALL_RADIUS, write_cameras_and_color, write_posed_capture

UNSEEN = {"specular", "deferred", "learned_transport", "eyes"}
"""What captures without images (and eyes) cannot call for."""


def plan(
    folder: Path, settings: PlanEffects | None = None, *, ball: bool = True, light_distance: float = 5.0,
    k1: float = 0.01, gain: float = 1.05,
) -> dict[str, dict]:  # fmt: skip
    paths = write_posed_capture(folder, ball=ball, light_distance=light_distance)
    paths |= write_cameras_and_color(folder, k1, gain)
    run(**arguments(paths), out=folder / "effects.json", settings=settings or PlanEffects())
    return read_json(folder / "effects.json")


def arguments(paths: dict[str, Path]) -> dict[str, object]:
    """Files by name as arguments of the stage."""
    others = {name: path for name, path in paths.items() if name not in ("frames", "tracking")}
    return {"capture": paths["atlas"].parent, **others, "booked": paths["frames"], "tracking": (paths["tracking"],)}


def test_a_scene_that_calls_for_everything_but_joints(tmp_path: Path) -> None:
    effects = plan(tmp_path)
    assert tuple(effects) == EFFECTS
    assert {name for name, effect in effects.items() if effect["on"]} == set(EFFECTS) - UNSEEN - {"articulation"}
    for effect in effects.values():
        assert set(effect) == {"on", "mode", "evidence", "threshold", "why", "cost"}
        assert effect["mode"] == "auto"
    # The texels are the floor's. Three quarters of the pairs are with L0: all in one frame, half in the other. Its
    # shadow is a disc; L1, 45 degrees aside, casts an ellipse, at most 2.5 times as large and partly beyond the floor.
    half_angle = np.arcsin(BALL_RADIUS / (5 - BALL_HEIGHT))
    upright = np.pi * (5 * np.tan(half_angle)) ** 2 / 36
    assert 75 * upright < effects["shadow"]["evidence"] < 75 * upright + 25 * 2.5 * upright
    # Gain 1.05 is 5 %.
    assert effects["color_correction"]["evidence"] == pytest.approx(5)
    # Farthest corner of a 200 x 100 image seen with f = 100: r^2 = 1.25, displacement k1 r^3 f sensor pixels.
    assert effects["lens_distortion"]["evidence"] == pytest.approx(0.01 * 1.25**1.5 * 100 / 2)
    assert "bent" in effects["lens_distortion"]["why"]


def test_a_scene_that_calls_for_nothing(tmp_path: Path) -> None:
    effects = plan(tmp_path, ball=False, light_distance=1e4, k1=0.0, gain=1.0)
    assert not any(effect["on"] for effect in effects.values())
    assert effects["shadow"]["evidence"] == 0
    assert effects["lens_distortion"]["evidence"] == pytest.approx(0, abs=1e-9)


def test_what_is_near_is_not_a_shadow(tmp_path: Path) -> None:
    effects = plan(tmp_path, PlanEffects(local_radius_percent=100))
    assert effects["shadow"]["evidence"] == 0


def test_modes_are_obeyed_and_told(tmp_path: Path) -> None:
    effects = plan(tmp_path, PlanEffects(shadow="off", articulation="on"))
    assert not effects["shadow"]["on"]
    assert effects["shadow"]["evidence"] > 1
    assert effects["shadow"]["why"].startswith("forced off")
    assert effects["articulation"]["on"]


def test_near_field_on_paper(tmp_path: Path) -> None:
    """A light at height H over a floor of half side 3: L falls from 1 at the centre to H^2 / (H^2 + 18) in the corners;
    the 95th percentile lies below that and above half of it."""
    effects = plan(tmp_path, ball=False, light_distance=30.0)
    assert 1 < effects["near_field"]["evidence"] < 100 * ((900 + 900) / ((30 - 3) ** 2 + 900) - 1)


def test_rotation_spread() -> None:
    """A joint that swings by +-30 degrees uniformly has its 95th percentile at 28.5; signs of quaternions are noise."""
    angle = np.radians(np.linspace(-30, 30, 401)) / 2
    swinging = np.stack([np.cos(angle), 0 * angle, np.sin(angle), 0 * angle], 1)
    swinging[::2] *= -1
    still = np.tile([0.6, 0.8, 0, 0], (401, 1))
    spreads = rotation_spread_deg(np.stack([still, swinging], 1))
    np.testing.assert_allclose(spreads, [0, 28.5], atol=1e-5)


def test_articulation_is_read_from_the_tracking(tmp_path: Path) -> None:
    paths = write_posed_capture(tmp_path) | write_cameras_and_color(tmp_path, 0.0, 1.0)
    arrays = read_arrays(paths["tracking"])
    turns = np.radians([-10.0, 10, -10, 10]) / 2
    rotations = np.stack([np.cos(turns), np.sin(turns), 0 * turns, 0 * turns], 1)[:, None].astype(np.float32)
    write_arrays(paths["tracking"], arrays | {"joint_rotations": rotations})
    run(**arguments(paths), out=tmp_path / "effects.json")
    effect = read_json(tmp_path / "effects.json")["articulation"]
    assert effect["on"]
    assert effect["evidence"] == pytest.approx(10, abs=1e-3)
    with pytest.raises(InputError, match="tracking"):
        run(**{**arguments(paths), "tracking": ()}, out=tmp_path / "effects.json")


def test_same_seed_same_numbers(tmp_path: Path) -> None:
    assert plan(tmp_path / "a") == plan(tmp_path / "b")
