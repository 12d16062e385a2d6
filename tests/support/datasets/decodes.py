"""Images that stages decode, counted while they run in this process."""

from __future__ import annotations

import contextlib
import functools
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import cv2
import pytest

from pipeline.capture import images
from pipeline.capture.video_seeking import PASSED_INSIDE, frame_times


@dataclass
class Decodes:
    """Decoded files, one entry each time.

    Attributes:
        stage: that runs.
        files: stage and path of each image or mask.
        video_frames: stage and path of the video of each frame that its codec decoded, wanted or passed over.
    """

    stage: str = ""
    files: list[tuple[str, str]] = field(default_factory=list)
    video_frames: list[tuple[str, str]] = field(default_factory=list)

    def during(self, stage: str, run: Callable[..., None]) -> Callable[..., None]:
        """The `run` of a stage, whose decodes count as the stage's."""

        @functools.wraps(run)
        def counted(**arguments: object) -> None:
            before, self.stage = self.stage, stage
            try:
                run(**arguments)
            finally:
                self.stage = before

        return counted


class _Listener(logging.Handler):
    """Handler of the log of `pipeline.capture.images`, which has a line of each file."""

    def __init__(self, found: Decodes) -> None:
        super().__init__(logging.DEBUG)
        self.found = found

    def emit(self, record: logging.LogRecord) -> None:
        self.found.files.append((self.found.stage, str(record.args[0])))


def _counted_video(found: Decodes, kind: type) -> type:
    """A stand-in for OpenCV's videos, whose `grab` decodes a frame; `read` grabs one and converts it.

    One that is opened with more than its path gives packets that nobody decodes. Seeking decodes from a key frame on;
    how many frames that were is known as soon as the next one says its time.
    """

    class CountedVideo:
        def __init__(self, path: str, *how: object) -> None:
            self.path, self.raw, self.start, self.video = path, bool(how), None, kind(path, *how)

        def count(self, frames: int) -> None:
            found.video_frames += [(found.stage, self.path)] * frames

        def set(self, name: int, frame: int) -> bool:
            self.start = frame - PASSED_INSIDE
            return self.video.set(name, frame)

        def grab(self) -> bool:
            there = self.video.grab()
            if self.start is not None:
                times = frame_times(Path(self.path), Path(self.path).stat().st_mtime_ns)
                self.count((times.number(self.video.get(cv2.CAP_PROP_POS_MSEC)) or self.start) - self.start)
                self.start = None
            self.count(0 if self.raw else 1)
            return there

        def read(self) -> tuple[bool, object]:
            self.count(1)
            return self.video.read()

        def __getattr__(self, name: str) -> object:
            return getattr(self.video, name)

    return CountedVideo


@contextlib.contextmanager
def counted_decodes(*stages: ModuleType) -> Iterator[Decodes]:
    """Count what is decoded meanwhile, by those of the stages whose `run` is called as an attribute of its module."""
    found, log = Decodes(), logging.getLogger(images.__name__)
    listener, level, propagate = _Listener(found), log.level, log.propagate
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cv2, "VideoCapture", _counted_video(found, cv2.VideoCapture))
        for stage in stages:
            patch.setattr(stage, "run", found.during(stage.__name__.rpartition(".")[2], stage.run))
        log.addHandler(listener)
        log.setLevel(logging.DEBUG)
        log.propagate = False  # Thousands of lines are not for the handlers of a test or a terminal.
        try:
            yield found
        finally:
            log.propagate = propagate
            log.setLevel(level)
            log.removeHandler(listener)
