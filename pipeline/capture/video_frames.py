"""Frames of a recorded video, counted from 0, each decoded exactly.

No seeking, which codecs answer as they like.
"""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.base.errors import InputError

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv")

MEAN = np.full((1, 3), 1 / 3, np.float32)
"""Matrix that takes the mean of three channels. OpenCV rounds it; thirds never lie halfway."""

_opened = threading.local()
"""Of each thread, the video that it reads, and the number of the next frame: frames in order cost one pass."""


def count_frames(path: Path) -> tuple[int, tuple[int, int]]:
    """Number of frames that can be decoded, and their (width, height).

    Raises:
        InputError: if there is none.
    """
    video, count = cv2.VideoCapture(str(path)), 0
    size = (int(video.get(cv2.CAP_PROP_FRAME_WIDTH)), int(video.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    while video.grab():
        count += 1
    video.release()
    if count == 0:
        raise InputError(f"{path}: expected a video that OpenCV decodes, found none")
    return count, size


def read_video_gray(path: Path, frame: int) -> UInt8[np.ndarray, "height width"]:
    """One frame as a grey image, as `read_gray_8bit` has it: the mean of the channels.

    Raises:
        InputError: if the video has no such frame.
    """
    name, video, following = getattr(_opened, "video", ("", None, 0))
    if name != str(path) or frame < following:
        if video is not None:
            video.release()
        video, following = cv2.VideoCapture(str(path)), 0
    there = True
    while there and following < frame:
        there, following = video.grab(), following + 1
    there, picture = video.read() if there else (False, None)
    _opened.video = (str(path), video, following + 1)
    if not there:
        raise InputError(f"{path}: expected a frame {frame}, found none")
    return cv2.transform(picture, MEAN)
