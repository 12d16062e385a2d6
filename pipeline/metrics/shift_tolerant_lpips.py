"""ST-LPIPS (Ghildyal and Liu 2022, version ST0.0): LPIPS that hardly sees shifts.

The formula is that of LPIPS. Its features are those of an AlexNet of the authors' own training, which takes every
pixel and blurs before it leaves any out (Zhang 2019), so that a picture that is a pixel aside is as near as it looks.

All of its weights come with the package `stlpips-pytorch` and are read from there, so that it needs no network. The
package itself is not imported: it wants torchvision. Its numbers do not compare with those of LPIPS.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.base.errors import InputError
from pipeline.metrics.lpips import Lpips

PACKAGE, WEIGHTS = "stlpips_pytorch", "weights/vST0.0/alex_shift_tolerant.pth"
WEIGHTS_SHA256 = "b356b382f96010f77d085ee8343ecd9fd322d0a56e8de2b2d0549fafcad8b9ee"
"""Digest of the weights of stlpips-pytorch 0.0.2."""

TAPS = (2, 6, 10, 12, 14)
"""Places of the compared ReLUs in `build_shift_tolerant_features`."""


class BlurredHalving(nn.Module):
    """Every second pixel of a blurred image.

    The blur is the binomial [1 2 1] / 4 along both axes, each channel by itself. The image goes on beyond its border as
    a mirror shows it, by two pixels a side.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        row = torch.tensor([1.0, 2.0, 1.0]) / 4
        self.register_buffer("filt", (row[:, None] * row).expand(channels, 1, 3, 3).clone())

    def forward(self, images: Float[Tensor, "n c h w"]) -> Float[Tensor, "n c h2 w2"]:
        """Blur and halve."""
        return F.conv2d(F.pad(images, (2, 2, 2, 2), mode="reflect"), self.filt, stride=2, groups=images.shape[1])


def build_shift_tolerant_features() -> nn.Sequential:
    """Build the convolutional part of the shift-tolerant AlexNet, randomly initialised."""
    return nn.Sequential(
        nn.Conv2d(3, 64, 11, padding=2), BlurredHalving(64), nn.ReLU(),
        nn.MaxPool2d(3, stride=1), BlurredHalving(64), nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(),
        nn.MaxPool2d(3, stride=1), BlurredHalving(192), nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(),
        nn.Conv2d(384, 256, 3, padding=1), nn.ReLU(),
        nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(),
    )  # fmt: skip


@cache
def open_st_lpips() -> Lpips:
    """ST-LPIPS with its published weights, read once.

    Raises:
        InputError: if the package is missing, or its weights are not the published ones.
    """
    found = find_spec(PACKAGE)
    path = Path(*(found.submodule_search_locations or [""])) / WEIGHTS if found else Path(PACKAGE) / WEIGHTS
    if not path.is_file():
        raise InputError(f"{path}: expected the weights of ST-LPIPS, found no file; install stlpips-pytorch 0.0.2")
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest != WEIGHTS_SHA256:
        raise InputError(
            f"{path}: expected SHA-256 {WEIGHTS_SHA256[:16]}..., that of stlpips-pytorch 0.0.2, found {digest[:16]}..."
        )
    state = torch.load(path, map_location="cpu", weights_only=True)
    features = build_shift_tolerant_features()
    features.load_state_dict({k.split(".", 2)[2]: v for k, v in state.items() if k.startswith("net.")})
    return Lpips(TAPS, features, {f"lin{i}": state[f"lin{i}.model.1.weight"] for i in range(len(TAPS))})
