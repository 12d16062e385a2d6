"""Splatting on a GPU: what is handed to gsplat, anywhere; the pictures and gradients it gives, where there is a GPU."""

from __future__ import annotations

import importlib.util
import sys
from types import SimpleNamespace

import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.rendering.splat_conventions import MIN_ALPHA
from tests.support.avatars.splat_by_names import splat, splat_gsplat, splat_reference

VALUE_TOLERANCE = 1e-4
GRADIENT_TOLERANCE = 1e-3
"""gsplat projects in float32: rounding of 6e-8 times q <= 11 and the condition of a footprint, up to 100. Pixels on
either side of a threshold jump by MIN_ALPHA: one in a thousand may."""

has_gpu = torch.cuda.is_available() and importlib.util.find_spec("gsplat") is not None
needs_gpu = pytest.mark.skipif(not has_gpu, reason="no CUDA device, or gsplat is not installed (pip install '.[gpu]')")

CAMERA = {
    "R": torch.tensor(Rotation.from_rotvec([0.9, -0.3, 0.4]).as_matrix(), dtype=torch.float32),
    "t": torch.tensor([0.05, -0.1, 2.5]),
    "K": torch.tensor([[60.0, 0, 24], [0, 66, 17], [0, 0, 1]]),
    "width": 50,
    "height": 37,
}


def scene(count: int = 300, channels: int = 5) -> dict[str, torch.Tensor]:
    draws = torch.Generator().manual_seed(0)
    return {
        "means": torch.randn(count, 3, generator=draws) * 0.4,
        "quaternions": torch.randn(count, 4, generator=draws),
        "scales": 0.01 + 0.07 * torch.rand(count, 3, generator=draws),
        "opacities": torch.rand(count, generator=draws),
        "features": torch.randn(count, channels, generator=draws),
    }


def stand_in(seen: dict):
    """gsplat's `rasterization` as documented, by the slow reference: images [1, h, w, d + 1] with depth last."""

    def rasterization(
        means, quats, scales, opacities, colors, viewmats, Ks, width, height, near_plane, far_plane, eps2d, packed,
        render_mode, rasterize_mode,
    ):  # fmt: skip
        assert viewmats.shape == (1, 4, 4) and Ks.shape == (1, 3, 3) and render_mode == "RGB+D"
        assert viewmats[0, 3].tolist() == [0, 0, 0, 1] and not packed
        seen.update(quats=quats, far_plane=far_plane, dtypes={a.dtype for a in (means, quats, scales, colors, Ks)})
        out = splat_reference(
            means=means, quaternions=quats, scales=scales, opacities=opacities, features=colors,
            R=viewmats[0, :3, :3], t=viewmats[0, :3, 3], K=Ks[0], width=width, height=height,
            dilation_px2=eps2d, compensate_opacity=rasterize_mode == "antialiased", near_m=near_plane,
        )  # fmt: skip
        return torch.cat([out.features, out.depth[..., None]], -1)[None], out.alpha[None, ..., None], {}

    return rasterization


@pytest.mark.parametrize("compensate", [False, True])
def test_everything_is_handed_over(monkeypatch, compensate):
    seen = {}
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=stand_in(seen)))
    given = {"dilation_px2": 0.07, "compensate_opacity": compensate, "near_m": 2.2}
    found = splat_gsplat(**scene(), **CAMERA, **given, median_depth=False)
    for image, expected in zip(found, splat_reference(**scene(), **CAMERA, **given), strict=True):
        torch.testing.assert_close(image, expected)
    assert seen["far_plane"] > 1e30
    assert seen["dtypes"] == {torch.float32}


def test_what_gsplat_cannot_take_does_not_reach_it(monkeypatch):
    seen = {}
    monkeypatch.setitem(sys.modules, "gsplat", SimpleNamespace(rasterization=stand_in(seen)))
    settings = {"dilation_px2": 0.0, "compensate_opacity": False, "near_m": 0.01, "median_depth": False}
    unturned = {**scene(), "quaternions": torch.zeros(300, 4)}
    splat_gsplat(**unturned, **CAMERA, **settings)
    assert seen["quats"].tolist() == [[1, 0, 0, 0]] * 300
    seen.clear()
    nothing = splat_gsplat(**scene(0), **CAMERA, **settings)
    assert not seen
    assert [tuple(image.shape) for image in nothing] == [(37, 50, 5), (37, 50), (37, 50)]
    assert not any(image.any() for image in nothing)
    with pytest.raises(InputError, match="median"):
        splat_gsplat(**scene(), **CAMERA, **{**settings, "median_depth": True})


def test_a_gpu_without_gsplat_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(InputError, match="pip install"):
        splat_gsplat(**scene(), **CAMERA, dilation_px2=0.1, compensate_opacity=False, near_m=0.01, median_depth=False)


@needs_gpu
@pytest.mark.parametrize("settings", [{}, {"compensate_opacity": True}, {"dilation_px2": 0.3}, {"near_m": 2.4}])
@pytest.mark.parametrize("channels", [1, 12, 40])
def test_gpu_agrees_with_the_reference(settings, channels):
    """40 channels go through gsplat in two chunks."""
    draws = torch.Generator().manual_seed(2)
    upstream = [torch.randn(37, 50, *size, generator=draws, dtype=torch.float64) for size in ((channels,), (), ())]

    def render(function, device, dtype):
        leaves = {name: a.to(device, dtype).requires_grad_() for name, a in scene(channels=channels).items()}
        camera = {name: a.to(device) if torch.is_tensor(a) else a for name, a in CAMERA.items()}
        out = function(**leaves, **camera, **settings)
        torch.autograd.backward(list(out), [a.to(device, dtype) for a in upstream])
        gradients = {name: a.grad.cpu().double() for name, a in leaves.items()}
        return [image.detach().cpu().double() for image in out], gradients

    found, found_gradients = render(splat, "cuda", torch.float32)
    expected, expected_gradients = render(splat_reference, "cpu", torch.float64)
    for image, wanted in zip(found, expected, strict=True):
        difference = (image - wanted).abs().flatten()
        assert difference.quantile(0.999) < VALUE_TOLERANCE
        assert difference.max() < 10 * MIN_ALPHA  # a layer more or less, of a feature of up to 4
    for name, wanted in expected_gradients.items():
        assert (found_gradients[name] - wanted).norm() < GRADIENT_TOLERANCE * wanted.norm(), name
