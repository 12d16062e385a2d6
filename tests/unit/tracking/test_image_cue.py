"""The image cue's gradient against differences, and what it says of a mesh that is out of place."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry.mesh import weld_vertices
from pipeline.geometry.surface_points import spread_points
from pipeline.lighting.frame_lights import FrameLights
from pipeline.tracking.color_views import ColorView
from pipeline.tracking.image_cue import ImageCue
from tests.support.figures.painted import light_positions, paint
from tests.support.figures.walking import ring_of_cameras, walk

SHIFT = np.array([0.006, -0.004, 0.005])


@pytest.fixture(scope="module")
def cue_and_motion() -> tuple:
    motion = walk(3, fps=6.0)
    albedo = np.random.default_rng(3).uniform(0.1, 0.9, (len(motion.faces), 3))
    lights = FrameLights(light_positions(), np.ones((20, 3)))
    views = []
    for camera in ring_of_cameras(6).values():
        small = camera.downsampled(4.0)
        images = [paint(small, v, motion.faces, albedo, lights.positions, 7) for v in motion.vertices]
        shape = (3, small.height, small.width)
        view = ColorView(small, np.stack(images), np.ones(shape, np.float32), np.arange(3))
        views.append(view.blurred(1.0))
    surface = spread_points(motion.vertices[0], motion.faces, 600)
    weld = weld_vertices(motion.vertices[0], motion.faces)
    return ImageCue(surface, motion.faces, weld, views, [lights] * 3, 1.0), motion


def test_gradient_is_that_of_the_cost(cue_and_motion: tuple) -> None:
    cue, motion = cue_and_motion
    term = cue.around(motion.vertices)
    at = cue.points.carried(motion.vertices) + 0.002
    direction = term(at).gradient
    direction /= np.linalg.norm(direction)
    step = 1e-5
    slope = (term(at + step * direction).cost - term(at - step * direction).cost) / (2 * step)
    # Distortion is left out of the derivative: a few percent.
    assert (term(at).gradient * direction).sum() == pytest.approx(slope, rel=0.05)


def test_one_frame_out_of_place_is_pulled_back(cue_and_motion: tuple) -> None:
    cue, motion = cue_and_motion
    moved = motion.vertices.copy()
    moved[1] += SHIFT
    quadratic = cue.around(moved)(cue.points.carried(moved))
    # A common step of frame 1 alone: normal matrix less what the shared albedo explains.
    normal = quadratic.normal[1].sum(0) - np.einsum("pak,pbk->ab", quadratic.shared[1], quadratic.shared[1])
    step = -np.linalg.solve(normal, quadratic.gradient[1].sum(0))
    assert np.linalg.norm(step + SHIFT) < 0.4 * np.linalg.norm(SHIFT)


def test_what_all_frames_share_is_free(cue_and_motion: tuple) -> None:
    cue, motion = cue_and_motion
    quadratic = cue.around(motion.vertices)(cue.points.carried(motion.vertices))
    coupled = quadratic.normal - quadratic.shared @ quadratic.shared.swapaxes(2, 3)
    values = np.linalg.eigvalsh(coupled)
    # Eliminating the albedo leaves a positive semi-definite matrix, to rounding.
    assert values.min() > -1e-9 * values.max()
