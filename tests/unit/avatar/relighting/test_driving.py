"""What drives a head: a code, tracked vertices, or the expressions of other frames; held still or moved."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.relighting.driving_signal import AT_REST, DrivingSignal, from_code, from_record
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.base.errors import InputError
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.cameras import Camera
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from tests.support.avatars.heads import folds, make_head, trained
from tests.support.avatars.sheet import make_sheet

LAMP = FrameLights(np.array([[0.4, 0.2, 1.5]]), np.full((1, 3), 4.0))
FLOAT32_ROUNDING = 1e-5


@pytest.fixture(scope="module")
def head():
    """Atlas, frames and a relighter of an avatar that was trained on them."""
    atlas = make_sheet(8)
    frames = folds(atlas)
    return atlas, frames, Relighter(LoadedAvatar(trained(atlas, frames, steps=12), atlas), TraceIrradiance(samples="1"))


def means(relighter, driver):
    return relighter.under_lights(driver, LAMP).gaussians.means


def test_a_frames_own_code_drives_as_the_frame_does(head):
    atlas, frames, relighter = head
    record = frames[2]
    code = relighter.avatar.networks.encode(FrameInputs(atlas, record)).mean.detach().numpy()
    by_record, by_code = (
        relighter.under_lights(driver, LAMP)
        for driver in (from_record(record), from_code(relighter.avatar, code, record.head_from_world))
    )
    for of in (
        lambda frame: frame.gaussians.means, lambda frame: frame.gaussians.scales,
        lambda frame: frame.parameters.transfer_color,
    ):  # fmt: skip
        assert (of(by_record) - of(by_code)).abs().max() < FLOAT32_ROUNDING


def test_codes_between_two_frames_give_shapes_between_them(head):
    atlas, frames, relighter = head
    first, last = (relighter.avatar.networks.encode(FrameInputs(atlas, f)).mean.detach().numpy() for f in frames[::2])
    heights = [from_code(relighter.avatar, (1 - s) * first + s * last).vertices[1, 2] for s in (0, 0.25, 0.5, 1)]
    assert heights == sorted(heights)
    assert heights[-1] - heights[0] > 0.05  # of the 0.1 m that was filmed


def test_tracked_vertices_alone_drive_it_wherever_the_head_is(head):
    _, frames, relighter = head
    turn, shift = Rotation.from_euler("xyz", [0.2, -0.5, 0.1]), np.array([0.1, 0.0, -0.2])
    there = turn.apply(frames[0].vertices) + shift
    here = means(relighter, frames[0].vertices).numpy()
    assert np.abs(means(relighter, there).numpy() - (turn.apply(here) + shift)).max() < 1e-4


def test_expressions_of_another_segment_on_a_head_that_is_held_still(head):
    _, frames, relighter = head
    turn = Rotation.from_euler("y", 0.4).as_matrix()
    motion = np.concatenate([turn.T, np.array([[0.1], [0.2], [0.3]])], 1).astype(np.float32)
    performed = dataclasses.replace(
        frames[2],
        vertices=((frames[2].vertices - motion[:, 3]) @ motion[:, :3]).astype(np.float32),
        head_from_world=motion,
        segment="b",
    )
    still = from_record(performed, AT_REST)
    assert np.abs(still.vertices - frames[2].vertices).max() < 1e-6
    assert (means(relighter, still) - means(relighter, from_record(frames[2]))).abs().max() < FLOAT32_ROUNDING
    assert (means(relighter, still) - means(relighter, from_record(frames[0], AT_REST))).abs().max() > 0.01


def test_what_cannot_be_driven_is_told(head):
    atlas, frames, relighter = head
    with pytest.raises(InputError, match=r"expected a code of 4 numbers, found 3 numbers"):
        from_code(relighter.avatar, np.zeros(3))
    with pytest.raises(InputError, match="expected the avatar of a head"):
        from_code(make_head(atlas, avatar="body"), np.zeros(4))
    with pytest.raises(InputError, match="only heads move as a whole"):
        from_record(dataclasses.replace(frames[0], head_from_world=None), AT_REST)


def test_a_driven_head_is_seen_under_lamps_and_a_sky(head):
    _, frames, relighter = head
    R = np.diag([1.0, -1.0, -1.0])
    K = np.array([[40.0, 0, 12], [0, 40.0, 12], [0, 0, 1]])
    camera = Camera(R, -R @ np.array([0.0, 0.0, 1.0]), K, np.zeros(5), 24, 24)
    driver = dataclasses.replace(from_record(frames[1]), code=np.full(4, 0.5, np.float32))
    assert isinstance(driver, DrivingSignal)
    sky = Environment(np.full((2, 4, 3), 0.5, np.float32))
    for lit in (relighter.under_lights(driver, LAMP), relighter.under_pixels(driver, sky, np.eye(3))):
        rgb, alpha = relighter.view(lit, camera)
        assert torch.isfinite(rgb).all() and alpha.max() > 0.9 and rgb.max() > 0.05
