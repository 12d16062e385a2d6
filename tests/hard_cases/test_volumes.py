"""Boxes that break ray marchers: value and gradient finite, and right against the float64 twin."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch

from pipeline.rendering.volume_march import march
from pipeline.rendering.volume_torch import march_torch
from pipeline.rendering.volume_types import Volumes
from tests.support.avatars.boxes import Scene, boxes, camera, compare, one_box
from tests.support.avatars.naive_marcher import naive_march
from tests.support.results.hard_case import HardCase

VALUE_TOLERANCE = 1e-5
GRADIENT_TOLERANCE = 1e-5
"""Absolute, and relative to the norm of each gradient. float32 gives 2e-6 and less; a sample that is taken to lie on
the other side of a box's face is off by 3e-4 of its alpha."""

WIDTH, HEIGHT = 21, 17
"""Odd: the middle pixel's ray runs along the axis of the camera."""


def with_half_sizes(*sizes):
    scene = boxes(len(sizes))
    return scene._replace(volumes=replace(scene.volumes, half_sizes=torch.tensor(sizes, dtype=torch.float64)))


def with_density(scene, density):
    return scene._replace(volumes=replace(scene.volumes, density=torch.full_like(scene.volumes.density, density)))


def along_a_face():
    """The middle ray stays in the face x = 0.25 of a box along the axes: numbers that float32 holds."""
    return one_box(density=4.0, half_size=(0.25, 0.25, 0.5), center=(-0.25, 0.0, 1.5))


def along_an_edge():
    """The middle ray runs in two faces at once."""
    return one_box(density=4.0, half_size=(0.25, 0.25, 0.5), center=(-0.25, 0.25, 1.5))


def reaches_one_exactly():
    """Four steps in the plain middle of a box, each of a quarter."""
    scene = one_box(density=0.25, half_size=(64.0, 64.0, 64.0), center=(0.0, 0.0, 65.0))
    return scene, {"step_m": 1.0}


def behind_the_camera():
    scene = boxes(4)
    return scene._replace(volumes=replace(scene.volumes, centers=scene.volumes.centers * torch.tensor([1, 1, -1.0])))


def far_and_huge():
    scene = one_box(density=1e-3, half_size=(1e9, 1e9, 1e9), center=(0.0, 0.0, 2e9))
    far = one_box(density=1.0, half_size=(1e3, 1e3, 1e3), center=(0.0, 0.0, 1e12))
    pairs = zip(scene.volumes.named().values(), far.volumes.named().values(), strict=True)
    return Scene(Volumes(*(torch.cat(pair) for pair in pairs)), torch.cat([scene.features, far.features]))


def without_channels():
    scene = boxes()
    return Scene(scene.volumes, scene.features[..., :0], ())


CASES = {
    "ray along a face": (along_a_face(), {}),
    "ray along an edge": (along_an_edge(), {}),
    "scale zero along one axis": (with_half_sizes((0.2, 0.2, 0.0), (0.2, 0.2, 0.2)), {}),
    "scale zero": (with_half_sizes((0.0, 0.0, 0.0), (0.2, 0.2, 0.2)), {}),
    "scale zero, nothing else": (with_half_sizes((0.0, 0.0, 0.0)), {}),
    "scale 1e-12": (with_half_sizes((1e-12, 1e-12, 1e-12), (0.2, 0.2, 0.2)), {}),
    "thinner than a step": (with_half_sizes((0.2, 0.2, 1e-4), (0.2, 1e-4, 0.2), (0.2, 0.2, 0.003)), {}),
    "opaque in one step": (with_density(boxes(), 1e6), {}),
    "opaque in one step, density 1e30": (with_density(boxes(), 1e30), {}),
    "opacity of exactly one": reaches_one_exactly(),
    "no density": (with_density(boxes(), 0.0), {}),
    "density 1e-30": (with_density(boxes(), 1e-30), {}),
    "no boxes": (boxes(0), {}),
    "no channels": (without_channels(), {}),
    "camera inside a box": (boxes(6, depth=0.1, half_size=0.5), {}),
    "camera in the middle of a box": (one_box(density=0.7, center=(0.0, 0.0, 0.0)), {}),
    "camera on a face": (one_box(density=0.7, half_size=(0.25, 0.25, 0.25), center=(0.0, 0.0, 0.25)), {}),
    "behind the camera": (behind_the_camera(), {}),
    "one voxel": (boxes(3, grid=(1, 1, 1)), {}),
    "one layer": (boxes(3, grid=(1, 4, 4)), {}),
    "one column": (boxes(3, grid=(4, 1, 1)), {}),
    "step longer than all boxes": (boxes(), {"step_m": 3.0}),
    "forty at one place": (boxes(40, density=0.1, spread=0.0, grid=(2, 2, 2)), {"step_m": 0.05}),
}  # fmt: skip

NAIVE_FAILS = {
    "ray along a face", "scale zero along one axis", "scale zero", "scale zero, nothing else", "scale 1e-12",
    "thinner than a step", "opaque in one step, density 1e30", "no density", "density 1e-30",
}  # fmt: skip
"""Cases that marching as it is usually written down gets wrong, or no number for."""


@pytest.mark.parametrize("way", [march, march_torch])
@pytest.mark.parametrize("name", CASES)
def test_hard_boxes(name, way, record_property):
    scene, settings = CASES[name]
    found = compare(scene, camera(WIDTH, HEIGHT), function=way, **settings)
    case = HardCase(record_property)
    case.check(found.value, VALUE_TOLERANCE, max(found.gradients.values()), GRADIENT_TOLERANCE)
    assert found.finite
    if name == "no boxes":  # whose farthest is asked for
        with pytest.raises(RuntimeError):
            compare(scene, camera(WIDTH, HEIGHT), function=naive_march, **settings)
        case.naive_fails(math.nan)
    if name in NAIVE_FAILS:
        naive = compare(scene, camera(WIDTH, HEIGHT), function=naive_march, **settings)
        case.naive_fails(max(naive.gradients.values()) if naive.finite else math.nan, "gradient")


@pytest.mark.parametrize("way", [march, march_torch])
def test_one_pixel_image(way):
    found = compare(boxes(), camera(1, 1), function=way)
    assert found.finite
    assert found.value < VALUE_TOLERANCE


@pytest.mark.parametrize("way", [march, march_torch])
def test_boxes_beyond_the_last_step_are_not_marched_to(way):
    """Nor does a ray end before it gets to a box that a float cannot count the steps to."""
    scene, view = far_and_huge(), camera(3, 3)
    found = way(scene.volumes, scene.features, scene.tinted, view, 0.02)
    assert not found.features.any()
    assert not found.alpha.any()
