"""LPIPS against a second implementation of its formula, in NumPy; and its weights' files."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from pipeline.base.errors import InputError
from pipeline.metrics import lpips as lpips_module
from pipeline.metrics.images import LPIPS_SMALLEST_SIDE
from pipeline.metrics.lpips import BACKBONES, DOWNLOAD, Lpips, build_features, linear_weights, open_lpips

# torchvision's published layouts: positions and shapes of the convolutions in `features`.
ALEX_SHAPES = {
    0: (64, 3, 11, 11),
    3: (192, 64, 5, 5),
    6: (384, 192, 3, 3),
    8: (256, 384, 3, 3),
    10: (256, 256, 3, 3),
}
VGG_WIDTHS = dict.fromkeys((0, 2), 64) | dict.fromkeys((5, 7), 128) | dict.fromkeys((10, 12, 14), 256)
VGG_WIDTHS |= dict.fromkeys((17, 19, 21, 24, 26, 28), 512)


def random_lpips(net: str) -> Lpips:
    torch.manual_seed(0)
    return Lpips(BACKBONES[net].taps, build_features(net), linear_weights(net))


def image_pair(side: int = 64) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return torch.rand(2, 3, side, side, generator=generator), torch.rand(2, 3, side, side, generator=generator)


def independent_lpips(net: str, features: nn.Sequential, x: np.ndarray, y: np.ndarray) -> float:
    """The published formula for one pair, with the authors' preprocessing: (v - mean) / std of [-1, 1]."""
    total, mean, deviation = 0.0, (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
    weights = linear_weights(net)
    last_relu = {"alex": [1, 4, 7, 9, 11], "vgg": [3, 8, 15, 22, 29]}[net]
    for layer, stop in enumerate(last_relu):
        unit = []
        for image in (x, y):
            scaled = image * 2 - 1
            scaled = np.stack([(scaled[c] - mean[c]) / deviation[c] for c in range(3)])
            with torch.no_grad():
                f = features[: stop + 1](torch.tensor(scaled)[None].float())[0].double().numpy()
            unit.append(f / (np.sqrt((f**2).sum(0)) + 1e-10))
        w = weights[f"lin{layer}"].double().numpy()
        total += float(np.tensordot(w, (unit[0] - unit[1]) ** 2, axes=(0, 0)).mean())
    return total


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_against_a_second_implementation(net):
    lpips = random_lpips(net)
    x, y = image_pair()
    found = lpips(x, y)
    expected = [independent_lpips(net, lpips.features, a.numpy(), b.numpy()) for a, b in zip(x, y, strict=True)]
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-4)  # float32 features of about a thousand terms each
    assert (found > 0).all()


def test_zero_symmetric_and_differentiable():
    lpips = random_lpips("alex")
    x, y = image_pair()
    assert (lpips(x, x) == 0).all()
    torch.testing.assert_close(lpips(x, y), lpips(y, x))
    black = torch.zeros(1, 3, 64, 64, requires_grad=True)
    lpips(black, y[:1]).sum().backward()
    assert torch.isfinite(black.grad).all()
    assert black.grad.abs().sum() > 0
    assert not any(p.requires_grad for p in lpips.parameters())


def test_the_smallest_side_is_enough():
    x, y = image_pair(LPIPS_SMALLEST_SIDE)
    assert torch.isfinite(random_lpips("alex")(x, y)).all()


def test_layouts_are_torchvisions():
    alex = {k: tuple(v.shape) for k, v in build_features("alex").state_dict().items() if k.endswith("weight")}
    assert alex == {f"{i}.weight": shape for i, shape in ALEX_SHAPES.items()}
    vgg = {k: v.shape[0] for k, v in build_features("vgg").state_dict().items() if k.endswith("weight")}
    assert vgg == {f"{i}.weight": width for i, width in VGG_WIDTHS.items()}
    for net, taps in (("alex", 12), ("vgg", 30)):
        features = build_features(net)
        assert all(isinstance(features[t], nn.ReLU) for t in BACKBONES[net].taps)
        assert len(features) == taps


LINEAR_SHA256 = {
    "alex": "c66ca9e1e9f2e55c4a95545c98e1ab4a16bd950cc577d25347a508c2a6648825",
    "vgg": "f59790242c340514f08cadf7d6533cbe5a1db0477350496bb4c6f3671d85f13e",
}
"""Of what was converted from version 0.1 of the authors' package, see weights/LICENSE."""


def test_linear_weights_are_the_published_ones():
    """To the byte: non-negative by construction of the metric, one per channel of the compared layers."""
    folder = Path(lpips_module.__file__).with_name("weights")
    for net, digest in LINEAR_SHA256.items():
        assert hashlib.sha256((folder / f"lpips_linear_{net}.safetensors").read_bytes()).hexdigest() == digest
    assert [len(w) for _, w in sorted(linear_weights("alex").items())] == [64, 192, 384, 256, 256]
    assert [len(w) for _, w in sorted(linear_weights("vgg").items())] == [64, 128, 256, 512, 512]
    assert all((w >= 0).all() for net in ("alex", "vgg") for w in linear_weights(net).values())


def save_backbone(path, net: str) -> str:
    torch.manual_seed(3)
    state = {f"features.{k}": v for k, v in build_features(net).state_dict().items()}
    torch.save({**state, "classifier.1.weight": torch.zeros(2, 2)}, path)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_file_with_the_published_hash_is_loaded(tmp_path, monkeypatch):
    path = tmp_path / "backbone.pth"
    digest = save_backbone(path, "alex")
    monkeypatch.setitem(BACKBONES, "alex", dataclasses.replace(BACKBONES["alex"], sha256_prefix=digest[:8]))
    lpips, text = open_lpips("alex", str(path))
    assert digest[:16] in text
    torch.manual_seed(3)
    expected = build_features("alex").state_dict()
    assert all(torch.equal(v, expected[k]) for k, v in lpips.features.state_dict().items())


def test_a_file_with_another_hash_is_refused(tmp_path, monkeypatch):
    path = tmp_path / BACKBONES["alex"].file_name
    save_backbone(path, "alex")
    with pytest.raises(InputError, match="7be5be79"):
        open_lpips("alex", str(path))
    (tmp_path / "checkpoints").mkdir()
    path.rename(tmp_path / "checkpoints" / path.name)
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    with pytest.raises(InputError, match="7be5be79"):
        open_lpips("alex")


def test_without_weights_there_is_no_lpips_and_a_reason(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    lpips, why = open_lpips("vgg")
    assert lpips is None
    assert "vgg16-397923af.pth" in why
    with pytest.raises(InputError, match="no file"):
        open_lpips("vgg", str(tmp_path / "absent.pth"))


def test_a_backbone_is_fetched_if_that_is_asked_for_and_its_hash_is_right(tmp_path, monkeypatch):
    (tmp_path / "published").mkdir()
    backbone = BACKBONES["alex"]
    digest = save_backbone(tmp_path / "published" / backbone.file_name, "alex")
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "hub"))
    monkeypatch.setattr(lpips_module, "PUBLISHED_AT", (tmp_path / "published").as_uri())
    lpips, why = open_lpips("alex", DOWNLOAD)
    assert lpips is None and "alexnet-owt-7be5be79.pth could not be fetched: invalid hash value" in why
    monkeypatch.setitem(BACKBONES, "alex", dataclasses.replace(backbone, sha256_prefix=digest[:8]))
    assert open_lpips("alex")[0] is None
    assert digest[:16] in open_lpips("alex", DOWNLOAD)[1] and open_lpips("alex")[0] is not None
    assert open_lpips("vgg", DOWNLOAD)[0] is None
