"""Rays through boxes of voxels: closed forms, the float64 twin, and finite differences."""

from __future__ import annotations

import math
from dataclasses import replace

import numba
import pytest
import torch
from scipy.spatial.transform import Rotation
from scipy.special import gamma, gammainc

from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.volume_conventions import FADE_POWER, FADE_SCALE
from pipeline.rendering.volume_march import march
from pipeline.rendering.volume_torch import march_torch
from pipeline.rendering.volume_types import Volumes
from tests.support.avatars.boxes import STEP_M, TINTED, boxes, camera, compare, drawn, one_box

ROUNDING = 1e-12
"""float64 sums of a hundred samples, each rounded at 1e-16, with a margin."""

FLOAT32 = 5e-6
"""float32 numbers go into float64 sums on the CPU, 4e-7 measured; by torch all is float32, 2e-6."""

WAYS = pytest.mark.parametrize("way", [march, march_torch])
MIDDLE = (8, 10)
"""The pixel whose centre is on the axis of `camera(21, 17)`."""


def faded_length(half_size):
    """Integral of the fade along the axis of a box: 2 s int_0^1 exp(-8 z^8) dz, an incomplete gamma function."""
    power = 1 / FADE_POWER
    return 2 * half_size * gammainc(power, FADE_SCALE) * gamma(power) * power * FADE_SCALE**-power


@WAYS
def test_constant_density_head_on_adds_up_to_density_times_faded_length(way):
    scene, view, step = one_box(density=1.7), camera(21, 17), 1e-3
    found = way(scene.volumes, scene.features, TINTED, view, step)
    expected = 1.7 * faded_length(0.2)
    # The midpoint rule; where the box ends with e^-8 of its density, half a step more or less.
    tolerance = 1.7 * step * math.exp(-FADE_SCALE)
    assert abs(float(found.alpha[MIDDLE]) - expected) < tolerance + ROUNDING
    color = torch.tensor([0.2, 0.4, 0.8, 0.5], dtype=torch.float64)
    assert torch.allclose(found.features[MIDDLE], found.alpha[MIDDLE] * color, atol=ROUNDING)
    assert abs(float(found.depth[MIDDLE] / found.alpha[MIDDLE]) - 1.5) < step  # symmetric about its centre


@WAYS
def test_dense_box_stops_at_one_with_its_own_colour(way):
    scene = one_box(density=100.0)
    found = way(scene.volumes, scene.features, TINTED, camera(21, 17), STEP_M)
    assert float(found.alpha[MIDDLE]) == pytest.approx(1.0, abs=ROUNDING)
    assert float(found.alpha.max()) <= 1.0
    color = torch.tensor([0.2, 0.4, 0.8, 0.5], dtype=torch.float64)
    assert torch.allclose(found.features[MIDDLE], color, atol=ROUNDING)
    assert 1.3 < float(found.depth[MIDDLE]) < 1.35


@WAYS
def test_opacity_is_added_and_what_is_behind_gets_the_rest(way):
    front, back = one_box(density=1.0, color=(1.0, 0, 0, 0)), one_box(100.0, (0, 1.0, 0, 0), center=(0, 0, 2.5))
    parts = zip(front.volumes.named().values(), back.volumes.named().values(), strict=True)
    both = Volumes(*(torch.cat(pair) for pair in parts))
    view = camera(21, 17)
    alone = way(front.volumes, front.features, TINTED, view, STEP_M).alpha[MIDDLE]
    found = way(both, torch.cat([front.features, back.features]), TINTED, view, STEP_M).features[MIDDLE]
    assert 0.25 < float(alone) < 0.35
    assert torch.allclose(found[:2], torch.stack([alone, 1 - alone]), atol=ROUNDING)


@WAYS
def test_box_upon_itself_is_twice_as_dense(way):
    once, twice = one_box(density=2.0), one_box(density=1.0)
    doubled = twice.volumes.map(lambda a: torch.cat([a, a]))
    one = way(once.volumes, once.features, TINTED, camera(), STEP_M)
    two = way(doubled, torch.cat([twice.features, twice.features]), TINTED, camera(), STEP_M)
    assert torch.allclose(one.features, two.features, atol=ROUNDING)
    assert torch.allclose(one.alpha, two.alpha, atol=ROUNDING)


@WAYS
def test_tint_multiplies_colour_and_no_other_channel(way):
    scene, view = one_box(), camera()
    plain = way(scene.volumes, scene.features, TINTED, view, STEP_M).features
    tint = scene.volumes.tint * torch.tensor([0.5, 1.0, 3.0], dtype=torch.float64)
    found = way(replace(scene.volumes, tint=tint), scene.features, TINTED, view, STEP_M).features
    factors = torch.tensor([0.5, 1.0, 3.0, 1.0], dtype=torch.float64)
    assert torch.allclose(found, plain * factors, atol=ROUNDING)


@WAYS
def test_camera_that_moves_with_the_boxes_sees_the_same(way):
    scene, view = boxes(), camera()
    R = torch.as_tensor(Rotation.from_rotvec([0.3, -0.5, 0.8]).as_matrix())
    t = torch.tensor([0.4, -2.0, 1.0], dtype=torch.float64)
    volumes = replace(scene.volumes, centers=scene.volumes.centers @ R.T + t, rotations=R @ scene.volumes.rotations)
    moved = CameraView(view.R @ R.T, view.t - view.R @ R.T @ t, view.K, view.width, view.height)
    one = way(scene.volumes, scene.features, TINTED, view, STEP_M)
    other = way(volumes, scene.features, TINTED, moved, STEP_M)
    # A sample on a face, where alpha is e^-8 of its density, may round to the other side.
    edge = 3.0 * STEP_M * math.exp(-FADE_SCALE)
    assert torch.allclose(one.features, other.features, atol=edge)
    assert torch.allclose(one.depth, other.depth, atol=2 * edge)


@WAYS
@pytest.mark.parametrize("density", [0.5, 3.0, 30.0, 300.0])
@pytest.mark.parametrize(("kind", "tolerance"), [(torch.float64, ROUNDING), (torch.float32, FLOAT32)])
def test_pictures_and_gradients_are_those_of_the_twin(way, density, kind, tolerance):
    found = compare(boxes(density=density), function=way, kind=kind)
    assert found.finite
    assert found.value < tolerance
    assert max(found.gradients.values()) < tolerance, found.gradients


@pytest.mark.parametrize("density", [0.8, 60.0])
def test_gradients_are_those_of_finite_differences(density):
    """Rays that stay transparent, and rays that end in a box. By torch and of the twin they are the same, see above."""
    scene, view = boxes(2, density=density, depth=1.0, spread=0.05, grid=(2, 3, 2)), camera(4, 3, focal=9.0)
    leaves = [a.clone().requires_grad_() for a in (*scene.volumes.named().values(), scene.features)]
    alpha = march(scene.volumes, scene.features, TINTED, view, 0.05).alpha
    assert float(alpha.max()) == 1 if density > 1 else float(alpha.max()) < 1

    def seen(*tensors):
        found = march(Volumes(*tensors[:-1]), tensors[-1], TINTED, view, 0.05)
        return found.features, found.alpha, found.depth

    assert torch.autograd.gradcheck(seen, leaves, eps=1e-7, atol=1e-5, rtol=1e-4)


def test_threads_and_runs_give_the_same_bits():
    scene, view = boxes(12).to(torch.float32), camera(70, 50, focal=90.0).to(torch.float32)
    found, threads = [], numba.get_num_threads()
    try:
        for count in (1, numba.config.NUMBA_NUM_THREADS, 1):
            numba.set_num_threads(count)
            found.append(drawn(march, scene, view))
    finally:
        numba.set_num_threads(threads)
    for image, gradients in found[1:]:
        assert torch.equal(image, found[0][0])
        assert all(torch.equal(gradients[name], found[0][1][name]) for name in gradients)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"density": -torch.ones(5, 3, 4, 5, dtype=torch.float64)}, "density: expected none below 0"),
        ({"centers": torch.full((5, 3), math.nan, dtype=torch.float64)}, "centers: expected finite numbers"),
    ],
)
def test_boxes_that_cannot_be_drawn_are_refused(change, message):
    scene = boxes()
    with pytest.raises(ValueError, match=message):
        march(replace(scene.volumes, **change), scene.features, TINTED, camera(), STEP_M)


def test_arguments_that_do_not_fit_are_refused():
    scene = boxes()
    with pytest.raises(ValueError, match="tinted: expected"):
        march(scene.volumes, scene.features, (0, 1, 2), camera(), STEP_M)
    with pytest.raises(ValueError, match="features: expected a value for each column"):
        march(scene.volumes, scene.features[:, :2], TINTED, camera(), STEP_M)
    with pytest.raises(ValueError, match="step_m: expected a positive number"):
        march(scene.volumes, scene.features, TINTED, camera(), 0.0)
