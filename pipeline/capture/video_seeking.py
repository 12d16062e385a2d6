"""Seeking in a video, so that the frame that comes is known to be the right one.

OpenCV seeks by time, counts on as if all frames took as long, and may land beside (opencv/opencv#9053). But it says of
each frame when it is shown, and the packets of a file, which are read without decoding them, say so of all frames, and
which of them decoding may start from. A frame is known by its time; where times or packets leave a doubt, as those of a
rate that varies do, nothing is sought.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Int64

TIMED_SUFFIXES = (".mp4", ".mov", ".mkv")
"""Containers that say when a frame is shown. An .avi says when it is decoded, which B-frames make another order."""

WHOLE_PACKETS = frozenset(
    {"h264", "avc1", "hevc", "hvc1", "hev1", "vp90", "vp09", "av01", "fmp4", "mp4v", "mpg2", "mjpg"}
)
"""Codecs, as OpenCV names them, of whose packets each is one frame; those of VP8 may show nothing."""

PASSED_INSIDE = 16
"""Frames that OpenCV's seek passes over by itself: it starts from this many before the one it is asked for."""

CHECKED = 3
"""First frames whose times as decoded are compared with those of the packets."""

EVEN = 0.5
"""Frames by which times may be off those of an even rate, in which OpenCV counts: rounded, its numbers are the same."""


@dataclass(frozen=True)
class FrameTimes:
    """Times of a video's frames.

    Attributes:
        shown_ms: when each is shown, in order.
        starts: numbers of the frames from which decoding may start, in order.
    """

    shown_ms: Float64[np.ndarray, " frames"]
    starts: Int64[np.ndarray, " starts"]

    def number(self, shown_ms: float) -> int | None:
        """Number of the frame that is shown at a time; None if there is none."""
        place = int(np.searchsorted(self.shown_ms, shown_ms))
        return place if place < len(self.shown_ms) and self.shown_ms[place] == shown_ms else None

    def start_before(self, frame: int) -> int:
        """The last frame to start from, such that a seek, which passes over some, ends before it."""
        return int(self.starts[max(np.searchsorted(self.starts, frame - PASSED_INSIDE - 1, side="right") - 1, 0)])


@lru_cache(maxsize=4096)
def frame_times(path: Path, _changed_ns: int) -> FrameTimes | None:
    """Times of a video's frames, by its packets; None if in doubt. Only the first few are decoded."""
    if path.suffix.lower() not in TIMED_SUFFIXES:
        return None
    packets = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    times, starts = [], []
    while packets.grab():
        times.append(packets.get(cv2.CAP_PROP_POS_MSEC))
        starts.append(packets.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME) > 0)
    packets.release()
    order = np.argsort(times, kind="stable")
    found = FrameTimes(np.array(times)[order], np.flatnonzero(np.array(starts, bool)[order]))
    video = cv2.VideoCapture(str(path))
    code, fps, count = (video.get(name) for name in (cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_FPS, cv2.CAP_PROP_FRAME_COUNT))
    # Each packet has to be one of the frames that the header counts, and none shown before the first to start from.
    sound = _codec(int(code)) in WHOLE_PACKETS and CHECKED < len(times) == count
    sound = sound and starts[0] and order[0] == 0 and _even(found.shown_ms, fps)
    sound = sound and all(
        video.grab() and found.number(video.get(cv2.CAP_PROP_POS_MSEC)) == number for number in range(CHECKED)
    )
    video.release()
    return found if sound else None


def _codec(code: int) -> str:
    return (code & 0xFFFFFFFF).to_bytes(4, "little").decode("ascii", "replace").lower()


def _even(shown_ms: Float64[np.ndarray, " frames"], fps: float) -> bool:
    """Each frame has a time of its own, which is next to what its number says."""
    off = np.abs((shown_ms - shown_ms[0]) * fps / 1000 - np.arange(len(shown_ms)))
    return bool((off < EVEN).all() and (np.diff(shown_ms) > 0).all())
