"""The splatting kernels against closed forms, against the dense float64 reference, and against themselves."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.base.kernel_cache import sources_digest
from pipeline.rendering.splat_conventions import MIN_ALPHA, check_splat_inputs
from pipeline.rendering.splat_types import CameraView
from tests.support.avatars.splat_by_names import compare_with_reference, splat, splat_reference

FLOAT32_IMAGE = 1e-5
"""Absolute, for values near 1: float32 exp and some tens of blended layers, 6e-8 each and amplified by q <= 11."""

VALUE_TOLERANCE = 1e-4
GRADIENT_TOLERANCE = 1e-4
"""Against the float64 reference, absolute and relative: what training needs; the kernels reach 1e-6."""


def camera(width, height, focal=60.0):
    """A turned, moved camera whose principal point is not the middle."""
    R = torch.from_numpy(Rotation.from_rotvec([0.2, -0.3, 0.4]).as_matrix())
    K = torch.tensor([[focal, 0, width * 0.47], [0, focal * 1.1, height * 0.55], [0, 0, 1]], dtype=torch.float64)
    return {"R": R, "t": torch.tensor([0.1, -0.2, 0.3]).double(), "K": K, "width": width, "height": height}


def frontal_camera(size, focal=50.0):
    """The world is the camera's frame; the ray of the image's middle is z."""
    K = torch.tensor([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    return {"R": torch.eye(3), "t": torch.zeros(3), "K": K, "width": size, "height": size}


def gaussians_before(view, count, channels, seed=0, scale=0.06):
    """Random Gaussians in the camera's view, 1.5 to 3.5 m away."""
    draws = np.random.default_rng(seed)
    depth = draws.uniform(1.5, 3.5, count)
    pixels = draws.uniform(-0.1, 1.1, (count, 2)) * [view["width"], view["height"]]
    rays = np.concatenate([pixels, np.ones((count, 1))], 1) @ np.linalg.inv(view["K"].double().numpy()).T
    means = (rays * depth[:, None] - view["t"].numpy()) @ view["R"].numpy()
    arrays = {
        "means": means,
        "quaternions": draws.normal(size=(count, 4)),
        "scales": scale * draws.uniform(0.1, 1.5, (count, 3)),
        "opacities": draws.uniform(0.02, 1.0, count),
        "features": draws.normal(size=(count, channels)),
    }
    return {name: torch.tensor(array, dtype=torch.float32) for name, array in arrays.items()}


def one_gaussian(depth=2.0, scales=(0.1, 0.1, 0.1), quaternion=(1, 0, 0, 0), opacity=0.8, features=(0.3, -2.0)):
    return {
        "means": torch.tensor([[0.0, 0.0, depth]]),
        "quaternions": torch.tensor([quaternion], dtype=torch.float32),
        "scales": torch.tensor([scales], dtype=torch.float32),
        "opacities": torch.tensor([opacity]),
        "features": torch.tensor([features]),
    }


def offsets(size):
    """Pixel centres relative to the middle of a square image: x, y."""
    center = np.arange(size) + 0.5 - size / 2
    return np.meshgrid(center, center)


@pytest.mark.parametrize("render", [splat, splat_reference])
@pytest.mark.parametrize(("depth", "theta", "scales"), [(2.0, 0.0, (0.1, 0.1, 0.1)), (3.0, 0.7, (0.3, 0.08, 0.2))])
def test_single_gaussian_has_its_analytic_footprint(render, depth, theta, scales):
    """On the optical axis J is f / z, so the covariance is the rotated, scaled in-plane one plus the dilation."""
    view = frontal_camera(31)
    quaternion = (math.cos(theta / 2), 0, 0, math.sin(theta / 2))
    out = render(**one_gaussian(depth, scales, quaternion), **view, dilation_px2=0.3)
    turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
    covariance = turn @ np.diag(np.square(scales[:2])) @ turn.T * (50.0 / depth) ** 2 + 0.3 * np.eye(2)
    x, y = offsets(31)
    q = np.einsum("iyx,ij,jyx->yx", np.array([x, y]), np.linalg.inv(covariance), np.array([x, y]))
    alpha = 0.8 * np.exp(-0.5 * q)
    alpha[alpha < MIN_ALPHA] = 0
    np.testing.assert_allclose(out.alpha, alpha, atol=FLOAT32_IMAGE)
    np.testing.assert_allclose(out.depth, alpha * depth, atol=depth * FLOAT32_IMAGE)
    np.testing.assert_allclose(out.features, alpha[..., None] * [0.3, -2.0], atol=2 * FLOAT32_IMAGE)


@pytest.mark.parametrize("render", [splat, splat_reference])
@pytest.mark.parametrize(
    ("opacities", "median", "alpha"),
    [
        ((0.3, 0.4, 0.9, 0.9), 3.0, 0.9958),  # 0.7, then 0.42 of the light gets through: the second takes it below 1/2
        ((0.6, 0.9, 0.9, 0.9), 2.0, 0.9996),
        ((0.1, 0.2, 0.1, 0.1), 5.0, 0.4168),  # more than half gets past all: the last one
        ((0.1, 0.0, 0.2, 0.0), 4.0, 0.28),
    ],
)
def test_median_depth_is_where_half_of_the_light_is_gone(render, opacities, median, alpha):
    view = frontal_camera(9)
    stack = {name: a.repeat(4, *[1] * (a.dim() - 1)) for name, a in one_gaussian(scales=(50.0,) * 3).items()}
    stack["means"], stack["opacities"] = torch.tensor([[0, 0, 2.0 + k] for k in range(4)]), torch.tensor(opacities)
    stack["means"].requires_grad_()
    out = render(**stack, **view, median_depth=True)
    plain = render(**stack, **view)
    np.testing.assert_allclose(out.alpha[4, 4].detach(), alpha, atol=2e-4)
    np.testing.assert_allclose(out.depth[4, 4], alpha * median, rtol=3e-4)
    assert not out.depth.requires_grad
    assert torch.equal(out.features, plain.features) and torch.equal(out.alpha, plain.alpha)


@pytest.mark.parametrize("depths", [(1.0, 2.0), (2.0, 1.0), (2.0, 2.0)])
def test_two_gaussians_blend_front_to_back_and_ties_go_by_index(depths):
    view = frontal_camera(9)
    pair = {name: a.repeat(2, *[1] * (a.dim() - 1)) for name, a in one_gaussian(scales=(5.0, 5.0, 5.0)).items()}
    pair["means"] = torch.tensor([[0, 0, depths[0]], [0, 0, depths[1]]])
    pair["opacities"], pair["features"] = torch.tensor([0.6, 0.5]), torch.tensor([[1.0, 0.0], [0.0, 1.0]])
    out = splat(**pair, **view)
    front = 0 if depths[0] <= depths[1] else 1
    expected = np.zeros(2)
    expected[front] = pair["opacities"][front]
    expected[1 - front] = (1 - pair["opacities"][front]) * pair["opacities"][1 - front]
    np.testing.assert_allclose(out.features[4, 4], expected, atol=FLOAT32_IMAGE)
    np.testing.assert_allclose(out.alpha[4, 4], 1 - 0.4 * 0.5, atol=FLOAT32_IMAGE)
    np.testing.assert_allclose(out.depth[4, 4], expected @ depths, atol=FLOAT32_IMAGE)


def test_opaque_layers_hide_what_is_behind_them():
    view = frontal_camera(5)
    stack = {
        name: a.repeat(4, *[1] * (a.dim() - 1)) for name, a in one_gaussian(scales=(9.0,) * 3, opacity=1.0).items()
    }
    stack["means"] = torch.tensor([[0, 0, 2.0 + k] for k in range(4)])
    stack["features"] = torch.eye(4)
    weights = splat(**stack, **view).features[2, 2]
    # 0.999, then 0.999 * 0.001 would leave 1e-6 of the light: not drawn, nor anything after it.
    np.testing.assert_allclose(weights, [0.999, 0, 0, 0], atol=1e-6)


def test_moving_the_world_and_the_camera_together_changes_nothing():
    view = camera(37, 29)
    scene = gaussians_before(view, 200, 3)
    turn, shift = Rotation.from_rotvec([1.0, -2.0, 0.5]), np.array([0.3, 0.8, -0.5])
    x, y, z, w = turn.as_quat()
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])  # quaternion product from the left
    moved = dict(scene)
    moved["means"] = torch.tensor(scene["means"].numpy() @ turn.as_matrix().T + shift, dtype=torch.float32)
    moved["quaternions"] = torch.tensor(scene["quaternions"].numpy() @ left.T, dtype=torch.float32)
    R = view["R"].numpy() @ turn.as_matrix().T
    seen_from = {**view, "R": torch.from_numpy(R), "t": torch.from_numpy(view["t"].numpy() - R @ shift)}
    still, after = splat(**scene, **view), splat(**moved, **seen_from)
    # Means are rounded to float32 after the motion: 2e-7 m, 4e-6 px; a pixel may cross the 1/255 step.
    difference = (still.features - after.features).abs().amax(dim=2)
    assert difference.median() < FLOAT32_IMAGE
    assert difference.max() < 4 * MIN_ALPHA
    assert (difference > VALUE_TOLERANCE).float().mean() < 0.01


def test_image_is_linear_in_the_features():
    view = camera(20, 33)
    scene = gaussians_before(view, 150, 4)
    other = torch.randn(scene["features"].shape, generator=torch.Generator().manual_seed(1))
    images = [
        splat(**{**scene, "features": f}, **view) for f in (scene["features"], other, scene["features"] - 2 * other)
    ]
    torch.testing.assert_close(images[2].features, images[0].features - 2 * images[1].features, atol=1e-4, rtol=0)
    assert torch.equal(images[0].alpha, images[1].alpha)


@pytest.mark.parametrize("render", [splat, splat_reference])
def test_compensated_opacity_keeps_the_light_of_a_footprint(render):
    """The integral of the footprint is opacity 2 pi sqrt(det(covariance)) without dilation, whatever the dilation."""
    view = frontal_camera(81)
    scene = one_gaussian(scales=(0.16, 0.12, 0.1), opacity=0.9)  # 4 x 3 px
    expected = 0.9 * 2 * math.pi * (0.16 * 25) * (0.12 * 25)
    for dilation in (0.1, 2.0, 8.0):
        out = render(**scene, **view, dilation_px2=dilation, compensate_opacity=True)
        peak = 0.9 * math.sqrt(16 * 9 / ((16 + dilation) * (9 + dilation)))
        np.testing.assert_allclose(out.alpha[40, 40], peak, atol=FLOAT32_IMAGE)
        # The footprint ends at alpha = 1/255, where a share MIN_ALPHA / peak of its integral is left out.
        np.testing.assert_allclose(float(out.alpha.sum()), expected * (1 - MIN_ALPHA / peak), rtol=2e-3)


def test_kernels_find_the_medians_of_the_reference():
    view = camera(50, 41)
    scene = gaussians_before(view, 600, 3, seed=3, scale=0.15)
    found = compare_with_reference(**scene, **view, median_depth=True)
    assert found.value < VALUE_TOLERANCE
    assert max(found.gradients.values()) < GRADIENT_TOLERANCE, found.gradients
    assert found.undecided < 0.05


@pytest.mark.parametrize("compensate", [False, True])
@pytest.mark.parametrize(("width", "height", "channels"), [(33, 17, 1), (50, 41, 3), (16, 16, 12), (7, 70, 14)])
def test_kernels_agree_with_the_reference(width, height, channels, compensate):
    view = camera(width, height)
    scene = gaussians_before(view, 250, channels, seed=width)
    found = compare_with_reference(**scene, **view, compensate_opacity=compensate)
    assert found.finite
    assert found.value < VALUE_TOLERANCE
    assert max(found.gradients.values()) < GRADIENT_TOLERANCE, found.gradients
    assert found.undecided < 0.05


def test_saturated_pixels_agree_with_the_reference():
    """Enough opaque layers that most pixels stop early, in tiles of many Gaussians."""
    view = camera(32, 32)
    scene = gaussians_before(view, 700, 3, seed=5, scale=0.2)
    scene["opacities"] = 0.5 + 0.5 * scene["opacities"]
    found = compare_with_reference(**scene, **view)
    assert found.finite
    assert found.value < VALUE_TOLERANCE
    assert max(found.gradients.values()) < GRADIENT_TOLERANCE, found.gradients


def test_same_bits_on_every_run_and_any_number_of_threads():
    view = camera(70, 61)
    scene = gaussians_before(view, 2000, 5)
    draws = torch.Generator().manual_seed(0)
    upstream = torch.randn(61, 70, 5, generator=draws)

    def render():
        leaves = {name: a.clone().requires_grad_() for name, a in scene.items()}
        out = splat(**leaves, **view)
        torch.autograd.backward([out.features, out.depth], [upstream, upstream[..., 0]])
        return [*out, *(a.grad for a in leaves.values())]

    threads = numba.get_num_threads()
    try:
        results = []
        for count in (1, min(2, numba.config.NUMBA_NUM_THREADS), 1):
            numba.set_num_threads(count)
            results.append(render())
    finally:
        numba.set_num_threads(threads)
    for again in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], again, strict=True))


def test_culled_gaussians_leave_no_trace_and_get_no_gradient():
    view = camera(30, 30)
    scene = gaussians_before(view, 100, 2)
    culled = torch.arange(100) % 3 == 0
    scene["opacities"][culled] = 0
    leaves = {name: a.clone().requires_grad_() for name, a in scene.items()}
    out = splat(**leaves, **view)
    out.features.square().sum().backward()
    kept = splat(**{name: a[~culled] for name, a in scene.items()}, **view)
    assert torch.equal(out.features, kept.features)
    assert all(not leaf.grad[culled].any() for leaf in leaves.values())
    assert leaves["means"].grad[~culled].any()


def test_strided_and_double_inputs_are_taken_and_get_gradients_of_their_own_type():
    view = camera(20, 20)
    scene = gaussians_before(view, 50, 3)
    expected = splat(**scene, **view)
    wide = torch.cat([scene["features"], scene["features"]], 1).double().requires_grad_()
    strided = {**scene, "means": scene["means"].T.contiguous().T, "features": wide[:, :3]}
    out = splat(**strided, **view)
    assert torch.equal(out.features, expected.features)
    out.features.mean().backward()  # an expanded, not contiguous, upstream gradient
    assert wide.grad.dtype == torch.float64
    assert wide.grad[:, :3].any() and not wide.grad[:, 3:].any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"means": torch.full((5, 3), math.nan)}, "means: expected finite"),
        ({"K": torch.tensor([[50.0, 1, 8], [0, 50, 8], [0, 0, 1]])}, "skew"),
        ({"width": 0}, "width"),
        ({"dilation_px2": -1.0}, "dilation_px2"),
        ({"near_m": 0.0}, "near_m"),
    ],
)
def test_wrong_inputs_are_named(change, message):
    view = frontal_camera(16)
    with pytest.raises(ValueError, match=message):
        splat(**{**gaussians_before(view, 5, 2), **view, **change})


def test_different_lengths_are_named():
    tensors = {"means": torch.zeros(5, 3), "opacities": torch.zeros(4)}
    with pytest.raises(ValueError, match="'means': 5, 'opacities': 4"):
        check_splat_inputs(tensors, torch.eye(3), 8, 8, 0.1, 0.01)


def test_any_changed_kernel_source_changes_the_stamp_of_all_binaries(tmp_path):
    (tmp_path / "one_kernels.py").write_text("LIMIT = 1\n")
    before = sources_digest(tmp_path)
    (tmp_path / "notes.py").write_text("")
    sources_digest.cache_clear()
    assert sources_digest(tmp_path) == before
    (tmp_path / "one_kernels.py").write_text("LIMIT = 2\n")
    sources_digest.cache_clear()
    assert sources_digest(tmp_path) != before


def test_camera_stands_where_its_own_coordinates_are_zero():
    view = camera(20, 20)
    center = CameraView(view["R"], view["t"], view["K"], 20, 20).center
    np.testing.assert_allclose(view["R"] @ center + view["t"], np.zeros(3), atol=1e-15)
