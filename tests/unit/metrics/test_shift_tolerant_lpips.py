"""ST-LPIPS against the authors' own code, which is imported with stand-ins for what it wants and does not use."""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.metrics import shift_tolerant_lpips
from pipeline.metrics.images import LPIPS_SMALLEST_SIDE
from pipeline.metrics.shift_tolerant_lpips import open_st_lpips

WANTED = ("torchvision", "torchvision.models", "torchsummary", "IPython")
"""Modules that the package imports and that its metric does not use."""


@pytest.fixture
def authors_metric(monkeypatch):
    """The metric as the package builds it."""
    for name in WANTED:
        stand_in = ModuleType(name)
        stand_in.__dict__.update(models=ModuleType("models"), summary=None, embed=None)
        monkeypatch.setitem(sys.modules, name, stand_in)
    before = set(sys.modules)
    metric = importlib.import_module("stlpips_pytorch.stlpips").LPIPS(
        net="alex", variant="shift_tolerant", verbose=False
    )
    yield metric
    for name in set(sys.modules) - before:
        sys.modules.pop(name)


def pictures(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """A slope and its negative, both with noise."""
    noise = np.random.default_rng(0).random((2, 1, 3, height, width)) / 2
    slope = np.linspace(0, 0.5, width)
    return torch.tensor(slope + noise[0]).float(), torch.tensor(0.5 - slope + noise[1]).float()


def test_it_is_the_authors(authors_metric):
    for size in ((64, 75), (LPIPS_SMALLEST_SIDE, LPIPS_SMALLEST_SIDE)):
        x, y = pictures(*size)
        with torch.no_grad():
            expected = authors_metric(x, y, normalize=True).item()
        # Sums of some thousand terms in float32, in another order.
        assert open_st_lpips()(x, y).item() == pytest.approx(expected, rel=1e-4) and expected > 0.05


def test_equal_pictures_have_no_distance_and_a_finite_slope():
    black = torch.zeros(1, 3, 40, 40, requires_grad=True)
    distance = open_st_lpips()(black, torch.zeros(1, 3, 40, 40)).sum()
    distance.backward()
    assert distance == 0 and torch.isfinite(black.grad).all()


def test_other_weights_are_refused(monkeypatch):
    monkeypatch.setattr(shift_tolerant_lpips, "WEIGHTS_SHA256", "0" * 64)
    with pytest.raises(InputError, match=r"expected SHA-256 0{16}\.\.\., that of stlpips-pytorch 0\.0\.2"):
        open_st_lpips.__wrapped__()
    monkeypatch.setattr(shift_tolerant_lpips, "PACKAGE", "no_such_package")
    with pytest.raises(InputError, match="expected the weights of ST-LPIPS, found no file"):
        open_st_lpips.__wrapped__()
