"""Tables of keypoints that are checked and copied in pieces, against the same tables seen whole."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from pipeline.base import files, large_tables
from pipeline.base.errors import Complaints
from pipeline.base.files import write_table
from pipeline.capture.index.keypoint_tables import KeypointSource, copy_keypoints

FRAMES, CAMERAS, KEYPOINTS = range(0, 60, 3), ("left", "right", "über"), ("hip", "nose", "toe")
KNOWN = {"frame": FRAMES, "camera": CAMERAS, "keypoint": KEYPOINTS}
ORDER = ["frame", "camera", "keypoint"]


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    """180 rows: five pieces, and ranges of up to five frames."""
    for module in (files, large_tables):
        monkeypatch.setattr(module, "ROWS_AT_A_TIME", 40)
    monkeypatch.setattr(large_tables, "MOST_ROWS", 45)


def make_table(keypoints=KEYPOINTS):
    table = pd.DataFrame(itertools.product(FRAMES, CAMERAS, keypoints), columns=ORDER)
    random = np.random.default_rng(0)
    numbers = {name: random.uniform(size=len(table)) for name in ("x", "y", "confidence")}
    return table.astype({"camera": "str", "keypoint": "str"}).assign(**numbers)


def copied(folder, table, **more):
    """What is said of a table, and the number of its keypoints."""
    table.to_parquet(folder / "given.parquet", index=False)
    complaints = Complaints(folder)
    count = copy_keypoints(KeypointSource(folder, "given.parquet", **more), KNOWN, folder, complaints)
    return complaints.messages, count


@pytest.mark.parametrize("order", [["camera", "keypoint", "frame"], ["frame", "keypoint", "camera"], "any"])
def test_rows_in_any_order_become_the_bytes_of_the_sorted_table(order, tmp_path):
    table = make_table()
    given = table.sample(frac=1, random_state=1) if order == "any" else table.sort_values(order)
    assert copied(tmp_path, given) == ([], 180)
    write_table(tmp_path / "expected.parquet", table)
    assert (tmp_path / "keypoints_2d.parquet").read_bytes() == (tmp_path / "expected.parquet").read_bytes()
    assert len(pd.read_parquet(tmp_path / "eye_points.parquet")) == 0


def test_all_that_is_wrong_in_any_piece_is_said_once(tmp_path):
    table = make_table()
    table.loc[[3, 99], "camera"] = None
    table.loc[[50, 120, 170], "y"] = [np.nan, np.inf, -np.inf]
    table.loc[[10, 160], "confidence"] = [-1.0, 2000.0]
    table.loc[[175], "confidence"] = 3000.0
    table.loc[[150, 20], "frame"] = [1, 2]
    table.loc[[30, 130], "keypoint"] = ["hop", "tail"]
    messages, _ = copied(tmp_path, table)
    assert messages == [
        "given.parquet: camera: expected a name in each row, found 2 rows without any",
        "given.parquet: y: expected finite numbers, found 3 rows of NaN or infinity; leave out rows that the detector "
        "did not find",
        "given.parquet: confidence: expected 0 or more, found 1 negative rows",
        "given.parquet: confidence: expected weights of at most 1000, found 2 rows up to 3000",
        "given.parquet: frame: expected one that the table of frames lists, found 2, 1",
        "given.parquet: keypoint: expected one that the table of keypoints lists, found hop, tail",
    ]


def test_repeated_rows_are_named_in_the_order_of_the_file(tmp_path):
    """Whatever ranges of frames they are in; the row at the end is there three times."""
    table = make_table()
    again = table.iloc[[170, 0, 90, 45, 1, 100, 0]]
    messages, _ = copied(tmp_path, pd.concat([table, again]))
    named = [" ".join(map(str, row)) for row in again[ORDER].to_numpy()[:5]]
    expected = f"expected each once, found repeated: {', '.join(named)} ... (6 in all)"
    assert messages == [f"given.parquet: frame and camera and keypoint: {expected}"]


def test_first_of_two_columns_without_numbers_is_named_whichever_comes_first(tmp_path):
    table = make_table().astype({"x": "str", "y": "str"})
    table.loc[5, "y"], table.loc[105, "x"] = "low", "far"
    (message,) = copied(tmp_path, table)[0]
    assert message.startswith("given.parquet: columns: expected numbers in frame, x, y, confidence, found ")
    assert "'far'" in message and "low" not in message


@pytest.mark.parametrize("lost", range(5))
def test_file_that_is_damaged_anywhere_is_no_table(lost, tmp_path):
    path = tmp_path / "given.parquet"
    write_table(path, make_table())
    content = bytearray(path.read_bytes())
    group = pq.read_metadata(path).row_group(lost)
    for column in (group.column(k) for k in range(6)):
        first = column.dictionary_page_offset or column.data_page_offset
        content[first : first + column.total_compressed_size] = bytes(column.total_compressed_size)
    path.write_bytes(content)
    complaints = Complaints(tmp_path)
    copy_keypoints(KeypointSource(tmp_path, path.name), KNOWN, tmp_path, complaints)
    (message,) = complaints.messages
    assert message.startswith("given.parquet: table: expected a parquet table, found ")


def test_of_two_numbers_of_one_point_the_surer_stays_wherever_it_stands(tmp_path):
    """BODY_25 calls its nose 0 or Nose; the right eye is no keypoint of the template."""
    table = make_table(keypoints=("0", "Nose", "15"))
    given = table.sample(frac=1, random_state=2)
    messages, count = copied(tmp_path, given, order="openpose_body_25", points={"nose": "nose"})
    assert messages == [] and count == len(FRAMES) * len(CAMERAS)
    found = pd.read_parquet(tmp_path / "keypoints_2d.parquet")
    noses = table[table.keypoint != "15"]
    surest = noses.loc[noses.groupby(["frame", "camera"]).confidence.idxmax()].assign(keypoint="nose")
    pd.testing.assert_frame_equal(found, surest.reset_index(drop=True))


def test_points_of_eyes_are_those_of_all_ranges(tmp_path):
    (tmp_path / "points.csv").write_text("keypoint,point\ntoe,left_pupil\n")
    table = make_table()
    assert copied(tmp_path, table.sample(frac=1, random_state=3), given="points.csv") == ([], 180)
    expected = table[table.keypoint == "toe"].rename(columns={"keypoint": "point"}).assign(point="left_pupil")
    found = pd.read_parquet(tmp_path / "eye_points.parquet")
    pd.testing.assert_frame_equal(found, expected.astype({"point": "str"}).reset_index(drop=True))
