"""LPIPS (Zhang et al. 2018, version 0.1): distance of deep features with learned weights.

    d(x, y) = sum_l mean_{h,w} sum_c w_lc (f_lc(x) - f_lc(y))^2,    f_l = features of layer l / their norm over channels

The linear weights w are in `weights/` (see its LICENSE). The backbone's ImageNet weights are not: they are read from a
file of the user or from torch's hub cache, to which they are fetched if that is asked for, and only if their hash is
the published one. There is no substitute: without them there is no LPIPS.
"""

from __future__ import annotations

import hashlib
import logging
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from safetensors.torch import load_file
from torch import Tensor, nn

from pipeline.base.errors import InputError

log = logging.getLogger("lpips")

DOWNLOAD = "download"
"""Word in place of a backbone's file: fetch it."""

PUBLISHED_AT = "https://download.pytorch.org/models"
PATIENCE_S = 30.0
"""Seconds without an answer after which nothing is fetched."""

NORM_EPSILON = 1e-10
"""Added to the norm of a feature vector, as published: dead pixels (all features zero) stay zero, not NaN."""

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
"""ImageNet mean and deviation moved to inputs in [-1, 1]: the published scaling layer."""


@dataclass(frozen=True)
class Backbone:
    """Published backbone: its layers, the ReLUs that are compared, and its weights file.

    Attributes:
        layers: (outputs, kernel, stride, padding) of a convolution + ReLU, or (kernel, stride) of a max-pooling.
        taps: positions of the compared ReLUs in torchvision's `features`.
        file_name, sha256_prefix: torchvision's weights file; the name carries the start of its SHA-256.
    """

    layers: tuple[tuple[int, ...], ...]
    taps: tuple[int, ...]
    file_name: str
    sha256_prefix: str


def _vgg_block(outputs: int, convolutions: int) -> tuple[tuple[int, ...], ...]:
    return ((outputs, 3, 1, 1),) * convolutions + ((2, 2),)


BACKBONES = {
    "alex": Backbone(
        ((64, 11, 4, 2), (3, 2), (192, 5, 1, 2), (3, 2), (384, 3, 1, 1), (256, 3, 1, 1), (256, 3, 1, 1)),
        (1, 4, 7, 9, 11),
        "alexnet-owt-7be5be79.pth",
        "7be5be79",
    ),
    "vgg": Backbone(
        (_vgg_block(64, 2) + _vgg_block(128, 2) + _vgg_block(256, 3) + _vgg_block(512, 3) + _vgg_block(512, 3))[:-1],
        (3, 8, 15, 22, 29),
        "vgg16-397923af.pth",
        "397923af",
    ),
}


def build_features(net: str) -> nn.Sequential:
    """Build the convolutional part of a backbone, randomly initialised.

    Positions are those of torchvision's `features`.
    """
    modules: list[nn.Module] = []
    inputs = 3
    for layer in BACKBONES[net].layers:
        if len(layer) == 2:
            modules.append(nn.MaxPool2d(layer[0], layer[1]))
        else:
            outputs, kernel, stride, padding = layer
            modules += [nn.Conv2d(inputs, outputs, kernel, stride, padding), nn.ReLU()]
            inputs = outputs
    return nn.Sequential(*modules)


class Lpips(nn.Module):
    """LPIPS between sRGB images in [0, 1].

    Scaling to [-1, 1] happens inside, so nobody can forget it.

    Differentiable in its inputs; its own parameters are frozen.

    Args:
        taps: positions of the layers that are compared.
        features: convolutional part of the backbone.
        linear: w of each compared layer, by name: lin0, lin1, ...
    """

    def __init__(self, taps: Sequence[int], features: nn.Sequential, linear: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.taps = tuple(taps)
        self.features = features
        self.register_buffer("shift", torch.tensor(SHIFT)[:, None, None])
        self.register_buffer("scale", torch.tensor(SCALE)[:, None, None])
        for i in range(len(self.taps)):
            self.register_buffer(f"lin{i}", linear[f"lin{i}"].reshape(-1, 1, 1).clone())
        self.eval().requires_grad_(False)

    def forward(self, x: Float[Tensor, "n 3 h w"], y: Float[Tensor, "n 3 h w"]) -> Float[Tensor, " n"]:
        """Distance per image pair; 0 for equal images. Sides must be at least `LPIPS_SMALLEST_SIDE`."""
        distance = x.new_zeros(len(x))
        for i, (fx, fy) in enumerate(zip(self._activations(x), self._activations(y), strict=True)):
            distance = distance + (getattr(self, f"lin{i}") * (fx - fy) ** 2).sum(1).mean((1, 2))
        return distance

    def _activations(self, srgb: Tensor) -> list[Tensor]:
        h, found = (2 * srgb - 1 - self.shift) / self.scale, []
        for position, layer in enumerate(self.features):
            h = layer(h)
            if position in self.taps:
                # The square root has infinite slope at 0; the tiny constant under it keeps gradients of dead pixels 0.
                norm = (h.square().sum(1, keepdim=True) + torch.finfo(h.dtype).tiny).sqrt()
                found.append(h / (norm + NORM_EPSILON))
        return found


def open_lpips(net: str, backbone: str = "") -> tuple[Lpips | None, str]:
    """Load LPIPS with its published weights; return it with a text that says which.

    It is (None, why not) if the backbone's file is absent.

    Args:
        net: "alex" or "vgg".
        backbone: weights file of the backbone; if empty, torch's hub cache is looked at; if `DOWNLOAD`, they are
            fetched to it if they are not there.

    Raises:
        InputError: if `backbone` is named and missing, or if a file's hash is not the published one.
    """
    expected = BACKBONES[net]
    named = backbone not in ("", DOWNLOAD)
    path = Path(backbone) if named else Path(torch.hub.get_dir()) / "checkpoints" / expected.file_name
    if not path.is_file() and backbone == DOWNLOAD and (why := fetch(expected, path)):
        return None, f"none: {why}"
    if not path.is_file():
        if named:
            raise InputError(f"{path}: expected the LPIPS backbone {expected.file_name}, found no file")
        return None, f"none: {expected.file_name} is neither configured (lpips_backbone) nor in torch's hub cache"
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if not digest.startswith(expected.sha256_prefix):
        raise InputError(
            f"{path}: expected SHA-256 {expected.sha256_prefix}..., found {digest[:16]}...; "
            f"this is not torchvision's {expected.file_name}"
        )
    features = build_features(net)
    state = torch.load(path, map_location="cpu", weights_only=True)
    features.load_state_dict({k.removeprefix("features."): v for k, v in state.items() if k.startswith("features.")})
    return Lpips(
        expected.taps, features, linear_weights(net)
    ), f"{expected.file_name} sha256 {digest[:16]}, linear v0.1"


def fetch(backbone: Backbone, path: Path) -> str:
    """Fetch the weights of a backbone from where torchvision has them. Returns why not, if they do not come."""
    path.parent.mkdir(parents=True, exist_ok=True)
    url, before = f"{PUBLISHED_AT}/{backbone.file_name}", socket.getdefaulttimeout()
    log.info("fetching %s", url)
    socket.setdefaulttimeout(PATIENCE_S)
    try:
        torch.hub.download_url_to_file(url, str(path), backbone.sha256_prefix, progress=False)
    except (OSError, RuntimeError) as error:
        return f"{url} could not be fetched: {error}"
    finally:
        socket.setdefaulttimeout(before)
    return ""


def linear_weights(net: str) -> dict[str, Tensor]:
    """The published linear weights, one vector per compared layer."""
    return load_file(Path(__file__).with_name("weights") / f"lpips_linear_{net}.safetensors")
