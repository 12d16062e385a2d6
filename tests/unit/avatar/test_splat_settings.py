"""Settings of splatting reach the pictures of an avatar."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.geometry.camera_paths import look_at
from tests.support.avatars.sheet import make_frame, make_sheet

CAMERA = look_at(np.array([0.0, 0.0, 1.2]), np.zeros(3), 34.0, 48, 48)


def coverage(**settings) -> float:
    """Sum of alpha over the picture of a sheet of faint Gaussians, each about two pixels wide."""
    sheet = make_sheet(8)
    spec = AvatarSpec(specular=False, shadow=False, shadow_width=4, supersample=1, **settings)
    avatar = Avatar(sheet, texel_spacing(sheet), spec)
    with torch.no_grad():
        avatar.opacity.fill_(-2.0)
        frame = avatar.prepare(FrameInputs(sheet, make_frame(sheet, np.array([[0, 0, 1.0]]), np.ones((1, 3)))))
        return float(avatar.view(frame, camera_view(CAMERA)).alpha.sum())


@pytest.mark.parametrize(("compensate", "grows_by"), [(False, (1.2, 1.6)), (True, (0.9, 1.03))])
def test_compensated_opacity_keeps_coverage_whatever_the_dilation(compensate, grows_by):
    """Faint ones hardly hide each other, so that what they cover adds up."""
    little, much = (coverage(dilation_px2=px2, compensate_opacity=compensate) for px2 in (0.1, 2.0))
    assert grows_by[0] < much / little < grows_by[1]
