"""Films: .mp4 files that browsers and players show.

VP9 in MP4, by the libvpx that OpenCV's own packages bring along. OpenCV's other free choice for .mp4, MPEG-4 part 2
(mp4v), plays in no browser; H.264 would take a GPL ffmpeg of 30 MB beside it (imageio-ffmpeg), and gains nothing here.
Where an OpenCV was built without VP9, mp4v is written instead, and the log says so.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.base.files import written_whole

log = logging.getLogger("video")

CODES = ("vp09", "mp4v")


def write_video(path: Path, pictures: Iterable[UInt8[np.ndarray, "h w 3"]], fps: float) -> None:
    """Write sRGB pictures of one size as a film.

    An odd last row or column, which codecs refuse, is repeated.

    Raises:
        RuntimeError: if OpenCV has neither codec.
    """
    writer = None
    with written_whole(path) as temporary:
        try:
            for picture in pictures:
                odd = (picture.shape[0] % 2, picture.shape[1] % 2)
                even = np.pad(picture, ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge")
                writer = writer or _open(temporary, fps, even.shape[1], even.shape[0])
                writer.write(np.ascontiguousarray(even[..., ::-1]))
        finally:
            if writer is not None:
                writer.release()


def _open(path: Path, fps: float, width: int, height: int) -> cv2.VideoWriter:
    for code in CODES:
        writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), fps, (width, height))
        if writer.isOpened():
            if code != CODES[0]:
                log.warning("this OpenCV has no %s: the film is %s, which browsers do not play", CODES[0], code)
            return writer
    raise RuntimeError(f"write_video: expected an OpenCV with one of the codecs {CODES}, found none")
