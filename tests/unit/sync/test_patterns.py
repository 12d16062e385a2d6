"""Bookkeeping of patterns on a small stage whose every number is known."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from pipeline.sync.patterns import find_leaks, mend_patterns, name_patterns, synced_frames, synced_patterns

FRAMES = pd.DataFrame({"frame": [3, 1, 2, 0], "timestamp_s": [0.3, 0.1, 0.2, 0.0], "segment": ["b", "a", "a", "a"]})


def white(rows: list[tuple[int, str, float]]) -> pd.DataFrame:
    table = pd.DataFrame(rows, columns=["frame", "light", "intensity_r"])
    return table.assign(intensity_g=table.intensity_r, intensity_b=table.intensity_r)


PATTERNS = white([(0, "B", 2.0), (0, "A", 4.0), (1, "A", 8.0), (2, "B", 2.0)])
IMAGES = pd.DataFrame(
    {
        "frame": [0, 0, 1, 2, 3],
        "camera": ["c", "d", "c", "c", "c"],
        "test_camera": [False, True, False, False, False],
        "test_frame": [False, False, True, False, True],
        "test_segment": [False, False, False, False, True],
        "test_pattern": False,
        "validation_frame": False,
        "validation_pattern": False,
    }
)


def images(count: int, **held_out: tuple) -> pd.DataFrame:
    """Images of one camera; `held_out` are frames by the plurals of their flags. Validation is named where any is."""
    frame = pd.Series(range(count))
    table = pd.DataFrame({"frame": frame, "camera": "c", "test_camera": False, "test_segment": False})
    named = any(name.startswith("validation") for name in held_out)
    for name in ("test_frame", "test_pattern", "validation_frame", "validation_pattern"):
        flags = frame.isin(held_out.get(f"{name}s", ()))
        table[name] = flags if named or name.startswith("test") else pd.Series(pd.NA, frame.index, "boolean")
    return table


def frames(count: int) -> pd.DataFrame:
    return pd.DataFrame({"frame": range(count), "timestamp_s": np.arange(count) / 24, "segment": "a"})


def test_frames_are_booked_in_order():
    synced = synced_frames(FRAMES, IMAGES, PATTERNS, ["A", "B"])
    assert synced.frame.tolist() == [0, 1, 2, 3]
    assert synced.lights_on.tolist() == [2, 1, 1, 0]
    assert synced.fully_lit.tolist() == [True, False, False, False]
    assert synced.split.tolist() == ["train", "test_frames", "train", "test_segments"]
    table = synced_patterns(PATTERNS, synced)
    assert table[["frame", "light"]].to_numpy().tolist() == [[0, "A"], [0, "B"], [1, "A"], [2, "B"]]
    assert (table.intensity_r == [4, 2, 8, 2]).all()
    assert table.fully_lit.tolist() == [True, True, False, False]


def test_a_pattern_is_named_by_the_first_frame_that_shows_it():
    patterns = white([(0, "A", 1), (0, "B", 2), (2, "B", 2 + 1e-9), (2, "A", 1), (3, "A", 1), (4, "A", 1.5)])
    patterns.loc[len(patterns)] = [5, "A", 1, 1, 0.5]  # the same light in another colour
    names = name_patterns(patterns, pd.Series(range(7)))
    assert names.tolist() == [0, 1, 0, 3, 4, 5, 1]  # 1 and 6 are dark


def test_a_held_out_pattern_holds_out_every_frame_that_shows_it():
    patterns = white([(0, "A", 1), (1, "B", 1), (2, "A", 1), (3, "B", 1), (4, "C", 1)])
    synced = synced_frames(frames(5), images(5, test_patterns=(3,)), patterns, ["A", "B", "C"])
    assert synced.split.tolist() == ["train", "test_patterns", "train", "test_patterns", "train"]
    assert find_leaks(synced, patterns) == []


def test_the_same_light_at_another_strength_is_a_leak():
    patterns = white([(0, "A", 1), (0, "B", 2), (1, "A", 3), (1, "B", 6), (2, "A", 3), (2, "B", 5), (3, "A", 1)])
    synced = synced_frames(frames(4), images(4, test_patterns=(0,)), patterns, ["A", "B", "C"])
    assert find_leaks(synced, patterns) == [(0, 1)]


def test_a_partially_lit_test_frame_leaks_into_a_training_frame_of_its_pattern():
    patterns = white([(0, "A", 1), (1, "A", 1), (2, "A", 1), (2, "B", 1), (3, "A", 1), (3, "B", 1)])
    synced = synced_frames(frames(6), images(6, test_frames=(0, 2, 4)), patterns, ["A", "B"])
    # Frames 2 and 3 are fully lit, 4 and 5 dark: that such frames repeat is what they are for.
    assert find_leaks(synced, patterns) == [(0, 1)]


def test_a_fully_lit_pattern_leaks_if_it_is_itself_held_out():
    patterns = white([(0, "A", 1), (0, "B", 1), (1, "A", 2), (1, "B", 2)])
    synced = synced_frames(frames(2), images(2, test_patterns=(0,)), patterns, ["A", "B"])
    assert find_leaks(synced, patterns) == [(0, 1)]


def test_named_validation_holds_out_frames_and_patterns_but_never_test_frames():
    patterns = white([(0, "A", 1), (1, "B", 1), (2, "A", 1), (3, "B", 1), (4, "C", 1), (5, "C", 1)])
    held_out = images(6, test_frames=(2,), validation_frames=(2, 4), validation_patterns=(3,))
    synced = synced_frames(frames(6), held_out, patterns, ["A", "B", "C"])
    assert synced.split.tolist() == ["train", "validation", "test_frames", "validation", "validation", "train"]
    assert synced.validation.tolist() == [False, True, False, True, True, False]


def test_without_names_an_eighth_of_each_kind_of_training_frames_is_for_validation():
    """Of 60 frames every third is fully lit; ten partially lit patterns come round four times; 48 to 59 are tested."""
    rows = [(f, light, 1.0) for f in range(60) for light in ("ABC" if f % 3 == 0 else "A")]
    patterns = white(rows)
    order = pd.Series(range(60))[np.arange(60) % 3 != 0]
    level = dict(zip(order, 1.0 + np.arange(40) % 10, strict=True))
    channels = ["intensity_r", "intensity_g", "intensity_b"]
    patterns[channels] = patterns[channels].mul(patterns.frame.map(level).fillna(1.0), axis=0)
    synced = synced_frames(frames(60), images(60, test_frames=tuple(range(48, 60))), patterns, ["A", "B", "C"])
    chosen = synced[synced.validation]
    assert (chosen.frame < 48).all() and (chosen.split == "validation").all()
    assert chosen.fully_lit.sum() == 16 // 8
    partial = chosen[~chosen.fully_lit]
    assert partial.pattern.nunique() == 10 // 8
    assert not synced[synced.split == "train"].pattern.isin(partial.pattern).any()
    assert 0.05 < len(chosen) / 48 < 0.2


def test_validation_frames_are_spread_over_the_take():
    """One of every eight, so that no part of a motion is left out; of 48 fully lit frames of one light."""
    synced = synced_frames(frames(48), images(48), white([(frame, "A", 1.0) for frame in range(48)]), ["A"])
    chosen = synced.frame[synced.validation].to_numpy()
    assert (chosen // 8).tolist() == [0, 1, 2, 3, 4, 5]


@pytest.mark.parametrize("place", range(8))
def test_dark_frame_is_never_held_out_for_validation(place):
    """Nothing can be scored on it: of eight partial patterns, each place in turn is dark."""
    lit = [(frame, f"L{frame}", 1.0) for frame in range(8) if frame != place]
    synced = synced_frames(frames(8), images(8), white(lit), [f"L{k}" for k in range(9)])
    assert synced.lights_on[place] == 0 and not synced.validation[place]


@pytest.mark.parametrize(("count", "spared"), [(7, 0), (8, 1), (15, 1), (16, 2)])
def test_of_few_frames_none_is_taken_from_training(count, spared):
    patterns = white([(f, light, 1.0) for f in range(count) for light in "AB"])
    synced = synced_frames(frames(count), images(count), patterns, ["A", "B"])
    assert synced.validation.sum() == spared
    named = synced_frames(frames(count), images(count, validation_frames=()), patterns, ["A", "B"])
    assert not named.validation.any()


def found(offsets: list[int], suspicious: tuple = ()) -> pd.DataFrame:
    table = pd.DataFrame({"frame": range(len(offsets)), "offset_frames": offsets})
    return table.assign(suspicious=table.frame.isin(suspicious))


@pytest.mark.parametrize(
    ("offsets", "left", "shown"),
    [
        ([0, 0, 0, 0], [0, 1, 2, 3], ["A", "B", "C", "D"]),
        ([1, 1, 1, 1], [0, 1, 2], ["B", "C", "D"]),
        ([-2, -2, -2, -2], [2, 3], ["A", "B"]),
        ([0, 1, 1, 1], [0, 1, 2], ["A", "C", "D"]),
        ([0, 0, -1, -1], [0, 1, 2, 3], ["A", "B", "B", "C"]),
    ],
)
def test_patterns_move_to_their_images(offsets, left, shown):
    patterns = white([(f, light, f + 1) for f, light in enumerate("ABCD")])
    moved, kept = mend_patterns(patterns, frames(4), found(offsets), {})
    assert kept.frame.tolist() == left
    assert moved.sort_values("frame").light.tolist() == shown
    assert (moved.intensity_r == moved.light.map(ord) - ord("A") + 1).all()


def test_patterns_logged_beyond_the_images_are_used():
    patterns = white([(f, "A", 1) for f in range(2, 6)])
    moved, kept = mend_patterns(patterns, frames(4), found([2, 2, 2, 2]), {})
    assert kept.frame.tolist() == moved.frame.tolist() == [0, 1, 2, 3]


def test_frames_and_lights_are_booked_as_they_were():
    patterns = white([(0, "A", 1), (0, "B", 1), (1, "A", 1), (2, "B", 1)])
    constants = {"A": np.zeros(3), "C": np.array([0.5, 0.4, 0.3])}
    moved, kept = mend_patterns(patterns, frames(4), found([0] * 4, suspicious=(2,)), constants)
    assert kept.frame.tolist() == [0, 1, 3]
    assert moved[["frame", "light"]].to_numpy().tolist() == [[0, "B"], [0, "C"], [1, "C"], [3, "C"]]
    assert moved[moved.light == "C"].iloc[0, 2:].tolist() == [0.5, 0.4, 0.3]
    assert patterns.equals(white([(0, "A", 1), (0, "B", 1), (1, "A", 1), (2, "B", 1)]))
