"""What captures of heads may hold at worst: eyes that turn right round, a surface that no camera sees."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.capture.index.eye_tables import OPPOSITE, between_directions
from pipeline.effects.mean_textures import SeenColors, fill_unseen
from tests.support.results.hard_case import HardCase, worst


@pytest.mark.parametrize("angle", [1e-12, 1e-5, 1.0, np.pi - 1e-5])
def test_gaze_between_directions_that_are_nearly_one_or_nearly_opposite(case: HardCase, angle: float) -> None:
    """A quarter of the way from +z towards +x. Within `OPPOSITE` of one another they are taken for one."""
    start, end = np.array([[0.0, 0, 1]]), np.array([[np.sin(angle), 0, np.cos(angle)]])
    found = between_directions(start, end, np.array([0.25]))
    expected = np.array([[np.sin(angle / 4), 0, np.cos(angle / 4)]])
    # Rounding of the directions is magnified by what their sine lacks to 1.
    case.check(worst(found, expected), OPPOSITE if angle < OPPOSITE else 1e-15 / np.sin(angle))
    if angle >= 1:
        chord = 0.75 * start + 0.25 * end
        case.naive_fails(worst(chord / np.linalg.norm(chord), expected))


def test_gaze_between_opposite_directions(case: HardCase) -> None:
    """No way is the shortest: one of the two, and never no direction at all."""
    up = np.array([[0.0, 1, 0]])
    found = np.concatenate([between_directions(up, -up, np.array([share])) for share in np.linspace(0, 1, 11)])
    case.check(worst(np.linalg.norm(found, axis=1), np.ones(11)), 1e-15)
    case.check(worst(np.abs(found[:, 1]), np.ones(11)), 1e-15)
    middle = 0.5 * up - 0.5 * up
    with np.errstate(invalid="ignore"):
        case.naive_fails(worst(np.linalg.norm(middle / np.linalg.norm(middle)), 1.0))


def test_texels_that_no_camera_sees_in_any_frame(case: HardCase) -> None:
    """They get the colour of the nearest that is seen, however far, and nothing is not a number."""
    weight = np.array([0.0, 1.0, 0.0, 0.0])
    seen = SeenColors(np.outer(weight, [0.2, 0.4, 0.6]), weight)
    places = np.array([[0.0, 0, 0], [1e-9, 0, 0], [1, 0, 0], [1e6, 0, 0]])
    found = fill_unseen([seen], places)
    case.check(worst(found, np.broadcast_to([0.2, 0.4, 0.6], (1, 4, 3))), 0)
    with np.errstate(invalid="ignore"):
        case.naive_fails(worst(seen.mean * weight[:, None] / weight[:, None], np.broadcast_to([0.2, 0.4, 0.6], (4, 3))))
    dark = SeenColors(np.zeros((4, 3)), np.zeros(4))
    case.check(worst(fill_unseen([dark], places), np.zeros((1, 4, 3))), 0)
