"""Rounds of a training, read while the round before is worked on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType

from pipeline.avatar.frames.camera_offsets import MovedImages
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.training.distributed import Processes
from pipeline.avatar.training.step_loss import Portion
from pipeline.avatar.training.training_images import Schedule
from pipeline.capture.records import ImageRecord
from pipeline.config.train_avatar import TrainAvatar


def frames_in_use(settings: TrainAvatar, processes: Processes) -> int:
    """Frames that a process works on in a round, and those that it reads for the next."""
    places = settings.steps_together * settings.frames_per_step
    return 2 * sum(processes.rank in processes.sharers(place, places) for place in range(places))


@dataclass(frozen=True)
class Rounds:
    """Images that the steps of each round take.

    Attributes:
        schedule: order of the chosen images.
        chosen: rows of the images that the avatar is trained on.
        settings: how many steps a round has, and how many frames a step.
    """

    schedule: Schedule
    chosen: Sequence[int]
    settings: TrainAvatar

    def steps(self, first: int) -> range:
        """Steps of the round that begins with `first`."""
        return range(first, min(first + self.settings.steps_together, self.settings.steps))

    def batches(self, first: int) -> list[list[int]]:
        """Rows of the images of each frame of its steps, in order; none after the last step."""
        steps, in_step = self.steps(first), self.settings.frames_per_step
        groups = range(steps.start * in_step, steps.stop * in_step)
        return [[self.chosen[i] for i in self.schedule[group]] for group in groups]


class ReadAhead:
    """Portions of rounds, one of which is read on a thread while training takes another.

    The thread reads images, reads frames and traces what a first look at them would: most of it is done without the
    interpreter's lock.

    Args:
        avatar: what the frames are traced for.
        images: of the shards.
        frames: of all images.
        processes: this one among all.
    """

    def __init__(
        self, avatar: Avatar, images: MovedImages, frames: Mapping[int, FrameInputs], processes: Processes
    ) -> None:
        self.avatar, self.images, self.frames, self.processes = avatar, images, frames, processes
        self._pool = ThreadPoolExecutor(1, "read_ahead")
        self._next: tuple[list[list[int]], Future[list[list[ImageRecord]]]] | None = None

    def __enter__(self) -> ReadAhead:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pool.shutdown(cancel_futures=True)

    def start(self, batches: list[list[int]]) -> None:
        """Begin to read a round."""
        if self._next is None or self._next[0] != batches:
            self._next = batches, self._pool.submit(self._read, batches)

    def wait(self) -> None:
        """Return once nothing is being read, so that frames may be changed."""
        if self._next is not None:
            self._next[1].result()

    def portions(self, batches: list[list[int]]) -> list[Portion]:
        """This process' parts of a round, for each frame of its steps."""
        self.start(batches)
        read = self._next[1].result()
        return [self._portion(place, batches, mine) for place, mine in enumerate(read)]

    def _read(self, batches: list[list[int]]) -> list[list[ImageRecord]]:
        """Images of each place that are this process', whose frames are there and traced when it is done."""
        read = []
        for place, batch in enumerate(batches):
            sharers = self.processes.sharers(place, len(batches))
            if self.processes.rank in sharers:
                self.avatar.trace(self.frames[self._frame_of(batch)])
            read.append([self.images[i] for i in self.processes.share(batch, sharers)])
        return read

    def _portion(self, place: int, batches: list[list[int]], mine: list[ImageRecord]) -> Portion:
        batch, sharers = batches[place], self.processes.sharers(place, len(batches))
        inputs = self.frames[self._frame_of(batch)] if self.processes.rank in sharers else None
        return Portion(inputs, mine, len(batch), len(sharers), self.processes.rank in sharers)

    def _frame_of(self, batch: list[int]) -> int:
        return int(self.images.table.frame.iat[batch[0]])
