"""Exposure and gain per frame: images are read as if all frames had been exposed alike."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.capture.images import ImageSource
from pipeline.capture.index.validation import index_folder
from tests.support.captures.builder import HEIGHT, WIDTH, build_capture, save_exr, write_lines

TIMES = ("0,0.0,a", "1,0.03333333333333333,a", "2,0.5,b")


@pytest.fixture
def capture(tmp_path):
    return build_capture(tmp_path / "tiny")


def write_frames(root, columns, *values):
    rows = [f"{row},{value}" for row, value in zip(TIMES, values, strict=True)]
    write_lines(root / "frames.csv", f"frame,timestamp_s,segment,{columns}", *rows)


def source_of(root):
    index = index_folder(root)
    return ImageSource.from_index(root, index.contents["capture"]["images"]), index


def test_frame_that_was_exposed_four_times_as_much_reads_alike(capture):
    """Twice the time and twice the gain, stored four times as bright, after the black level."""
    light = np.random.default_rng(0).uniform(0.1, 1, (HEIGHT, WIDTH, 3)).astype(np.float32)
    for frame, factor in ((0, 1), (1, 4), (2, 1)):
        save_exr(capture / f"images/left/{frame:06d}.exr", factor * light, dtype=np.float32)
    write_frames(capture, "exposure_s,gain", "0.002,1", "0.004,2", "0.002,1")
    source, index = source_of(capture)
    assert index.contents["capture"]["images"]["exposures"] == {"1": 4.0}
    read = [source.read(f"images/left/{frame:06d}.exr", frame) for frame in range(3)]
    np.testing.assert_array_equal(read[1], read[0])
    np.testing.assert_array_equal(read[2], light)


def test_index_of_frames_is_the_same_with_and_without_exposures(capture):
    """Columns that change no result add none: everything that reads the table of frames reruns for what it says."""
    plain = index_folder(capture)
    write_frames(capture, "gain", "2", "2", "2")
    same = index_folder(capture)
    assert same.tables["frames"].equals(plain.tables["frames"])
    assert "exposures" not in same.contents["capture"]["images"]


def test_of_two_exposures_as_frequent_the_longer_stays(capture):
    write_lines(capture / "frames.csv", "frame,timestamp_s,segment,exposure_s", *(f"{row},0.01" for row in TIMES))
    write_frames(capture, "exposure_s", "0.01", "0.02", "0.04")
    assert index_folder(capture).contents["capture"]["images"]["exposures"] == {"0": 0.25, "1": 0.5}


@pytest.mark.parametrize("bad", ["0", "-0.01"])
def test_exposure_of_nothing_is_refused(capture, bad):
    write_frames(capture, "exposure_s", "0.01", bad, "0.01")
    with pytest.raises(InputError, match=r"frames.csv: .*exposure_s: expected more than 0"):
        index_folder(capture)


def test_every_reader_of_an_index_says_which_frame_it_reads(repo_root: Path):
    """Of all calls in the pipeline, None stands for clean plates alone."""
    plain = []
    for path in sorted((repo_root / "pipeline").rglob("*.py")):
        if "source.read(" not in (text := path.read_text()):
            continue
        for node in ast.walk(ast.parse(text)):
            called = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "read"
            if called and ast.unparse(node.func.value).split(".")[-1] == "source":
                assert len(node.args) == 2, f"{path}:{node.lineno}"
                if ast.unparse(node.args[1]) == "None":
                    plain.append(path.name)
    assert plain == ["segment_subject.py"]
