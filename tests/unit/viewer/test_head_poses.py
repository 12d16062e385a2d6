"""Poses of a head's sliders: where on the latent code's axes, and which way the eyes look."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.viewer.head_poses import FARTHEST_CODE, GAZE_DEGREES, head_sliders
from tests.support.avatars.eyeballs import AHEAD, eye_atlas, make_avatar
from tests.support.viewer.eyes_head import EYES, eyes_head, head_frames


@pytest.fixture(scope="module")
def loaded():
    return LoadedAvatar(eyes_head(head_frames()), eye_atlas())


def test_expressions_lie_on_the_axes_in_which_codes_differ(loaded):
    frames = head_frames()
    sliders = head_sliders(loaded, frames, axes=2, steps=5)
    assert [slider.name for slider in sliders[:2]] == ["Expression 1", "Expression 2"]
    with torch.no_grad():
        codes = np.stack([loaded.avatar.networks.encode(FrameInputs(eye_atlas(), one)).mean.numpy() for one in frames])
    variances = np.linalg.eigvalsh(np.cov(codes.T))[::-1]
    for slider, variance in zip(sliders, variances, strict=False):
        shown = np.stack([pose.code for pose in slider.poses]).astype(np.float64)
        np.testing.assert_allclose(shown[2], codes.mean(0), atol=1e-6)
        np.testing.assert_allclose(shown + shown[::-1], 2 * np.tile(shown[2], (5, 1)), atol=1e-6)
        np.testing.assert_allclose(
            np.linalg.norm(shown[4] - shown[2]), FARTHEST_CODE * np.sqrt(variance), rtol=1e-3, atol=1e-6
        )
        decoded = loaded.avatar.networks.expression.vertices(torch.tensor(slider.poses[4].code)).detach().numpy()
        np.testing.assert_allclose(slider.poses[4].record.vertices, decoded, atol=1e-6)
    assert [pose.label for pose in sliders[0].poses][1:3] == ["expression 1, -1.0 standard deviations", "at rest"]


def test_gaze_turns_both_eyes_by_the_same_angles(loaded):
    across, up = head_sliders(loaded, head_frames(), axes=0, steps=3)
    for slider, (axis, degrees) in zip((across, up), GAZE_DEGREES.values(), strict=True):
        first, middle, last = (pose.record.gaze for pose in slider.poses)
        np.testing.assert_allclose(middle, [AHEAD, AHEAD], atol=1e-6)
        assert (slider.farthest, slider.unit) == (degrees, "degrees")
        for looks in (first, last):
            np.testing.assert_allclose(np.degrees(np.arccos(looks @ AHEAD)), degrees, atol=1e-3)
        assert (first[:, 0] < 0).all() == (axis == "Y") and (last[:, 1] < 0).all() == (axis == "X")


def test_middle_is_one_pose_of_all_sliders(loaded):
    sliders = head_sliders(loaded, head_frames(), axes=1, steps=3)
    assert len({id(slider.poses[1]) for slider in sliders}) == 1
    assert head_sliders(loaded, head_frames(), axes=1, steps=1) == []


def test_a_body_has_no_sliders():
    body = LoadedAvatar(make_avatar(eye_atlas(), EYES, shading="microfacet", visibility="traced"), eye_atlas())
    assert head_sliders(body, head_frames(), axes=2, steps=5) == []
