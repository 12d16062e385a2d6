"""A very small capture of a translucent body: light comes out where none goes in, and nothing else differs."""

import cv2
import numpy as np
import OpenEXR
import pandas as pd
import pytest

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.stages.synthesize_capture import run

pytest.importorskip("mitsuba")

SETTINGS = SynthesizeCapture(
    cameras=2, lights=3, frames=2, frames_b=1, fully_lit_every=2, partial_lights_min=1, partial_lights_max=1,
    width=48, height=64, downsample_from_sensor=4, test_cameras=1, test_frames=0, distortion=0.0, color_spread=0.0,
    vertex_spacing_m=0.045, texture_size=64, spp=4, spp_fully_lit=4, supersampling=1, max_depth=2,
    shot_gain=0.0, read_noise=0.0, saturation=10.0,
    board_squares_x=4, board_squares_y=3, board_square_m=0.2, board_marker_m=0.15, board_poses=3,
    ball_positions=1, ball_cameras=1,
)  # fmt: skip
TRANSLUCENT = SETTINGS.model_copy(update={"material": "translucent", "spp": 16, "max_depth": 64})
CAMERAS = ("cam00", "cam01")


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    root = tmp_path_factory.mktemp("captures")
    for name, settings in (("opaque", SETTINGS), ("translucent", TRANSLUCENT)):
        run(subject="small", out=root / name, workers=1, settings=settings)
    return root / "opaque", root / "translucent"


def pictures(capture):
    """Images [camera, h, w, 3] of the frame with one lamp."""
    images = []
    for camera in CAMERAS:
        with OpenEXR.File(str(capture / f"images/{camera}/000001.exr")) as file:
            images.append(file.channels()["RGB"].pixels.astype(np.float32))
    return np.stack(images)


def masks(capture):
    """The body's pixels in the same frame [camera, h, w], 255 or 0."""
    paths = [capture / f"masks/{camera}/000001.png" for camera in CAMERAS]
    return np.stack([cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths])


def test_light_comes_out_where_none_goes_in_and_is_red(captures):
    opaque, translucent = (pictures(capture) for capture in captures)
    inside = np.stack([cv2.erode(mask, np.ones((3, 3), np.uint8)) > 0 for mask in masks(captures[0])])
    lit, unlit = inside & (opaque.min(axis=-1) > 0), inside & (opaque.max(axis=-1) == 0)
    assert lit.sum() > 30 and unlit.sum() > 30
    direct, below = translucent[lit].mean(axis=0), translucent[unlit].mean(axis=0)
    assert below[0] > 0.05 * direct[0]
    assert below[0] / below[2] > 1.2 * direct[0] / direct[2]  # red light is absorbed least, so it comes farthest


def test_everything_but_the_light_is_as_of_an_opaque_body(captures):
    opaque, translucent = captures
    np.testing.assert_array_equal(masks(opaque), masks(translucent))
    tables = [pd.read_parquet(capture / "keypoints_2d.parquet") for capture in captures]
    pd.testing.assert_frame_equal(*tables)
    for path in ("calibration", "template", "truth"):
        files = sorted(file.relative_to(opaque) for file in (opaque / path).rglob("*") if file.is_file())
        assert files and all((opaque / file).read_bytes() == (translucent / file).read_bytes() for file in files)
