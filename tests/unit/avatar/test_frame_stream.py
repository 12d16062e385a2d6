"""Frames read as they are asked for: how many are kept, and that it changes nothing."""

import threading

import numpy as np
import pytest

from pipeline.avatar.frames.frame_stream import FrameStream, held_bytes
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.light_gains import LightGains
from pipeline.capture.shards import read_frame_shards, write_frame_shard
from tests.support.avatars.sheet import make_frame, make_sheet

ATLAS, FRAMES = make_sheet(8), 6
PLACE = np.array([[0.5, 0.3, 1.5]], np.float32)


@pytest.fixture
def records(tmp_path):
    frames = [make_frame(ATLAS, PLACE + number, np.ones((1, 3)), number) for number in range(FRAMES)]
    write_frame_shard(tmp_path / "0000.arrow", frames)
    return read_frame_shards([tmp_path])


def visit(stream, number):
    """A frame, and what a step asks of it."""
    frame = stream[number]
    _ = frame.posed, frame.lights
    return frame


def test_frames_that_came_first_are_kept_and_those_visited_last(records):
    one = held_bytes(visit(FrameStream(ATLAS, records), 0))
    stream = FrameStream(ATLAS, records, most_bytes=2.5 * one, in_use=1)
    first = [visit(stream, number) for number in range(FRAMES)]
    again = [visit(stream, number) for number in (5, 0, 1, 2, 3, 4)]
    same = [number for number, frame in zip((5, 0, 1, 2, 3, 4), again, strict=True) if frame is first[number]]
    assert same == [5, 0, 1]
    assert stream.kept_bytes == 2 * one
    assert len(stream) == FRAMES and list(stream) == list(range(FRAMES))


def test_without_a_bound_every_frame_is_made_once(records):
    stream = FrameStream(ATLAS, records)
    first = [visit(stream, number) for number in range(FRAMES)]
    assert all(stream[number] is first[number] for number in range(FRAMES))


def test_bytes_are_those_of_all_arrays_that_a_visit_made():
    """float32: 9 vertices ... of the record, then points, frames and quaternions of texels: 16 numbers each."""
    frame = FrameInputs(ATLAS, make_frame(ATLAS, PLACE, np.ones((1, 3))))
    record = sum(array.nbytes for array in vars(frame.record).values() if isinstance(array, np.ndarray))
    assert held_bytes(frame) == record
    _ = frame.posed
    assert held_bytes(frame) == record + 4 * 16 * ATLAS.texel_count
    _ = frame.lights
    assert held_bytes(frame) == record + 4 * 16 * ATLAS.texel_count + 4 * 6


def test_frames_are_lit_by_the_latest_gains_kept_or_not(records):
    stream = FrameStream(ATLAS, records, most_bytes=0.0, in_use=2)
    before = visit(stream, 0)
    visit(stream, 1)
    stream.relight(LightGains(PLACE, np.array([2.0], np.float32)))
    for number, factor in ((0, 2.0), (1, 1.0), (2, 1.0)):
        np.testing.assert_array_equal(visit(stream, number).lights.intensities.numpy(), np.full((1, 3), factor, "f4"))
    assert before.lights.intensities.max() == 1  # nothing writes into what was given
    np.testing.assert_array_equal(visit(stream, 0).lights.intensities.numpy(), np.full((1, 3), 2.0, "f4"))


def test_several_threads_may_ask(records):
    stream, wrong = FrameStream(ATLAS, records, most_bytes=4000.0, in_use=2), []

    def look(seed):
        for number in np.random.default_rng(seed).integers(0, FRAMES, 60).tolist():
            if not np.array_equal(visit(stream, number).record.light_positions, PLACE + number):
                wrong.append(number)

    threads = [threading.Thread(target=look, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong
    assert stream.kept_bytes <= 4000
