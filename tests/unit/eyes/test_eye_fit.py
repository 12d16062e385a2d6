"""Eyes fitted to planted vertices: spheres with and without a cornea, noise, outliers, and what is no eye."""

import dataclasses

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.eyes.eye_fit import fit_eye, read_eyes
from pipeline.eyes.eye_shape import EyeShape, eye_surface, usual_shape

CENTER = np.array([0.032, 0.010, 0.0625])
AXIS = np.array([0.1, -0.05, 1.0]) / np.linalg.norm([0.1, -0.05, 1.0])
TRUE = EyeShape(0.0121, 0.0076, 0.0058)


def planted(shape, subdivisions=3, frames=6, noise_m=0.0, seed=0):
    """The part at rest and, turned about its centre, in some frames; and where its axis points there."""
    rng = np.random.default_rng(seed)
    w = np.asarray(trimesh.creation.icosphere(subdivisions).vertices)
    part = eye_surface(w, AXIS, shape.radius_m, shape.cornea_radius_m, shape.cornea_offset_m).points
    turns = Rotation.from_euler("YX", rng.uniform(-20, 20, (frames, 2)), degrees=True).as_matrix()
    tracked = part @ turns.transpose(0, 2, 1) + CENTER
    return part + CENTER, tracked + noise_m * rng.normal(size=tracked.shape), turns @ AXIS


def fit(rest, tracked, gaze, cornea="auto"):
    return fit_eye("eye_l", tuple(range(len(rest))), rest, tracked, gaze, cornea)


def sizes(shape):
    return np.array(dataclasses.astuple(shape))


def test_finds_both_spheres():
    found = fit(*planted(TRUE))
    assert found.status == "cornea"
    np.testing.assert_allclose(found.center, CENTER, atol=1e-7)
    np.testing.assert_allclose(found.axis, AXIS, atol=1e-7)
    np.testing.assert_allclose(sizes(found.shape), sizes(TRUE), atol=1e-6)
    assert found.rms_m < 1e-6 and found.gaze_rms_deg < 1e-3


def test_noise_and_outliers_move_it_no_further_than_it_says():
    """The same error in every frame, as a tracked part has; a tenth of the vertices belong to something else."""
    errors, sigmas = [], []
    for seed in range(12):
        rest, tracked, gaze = planted(TRUE, seed=seed)
        rng = np.random.default_rng(100 + seed)
        shift = 1e-4 * rng.normal(size=tracked.shape[1:])
        shift[rng.choice(len(shift), len(shift) // 10, replace=False)] += 0.004
        found = fit(rest, tracked + shift, gaze)
        assert found.status == "cornea"
        errors.append([found.center[0] - CENTER[0], *(sizes(found.shape) - sizes(TRUE))])
        sigmas.append([found.sigma_m[name] for name in ("center", "radius", "cornea_radius", "cornea_offset")])
    ratio = np.sqrt(np.mean(np.square(errors), 0)) / np.mean(sigmas, 0)
    assert (ratio < 2).all(), ratio
    assert np.max(np.abs(errors)) < 5e-4


@pytest.mark.parametrize("noise_m", [0.0, 1e-4])
def test_sphere_without_a_cornea_gets_the_usual_one_and_says_so(noise_m):
    ball = EyeShape(0.0125, 0.0125, 0.0)
    found = fit(*planted(ball, 2, noise_m=noise_m))
    assert found.status == "usual" and set(found.sigma_m) == {"center", "radius"}
    np.testing.assert_allclose(found.center, CENTER, atol=1e-7 + noise_m)
    np.testing.assert_allclose(sizes(found.shape), sizes(usual_shape(0.0125)), atol=1e-7 + noise_m)


def test_cornea_may_be_left_out_or_assumed():
    assert fit(*planted(EyeShape(0.0125, 0.0125, 0.0)), "none").shape.is_sphere
    assert fit(*planted(TRUE), "none").status == "sphere"
    assumed = fit(*planted(TRUE), "usual")
    assert assumed.status == "usual"
    # The cornea's vertices are outliers to the eyeball.
    assert assumed.shape.radius_m == pytest.approx(TRUE.radius_m, abs=1e-4)


def test_front_of_an_eye_is_enough():
    rest, tracked, gaze = planted(TRUE)
    front = (rest - CENTER) @ AXIS > 0.004
    found = fit(rest[front], tracked[:, front], gaze)
    np.testing.assert_allclose(found.center, CENTER, atol=1e-6)
    np.testing.assert_allclose(sizes(found.shape), sizes(TRUE), atol=1e-5)


def test_eye_that_does_not_follow_the_gaze_is_told(caplog):
    rest, _, gaze = planted(TRUE, frames=9)
    found = fit(rest, np.tile(rest, (9, 1, 1)), gaze)
    assert found.gaze_rms_deg > 5
    assert "does not follow" in caplog.text


def test_what_is_no_eye_is_one_clear_error():
    rest, tracked, gaze = planted(TRUE)
    for scale, told in ((1000.0, "check scale_to_m"), (0.1, "check scale_to_m")):
        with pytest.raises(InputError, match=told):
            fit(scale * rest, scale * tracked, gaze)
    flat = rest * [1, 1, 0]
    with pytest.raises(InputError, match="eye_l: expected vertices"):
        fit(flat, np.tile(flat, (6, 1, 1)), gaze)
    line = rest * [1, 0, 0]
    with pytest.raises(InputError, match="eye_l: expected"):
        fit(line, np.tile(line, (6, 1, 1)), gaze)
    with pytest.raises(InputError, match="expected 12 places"):
        fit(rest[:8], tracked[:, :8], gaze)
    with pytest.raises(InputError, match="a frame with gaze, found 642 and 0"):
        fit(rest, tracked[:0], gaze[:0])
    with pytest.raises(InputError, match="about one direction"):
        fit(rest, np.tile(rest, (6, 1, 1)), np.concatenate([np.eye(3), -np.eye(3)]))
    few = np.linalg.norm(rest - rest[0], axis=1) < 0.004  # a patch of noise says little about a sphere
    noisy = tracked + 3e-4 * np.random.default_rng(1).normal(size=tracked.shape)
    with pytest.raises(InputError, match="good to"):
        fit(rest[few], noisy[:1, few], gaze[:1])


def test_file_keeps_everything_and_is_checked(tmp_path):
    found = fit(*planted(TRUE))
    write_json(tmp_path / "eyes.json", {"eye_r": found.as_json(), "eye_l": found.as_json()})
    assert read_eyes(tmp_path / "eyes.json") == {"eye_l": found, "eye_r": found}
    write_json(tmp_path / "eyes.json", {"eye_l": {**found.as_json(), "cornea_radius_m": 0.02}})
    with pytest.raises(InputError, match=r"eyes.json: eye_l: expected a cornea that is smaller .* found 20.00 mm"):
        read_eyes(tmp_path / "eyes.json")
    write_json(tmp_path / "eyes.json", {"eye_l": {"center": [0, 0, 0]}})
    with pytest.raises(InputError, match=r"expected the keys .* run fit_eyes again"):
        read_eyes(tmp_path / "eyes.json")
