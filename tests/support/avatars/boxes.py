"""Scenes of volumetric primitives, and what rays through them come to by three ways."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.volume_march import march
from pipeline.rendering.volume_reference import march_reference
from pipeline.rendering.volume_types import PLAIN, Volumes

TINTED = (0, 1, 2, PLAIN)
"""A colour and a channel that is none."""

STEP_M = 0.02


class Scene(NamedTuple):
    """Boxes with features of columns, in float64."""

    volumes: Volumes
    features: torch.Tensor
    tinted: tuple[int, ...] = TINTED

    def to(self, kind):
        """The same numbers in another type."""
        return Scene(self.volumes.map(lambda a: a.to(kind)), self.features.to(kind), self.tinted)


def camera(width=20, height=17, focal=30.0, t=(0.0, 0.0, 0.0)):
    """A camera that looks along z."""
    K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64)
    return CameraView(torch.eye(3, dtype=torch.float64), torch.tensor(t, dtype=torch.float64), K, width, height)


def boxes(count=5, density=3.0, half_size=0.2, depth=1.5, spread=0.25, grid=(3, 4, 5), seed=0):
    """Boxes that are turned at random and overlap, full of random voxels."""
    draws = np.random.default_rng(seed)
    centers = draws.normal(size=(count, 3)) * spread + (0, 0, depth)
    turns = Rotation.random(count, random_state=seed).as_matrix() if count else np.zeros((0, 3, 3))
    sizes = half_size * draws.uniform(0.7, 1.3, (count, 3))
    voxels, tint = density * draws.uniform(0.2, 1, (count, *grid)), draws.uniform(0.5, 1.5, (count, *grid, 3))
    parts = (centers, turns, sizes, voxels, tint)
    features = draws.uniform(0, 1, (count, *grid[1:], len(TINTED)))
    return Scene(Volumes(*(torch.as_tensor(part) for part in parts)), torch.as_tensor(features))


def one_box(density=1.0, color=(0.2, 0.4, 0.8, 0.5), half_size=(0.2, 0.2, 0.2), center=(0.0, 0.0, 1.5), grid=(2, 2, 2)):
    """A box along the axes of the world, of one density and colour."""
    like = {"dtype": torch.float64}
    volumes = Volumes(
        torch.tensor([center], **like), torch.eye(3, **like)[None], torch.tensor([half_size], **like),
        torch.full((1, *grid), density, **like), torch.ones(1, *grid, 3, **like),
    )  # fmt: skip
    return Scene(volumes, torch.tensor(color, **like).expand(1, *grid[1:], -1).clone())


class Compared(NamedTuple):
    """Largest difference of pictures; of gradients, relative to the norm of each; whether all numbers are finite."""

    value: float
    gradients: dict[str, float]
    finite: bool


def drawn(function, scene, view, step_m=STEP_M, seed=0):
    """A picture, and the gradients of its sum with random weights."""
    draws = torch.Generator().manual_seed(seed)
    leaves = [a.clone().requires_grad_() for a in (*scene.volumes.named().values(), scene.features)]
    found = function(Volumes(*leaves[:-1]), leaves[-1], scene.tinted, view, step_m)
    images = torch.cat([found.features, found.alpha[..., None], found.depth[..., None]], -1)
    weights = torch.randn(images.shape, generator=draws, dtype=torch.float64).to(images.dtype)
    if images.requires_grad:
        (images * weights).sum().backward()
    gradients = [torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in leaves]
    names = (*scene.volumes.named(), "features")
    return images.detach().double(), dict(zip(names, (g.double() for g in gradients), strict=True))


_twins: dict[tuple, tuple[torch.Tensor, dict[str, torch.Tensor]]] = {}


def _twin(scene, view, step_m):
    """The same by the twin, kept for the other ways that are compared with it."""
    parts = [*scene.volumes.named().values(), scene.features, view.R, view.t, view.K]
    key = (scene.tinted, view.width, view.height, step_m, *((tuple(a.shape), a.numpy().tobytes()) for a in parts))
    if key not in _twins:
        _twins[key] = drawn(march_reference, scene, view, step_m)
    return _twins[key]


def compare(scene, view=None, step_m=STEP_M, function=march, kind=torch.float32):
    """`function` in the type `kind` against the twin in float64."""
    view = view or camera()
    rounded = scene.to(kind)
    image, gradients = drawn(function, rounded, view.to(kind), step_m)
    expected, slow = _twin(rounded.to(torch.float64), view.to(kind).to(torch.float64), step_m)
    norms = {name: float(slow[name].norm()) or 1.0 for name in slow}
    errors = {name: float((gradients[name] - slow[name]).norm()) / norms[name] for name in slow}
    finite = all(bool(torch.isfinite(a).all()) for a in (image, *gradients.values()))
    return Compared(float((image - expected).abs().max()) if image.numel() else 0.0, errors, finite)
