"""Tables in pieces against the same tables whole."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from pipeline.base import files, large_tables
from pipeline.base.files import write_table
from pipeline.base.large_tables import RangedRows, range_starts, read_pieces, written_pieces


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch):
    for module in (files, large_tables):
        monkeypatch.setattr(module, "ROWS_AT_A_TIME", 100)
    monkeypatch.setattr(large_tables, "MOST_ROWS", 150)


def make_table(rows):
    random = np.random.default_rng(0)
    names = pd.Series(random.choice(["left", "right", "überkopf", None], rows), dtype="str")
    return pd.DataFrame({"frame": random.integers(0, 20, rows), "camera": names, "x": random.normal(size=rows)})


@pytest.mark.parametrize("rows", [0, 99, 100, 101, 1000])
def test_table_in_pieces_has_the_bytes_of_the_whole(rows, tmp_path):
    table = make_table(rows)
    write_table(tmp_path / "whole.parquet", table)
    with written_pieces(tmp_path / "pieces.parquet") as writer:
        writer.add(table[:0])
        for first in range(0, rows, 37):
            writer.add(table[first : first + 37])
    assert writer.rows == rows
    assert (tmp_path / "pieces.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def test_table_that_fails_half_way_is_not_there(tmp_path):
    def fail():
        with written_pieces(tmp_path / "a.parquet") as writer:
            writer.add(make_table(250))
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        fail()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rows", [0, 250])
def test_pieces_are_the_columns_of_the_table(rows, tmp_path):
    """Also of a table that some other program wrote as one group of rows."""
    table = make_table(rows)
    table.to_parquet(tmp_path / "a.parquet", index=False)
    pieces = list(read_pieces(tmp_path / "a.parquet", ["frame", "camera"]))
    assert [len(piece) for piece in pieces] == ([100, 100, 50] if rows else [0])
    pd.testing.assert_frame_equal(pd.concat(pieces, ignore_index=True), table[["frame", "camera"]])


def test_ranges_have_the_rows_in_the_order_they_were_added(tmp_path):
    """Twenty frames in any order; more rows than may wait in memory."""
    table, starts = make_table(1000), [5, 6, 13]
    ranged = RangedRows(tmp_path / "ranges", "frame", starts)
    for first in range(0, 1000, 70):
        ranged.add(table[first : first + 70])
    assert len(list((tmp_path / "ranges").iterdir())) == 4
    expected = [table[table.frame.between(*ends)] for ends in ((0, 4), (5, 5), (6, 12), (13, 19))]
    for found, rows in zip(ranged.ranges(), expected, strict=True):
        pd.testing.assert_frame_equal(found, rows)
    assert not list((tmp_path / "ranges").iterdir())


def test_few_rows_touch_no_disk(tmp_path):
    ranged, table = RangedRows(tmp_path / "ranges", "frame", []), make_table(120)
    ranged.add(table)
    pd.testing.assert_frame_equal(*ranged.ranges(), table)
    assert not list(tmp_path.iterdir())


def test_ranges_are_as_few_as_fit():
    """Of 3 + 4, 2 + 5, and 9, which is more than may be but one value, and 1."""
    assert range_starts({4: 4, 1: 3, 5: 2, 7: 5, 8: 9, 11: 1}, most=7) == [5, 8, 11]
    assert range_starts({}, most=7) == [] == range_starts({3: 100}, most=7)


def test_rows_of_a_range_of_frames_are_found_without_reading_others(tmp_path):
    """Groups of rows of a table in pieces say which frames they have, as those of a whole one do."""
    with written_pieces(tmp_path / "a.parquet") as writer:
        for frame in range(50):
            writer.add(pd.DataFrame({"frame": [frame] * 20}))
    groups = pq.read_metadata(tmp_path / "a.parquet")
    limits = [groups.row_group(k).column(0).statistics for k in range(groups.num_row_groups)]
    assert [(limit.min, limit.max) for limit in limits] == [(5 * k, 5 * k + 4) for k in range(10)]
