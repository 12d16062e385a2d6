"""Frames of a video as images of a capture: each the right one, decoded once, also by threads that share it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.capture import video_frames
from pipeline.capture.archives import holder_of, is_there, read_bytes
from pipeline.capture.images import read_image, read_mask
from pipeline.capture.paths import locate
from pipeline.capture.video_frames import read_video_frame, video_facts
from tests.support.datasets.decodes import counted_decodes

FRAMES = 24
CODEC_LOSS = 8
"""Of 255, on flat colours."""


def level(frame):
    """Grey value that tells a frame from its neighbours."""
    return 10 + 9 * ((7 * frame) % FRAMES)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("videos")
    writer = cv2.VideoWriter(str(folder / "cam.mp4"), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"vp09"), 24, (32, 16))
    for frame in range(FRAMES):
        writer.write(np.full((16, 32, 3), level(frame), np.uint8))
    writer.release()
    return folder


@pytest.fixture
def decoded():
    """Frames that codecs decode meanwhile."""
    video_frames._shared.cache_clear()
    with counted_decodes() as found:
        yield found.video_frames
    video_frames._shared.cache_clear()


def test_header_counts_frames_and_says_size_and_rate(folder):
    assert video_facts(folder / "cam.mp4") == video_frames.VideoFacts(FRAMES, 32, 16, 24.0)
    (folder / "none.mp4").write_bytes(b"no video")
    with pytest.raises(InputError, match="expected a video"):
        video_facts(folder / "none.mp4")


def test_each_frame_is_the_one_that_was_asked_for_in_any_order(folder):
    for frame in [5, 6, 2, 23, 3, 4, 0, 9]:
        picture = read_video_frame(folder / "cam.mp4", frame)
        np.testing.assert_allclose(picture, level(frame), atol=CODEC_LOSS)
    with pytest.raises(InputError, match="expected a frame 24, found none"):
        read_video_frame(folder / "cam.mp4", FRAMES)


def test_frames_in_order_are_decoded_once_by_threads_that_share_a_video(folder, decoded):
    with ThreadPoolExecutor(4) as pool:
        pictures = list(pool.map(lambda frame: read_video_frame(folder / "cam.mp4", frame), range(FRAMES)))
    assert len(decoded) == FRAMES
    for frame, picture in enumerate(pictures):
        np.testing.assert_allclose(picture, level(frame), atol=CODEC_LOSS)


def test_a_frame_is_an_image_of_a_capture_and_its_first_channel_a_mask(folder):
    assert holder_of(folder / "cam.mp4/000012") == folder / "cam.mp4"
    assert is_there(folder / "cam.mp4/000023") and not is_there(folder / "cam.mp4/000024")
    assert not is_there(folder / "cam.mp4/twelve") and locate(folder, "cam.mp4/000012").name == "000012"
    image, mask = read_image(folder / "cam.mp4/000012"), read_mask(folder / "cam.mp4/000012.red")
    np.testing.assert_allclose(255 * image, level(12), atol=CODEC_LOSS)
    np.testing.assert_array_equal(mask, np.round(255 * image[..., 0]))
    with pytest.raises(InputError, match="found none of that name"):
        read_bytes(folder / "cam.mp4/twelve")
