from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from pipeline.base import files
from pipeline.base.errors import InputError
from pipeline.base.files import (
    digest_bytes,
    digest_file,
    read_arrays,
    read_distinct,
    read_json,
    read_rows,
    read_table,
    write_arrays,
    write_json,
    write_table,
    written_whole,
)


class TestWrittenWhole:
    def test_file_appears_under_its_name_only_when_done(self, tmp_path: Path) -> None:
        path = tmp_path / "new/folder/a.txt"
        with written_whole(path) as temporary:
            temporary.write_text("whole")
            assert not path.exists()
            assert temporary.suffix == ".txt"
        assert path.read_text() == "whole"
        assert os.listdir(path.parent) == ["a.txt"]

    def test_failure_keeps_the_old_file_and_leaves_no_other(self, tmp_path: Path) -> None:
        path = tmp_path / "a.txt"
        path.write_text("old")

        def fail() -> None:
            with written_whole(path) as temporary:
                temporary.write_text("half")
                raise RuntimeError("killed")

        with pytest.raises(RuntimeError, match="killed"):
            fail()
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["a.txt"]


def test_json_keeps_every_digit_and_refuses_nan(tmp_path: Path) -> None:
    numbers = [0.1 + 0.2, 1e-300, float(np.nextafter(1.0, 2.0))]
    write_json(tmp_path / "a.json", {"numbers": numbers})
    assert read_json(tmp_path / "a.json") == {"numbers": numbers}
    with pytest.raises(ValueError, match="JSON compliant"):
        write_json(tmp_path / "b.json", float("nan"))
    assert os.listdir(tmp_path) == ["a.json"]


def test_tables_keep_values_types_and_nulls(tmp_path: Path) -> None:
    table = pd.DataFrame({"frame": [1, 2], "x": [0.1, np.nan], "path": pd.Series(["a", None], dtype="str")})
    write_table(tmp_path / "a.parquet", table)
    pd.testing.assert_frame_equal(read_table(tmp_path / "a.parquet"), table)
    write_table(tmp_path / "a.csv", table)
    assert (tmp_path / "a.csv").read_text().splitlines() == ["frame,x,path", "1,0.1,a", "2,,"]


def test_rows_that_are_wanted_are_those_of_the_table(tmp_path: Path, monkeypatch) -> None:
    """In its order and with its types, wherever a piece of it ends."""
    table = pd.DataFrame(
        {"frame": [3, 1, 2, 3, 1], "path": ["a", None, "c", "d", "e"], "flag": [True, False] * 2 + [None]}
    )
    table = table.astype({"path": "str", "flag": "boolean"})
    write_table(tmp_path / "a.parquet", table)
    for rows in (2, 100):
        monkeypatch.setattr(files, "ROWS_AT_A_TIME", rows)
        for wanted in ([3, 1], [2], [9], []):
            expected = read_table(tmp_path / "a.parquet").query("frame in @wanted").reset_index(drop=True)
            pd.testing.assert_frame_equal(read_rows(tmp_path / "a.parquet", "frame", wanted), expected)
    for lost in ("b.parquet", "a.parquet"):
        with pytest.raises(InputError, match=f"{lost}: expected a parquet table with a column camera, found"):
            read_rows(tmp_path / lost, "camera", ["c0"])


def test_groups_of_rows_without_any_wanted_are_not_read(tmp_path: Path, monkeypatch) -> None:
    """Those of a sorted table may be gone."""
    monkeypatch.setattr(files, "ROWS_AT_A_TIME", 100)
    table = pd.DataFrame({"frame": np.repeat(np.arange(50), 20), "x": np.random.default_rng(0).normal(size=1000)})
    path = tmp_path / "a.parquet"
    write_table(path, table)
    content, groups = bytearray(path.read_bytes()), pq.ParquetFile(path).metadata
    for number in (0, 1, 2, 3, 6, 7, 8, 9):
        for column in (groups.row_group(number).column(k) for k in range(2)):
            first = column.dictionary_page_offset or column.data_page_offset
            content[first : first + column.total_compressed_size] = bytes(column.total_compressed_size)
    path.write_bytes(content)
    with pytest.raises(InputError):
        read_table(path)
    expected = table[table.frame.between(21, 29)].reset_index(drop=True)
    pd.testing.assert_frame_equal(read_rows(path, "frame", range(21, 30)), expected)


def test_distinct_rows_are_those_of_the_table(tmp_path: Path, monkeypatch) -> None:
    table = pd.DataFrame({"camera": list("abab" * 3), "flag": [True, False, True, True] * 3, "frame": range(12)})
    table = table.astype({"camera": "str"})
    write_table(tmp_path / "a.parquet", table)
    for rows in (5, 100):
        monkeypatch.setattr(files, "ROWS_AT_A_TIME", rows)
        expected = pd.DataFrame({"camera": list("abb"), "flag": [True, False, True]}).astype({"camera": "str"})
        pd.testing.assert_frame_equal(read_distinct(tmp_path / "a.parquet", ["camera", "flag"]), expected)
    with pytest.raises(InputError, match="expected a parquet table with columns light, found"):
        read_distinct(tmp_path / "a.parquet", ["light"])


def test_arrays_keep_bits_of_any_layout(tmp_path: Path) -> None:
    base = np.random.default_rng(0).normal(size=(4, 6))
    arrays = {"strided": base[::2, ::3], "transposed": base.T, "half": base.astype(np.float16), "scalar": np.array([7])}
    write_arrays(tmp_path / "a.safetensors", arrays, {"unit": "m"})
    read = read_arrays(tmp_path / "a.safetensors")
    assert read.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == array.dtype


@pytest.mark.parametrize("read", [read_json, read_table, read_arrays])
@pytest.mark.parametrize("content", [None, b"", b"\x00\xff no such format"])
def test_unreadable_files_are_named(read, content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "some.file"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"some\.file: expected"):
        read(path)


def test_digest_depends_on_content_alone(tmp_path: Path) -> None:
    content = bytes(range(256)) * 5000
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(content)
    expected = hashlib.blake2b(content, digest_size=16).hexdigest()
    assert digest_file(tmp_path / "a") == digest_file(tmp_path / "b") == digest_bytes(content) == expected
    (tmp_path / "b").write_bytes(content[:-1] + b"\x00")
    assert digest_file(tmp_path / "b") != expected


def test_arrays_are_as_readable_as_any_other_file(tmp_path: Path) -> None:
    """A lab shares its results: no file is for its owner alone unless the umask says so."""
    write_json(tmp_path / "a.json", {})
    write_arrays(tmp_path / "a.safetensors", {"a": np.ones(2)})
    assert (tmp_path / "a.safetensors").stat().st_mode == (tmp_path / "a.json").stat().st_mode


@pytest.mark.parametrize("read", [read_json, read_table, read_arrays])
def test_devices_are_not_read(read) -> None:
    """The endless one would be read until the memory is full."""
    with pytest.raises(InputError, match="/dev/null: expected a file, found a device or a pipe"):
        read(Path("/dev/null"))


LITTLE_MEMORY = """
import resource, sys
import psutil
from pipeline.base.files import read_table
allowed = psutil.Process().memory_info().vms + (int(sys.argv[2]) << 20)
resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))
print(len(read_table(sys.argv[1])))
"""


@pytest.mark.parametrize("mib", [4, 10])
def test_table_is_read_where_no_thread_can_be_started(tmp_path, repo_root, mib):
    """They hold the table, and the stacks, of 8 MiB, of no thread or of one."""
    write_table(tmp_path / "a.parquet", pd.DataFrame({"frame": np.arange(1000), "name": "x"}))
    words = [sys.executable, "-c", LITTLE_MEMORY, str(tmp_path / "a.parquet"), str(mib)]
    done = subprocess.run(words, cwd=repo_root, capture_output=True, text=True, timeout=60)
    assert done.stdout == "1000\n", done.stderr


def test_table_is_what_pandas_writes_and_reads(tmp_path):
    table = pd.DataFrame(
        {"light": ["a", None, "NA"], "frame": [1, 2, 3], "x": [0.1, np.nan, np.inf], "known": [True, False, True],
         "day": pd.to_datetime(["2026-01-01"] * 3), "kind": pd.Categorical(["u", "v", "u"])}
    )  # fmt: skip
    write_table(tmp_path / "ours.parquet", table)
    table.to_parquet(tmp_path / "theirs.parquet", index=False)
    assert (tmp_path / "ours.parquet").read_bytes() == (tmp_path / "theirs.parquet").read_bytes()
    table.set_index("frame").to_parquet(tmp_path / "indexed.parquet")
    for name in ("ours", "indexed"):
        path = tmp_path / f"{name}.parquet"
        pd.testing.assert_frame_equal(read_table(path), pd.read_parquet(path))
