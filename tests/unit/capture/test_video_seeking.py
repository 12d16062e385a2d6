"""Seeking in videos: what comes is what decoding them in order gives, and little more is decoded."""

from __future__ import annotations

import logging
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.capture import video_frames
from pipeline.capture.video_frames import AHEAD, read_video_frame
from pipeline.capture.video_seeking import CHECKED, PASSED_INSIDE, frame_times
from tests.support.datasets.decodes import counted_decodes

FRAMES, CHUNK = 110, 32
FPS, SIZE = 24.0, (32, 16)
KEY_EVERY = 12
"""Of OpenCV's writer."""

B_FRAMES = ("between.mp4", "between.mkv")
SOUGHT = ("vp9.mp4", *B_FRAMES)
IN_DOUBT = ("between.avi", "avi_inside.mp4", "varying.mp4", "varying.mkv")
"""Without times of their own, and of a rate that varies."""


def pictures():
    """What is filmed: noise that moves, with a bar."""
    noise = np.random.default_rng(3).integers(0, 90, (16, 2 * FRAMES + 32, 3)).astype(np.uint8)
    for frame in range(FRAMES):
        picture = noise[:, 2 * frame : 2 * frame + 32].copy()
        picture[:, frame % 32] += 150
        yield picture


def write(path, code):
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), FPS, SIZE)
    for picture in pictures():
        writer.write(picture)
    writer.release()


def write_varying(path, source, code):
    """The packets of a video, each shown for another time."""
    packets = cv2.VideoCapture(str(source), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    how = [cv2.VIDEOWRITER_PROP_RAW_VIDEO, 1]
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), FPS, SIZE, how)
    for shown in np.cumsum(np.random.default_rng(1).integers(1, 6, FRAMES)):
        packet = packets.read()[1]
        writer.set(cv2.VIDEOWRITER_PROP_PTS, int(shown) - 1)
        writer.set(cv2.VIDEOWRITER_PROP_KEY_FLAG, int(packets.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME)))
        writer.write(packet)
    writer.release()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("videos")
    write(folder / "vp9.mp4", "vp09")
    for name in (*B_FRAMES, "between.avi"):
        write(folder / name, "mpg2")  # OpenCV writes two B-frames between others in this codec alone.
    shutil.copy(folder / "between.avi", folder / "avi_inside.mp4")
    write_varying(folder / "varying.mp4", folder / "vp9.mp4", "vp09")
    write_varying(folder / "varying.mkv", folder / "vp9.mp4", "VP90")
    return folder


@pytest.fixture(autouse=True)
def unread():
    """No video is open."""
    video_frames._shared.cache_clear()
    yield
    video_frames._shared.cache_clear()


def in_order(path):
    """All frames, decoded in order by OpenCV."""
    video, frames = cv2.VideoCapture(str(path)), []
    while (found := video.read())[0]:
        frames.append(found[1])
    assert len(frames) == FRAMES
    return frames


def times_of(path):
    return frame_times(path, path.stat().st_mtime_ns)


def packet_times(path):
    """Times of a video's packets, in the order in which they are decoded."""
    video, times = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1]), []
    while video.grab():
        times.append(video.get(cv2.CAP_PROP_POS_MSEC))
    return np.array(times)


def assert_right(path, numbers):
    """Frames that are read are those of decoding in order."""
    truth = in_order(path)
    for number in numbers:
        np.testing.assert_array_equal(read_video_frame(path, number), truth[number], err_msg=f"{path.name} {number}")


@pytest.mark.parametrize("name", SOUGHT)
def test_chunks_start_at_a_key_frame_and_their_frames_are_right(folder, name):
    path = folder / name
    assert (np.diff(packet_times(path)) < 0).any() == (name in B_FRAMES)
    assert len(times_of(path).starts) > FRAMES // KEY_EVERY, "the first, and one of each interval"
    for first in range(0, FRAMES, CHUNK):
        video_frames._shared.cache_clear()
        chunk = range(first, min(first + CHUNK, FRAMES))
        assert_right(path, chunk)
        video_frames._shared.cache_clear()
        with counted_decodes() as decoded:
            for number in chunk:
                read_video_frame(path, number)
        assert len(decoded.video_frames) <= len(chunk) + KEY_EVERY + PASSED_INSIDE + AHEAD


@pytest.mark.parametrize("name", (*SOUGHT, *IN_DOUBT))
def test_frames_in_any_order_are_right(folder, name):
    assert_right(folder / name, np.random.default_rng(5).permutation(FRAMES)[:40].tolist())


@pytest.mark.parametrize("name", IN_DOUBT)
def test_where_times_leave_a_doubt_nothing_is_sought(folder, name):
    assert times_of(folder / name) is None
    with counted_decodes() as decoded:
        read_video_frame(folder / name, 2 * CHUNK)
    assert 2 * CHUNK < len(decoded.video_frames) <= 2 * CHUNK + 1 + CHECKED


def test_threads_that_share_a_later_chunk_decode_it_once(folder):
    path = folder / "between.mp4"
    truth, chunk = in_order(path), range(2 * CHUNK, 3 * CHUNK)
    assert times_of(path) is not None
    with counted_decodes() as decoded, ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda number: read_video_frame(path, number), chunk))
    for number, picture in zip(chunk, found, strict=True):
        np.testing.assert_array_equal(picture, truth[number])
    assert len(decoded.video_frames) <= CHUNK + KEY_EVERY + PASSED_INSIDE + AHEAD


@pytest.mark.parametrize("wrong", ["all", "one"])
def test_frames_that_come_at_other_times_are_decoded_from_the_first(folder, wrong, monkeypatch, caplog):
    path = folder / "vp9.mp4"
    times = times_of(path)
    shown = times.shown_ms.copy()
    shown[slice(None) if wrong == "all" else 2 * CHUNK + 5] += 1.0
    monkeypatch.setattr(video_frames, "frame_times", lambda *_: replace(times, shown_ms=shown))
    with caplog.at_level(logging.WARNING):
        assert_right(path, range(2 * CHUNK, 2 * CHUNK + 10))
    assert "decoded from the first" in caplog.text
