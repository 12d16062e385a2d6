"""Frames of a recorded video, counted from 0, each decoded exactly.

No seeking, which codecs answer as they like.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.base.errors import InputError

VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv")

MEAN = np.full((1, 3), 1 / 3, np.float32)
"""Matrix that takes the mean of three channels. OpenCV rounds it; thirds never lie halfway."""

OPEN_VIDEOS = 64
"""Videos that a process keeps open: one of each camera of a stage, as images are packed frame by frame."""

AHEAD = 4
"""Frames that are passed over and kept, the latest of them, if one that comes so soon is asked for first: threads that
share a video in order have asked for all of them, or are about to."""

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


@dataclass(frozen=True)
class VideoFacts:
    """Header of a video: number of frames, their size, frames per second."""

    frames: int
    width: int
    height: int
    fps: float


def video_facts(path: Path) -> VideoFacts:
    """The header of a video; no frame is decoded.

    Raises:
        InputError: if there is none.
    """
    return _facts(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4096)
def _facts(path: Path, _changed_ns: int) -> VideoFacts:
    video = cv2.VideoCapture(str(path))
    names = (cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
    frames, width, height = (int(video.get(name)) for name in names)
    fps = float(video.get(cv2.CAP_PROP_FPS))
    video.release()
    if frames <= 0 or width <= 0 or not fps > 0:
        raise InputError(f"{path}: expected a video that OpenCV decodes, found none")
    return VideoFacts(frames, width, height, fps)


def read_video_frame(path: Path, frame: int) -> UInt8[np.ndarray, "height width 3"]:
    """One frame as B, G, R. Frames in order cost one pass, also if several threads share it.

    Raises:
        InputError: if the video has no such frame.
    """
    return _shared(path, path.stat().st_mtime_ns).read(frame)


@dataclass
class _SharedVideo:
    """A video that threads read in turn, and the frames that were passed over."""

    path: Path
    lock: threading.Lock = field(default_factory=threading.Lock)
    video: cv2.VideoCapture | None = None
    following: int = 0
    passed: dict[int, np.ndarray] = field(default_factory=dict)

    def read(self, frame: int) -> np.ndarray:
        """A frame, which is decoded once if frames are asked for in order."""
        with self.lock:
            if frame in self.passed:
                return self.passed.pop(frame)
            if self.video is None or frame < self.following:
                self.video, self.following = cv2.VideoCapture(str(self.path)), 0
                self.passed.clear()
            close = frame - self.following <= AHEAD
            while self.following < frame and self.video.grab():
                if close:
                    self.passed[self.following] = self.video.retrieve()[1]
                self.following += 1
            there, picture = self.video.read() if self.following == frame else (False, None)
            if not there:
                self.video = None
                raise InputError(f"{self.path}: expected a frame {frame}, found none")
            self.following = frame + 1
            for number in sorted(self.passed)[:-AHEAD]:
                del self.passed[number]
            return picture


@lru_cache(maxsize=OPEN_VIDEOS)
def _shared(path: Path, _changed_ns: int) -> _SharedVideo:
    return _SharedVideo(path)
