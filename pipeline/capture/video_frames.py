"""Frames of a recorded video, counted from 0, each decoded exactly.

Frames in order cost one pass. One far ahead is sought where `pipeline.capture.video_seeking` can tell that it is the
right one; else all before it are decoded.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.base.errors import InputError
from pipeline.capture.video_seeking import PASSED_INSIDE, FrameTimes, frame_times

log = logging.getLogger(__name__)

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

    The job of a later chunk of frames starts at a key frame before its first.

    Raises:
        InputError: if the video has no such frame.
    """
    return _shared(path, path.stat().st_mtime_ns).read(frame)


@dataclass
class _SharedVideo:
    """A video that threads read in turn, and the frames that were passed over.

    Attributes:
        changed_ns: when the file was changed.
        following: number of the frame that is decoded next.
        passed: frames that were decoded before they are asked for.
        sought: times that frames have to come at, since the video was moved to one of them.
        seeks: False once one did not.
    """

    path: Path
    changed_ns: int
    lock: threading.Lock = field(default_factory=threading.Lock)
    video: cv2.VideoCapture | None = None
    following: int = 0
    passed: dict[int, np.ndarray] = field(default_factory=dict)
    sought: FrameTimes | None = None
    seeks: bool = True

    def read(self, frame: int) -> np.ndarray:
        """A frame, which is decoded once if frames are asked for in order."""
        with self.lock:
            if frame in self.passed:
                return self.passed.pop(frame)
            picture = self._reach(frame)
            if picture is None and self.sought is not None and frame < len(self.sought.shown_ms):
                log.warning("%s: frames do not come at their times after seeking: decoded from the first", self.path)
                self.video, self.seeks = None, False
                picture = self._reach(frame)
            if picture is None:
                self.video = None
                raise InputError(f"{self.path}: expected a frame {frame}, found none")
            return picture

    def _reach(self, frame: int) -> np.ndarray | None:
        """Decode up to a frame, keeping the latest before it if it is the first of a run or hardly ahead."""
        kept = frame - AHEAD if self._move(frame) or frame - self.following <= AHEAD else frame
        while self.following <= frame:
            if not self.video.grab():
                return None
            if self.sought and self.sought.number(self.video.get(cv2.CAP_PROP_POS_MSEC)) != self.following:
                return None
            if self.following >= kept:
                self.passed[self.following] = self.video.retrieve()[1]
            self.following += 1
        picture = self.passed.pop(frame)
        for number in sorted(self.passed)[:-AHEAD]:
            del self.passed[number]
        return picture

    def _move(self, frame: int) -> bool:
        """Begin a new run of frames, from the first or from a key frame, if there is no way on or a shorter one."""
        back = self.video is None or frame < self.following
        if back:
            self._open()
        first = max(frame - AHEAD, 0)
        if not self.seeks or first - self.following <= PASSED_INSIDE:
            return back
        times = frame_times(self.path, self.changed_ns)
        if times is None or frame >= len(times.shown_ms) or (start := times.start_before(first)) <= self.following:
            return back
        self.video.set(cv2.CAP_PROP_POS_FRAMES, start + PASSED_INSIDE)
        landed = times.number(self.video.get(cv2.CAP_PROP_POS_MSEC)) if self.video.grab() else None
        if landed is None or not start <= landed < first:
            log.warning("%s: seeking lands beside: decoded from the first", self.path)
            self.seeks = False
            self._open()
        else:
            self.following, self.sought = landed + 1, times
            self.passed.clear()
        return True

    def _open(self) -> None:
        self.video, self.following, self.sought = cv2.VideoCapture(str(self.path)), 0, None
        self.passed.clear()


@lru_cache(maxsize=OPEN_VIDEOS)
def _shared(path: Path, changed_ns: int) -> _SharedVideo:
    return _SharedVideo(path, changed_ns)
