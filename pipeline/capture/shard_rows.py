"""Rows of Arrow IPC files, one record batch each, read by memory map and then forgotten."""

from __future__ import annotations

import mmap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.base.errors import InputError
from pipeline.base.files import written_whole


class ShardRows:
    """Random access to rows of several shards; can be sent to a spawned process.

    Args:
        paths: files, or folders of `*.arrow`, which are taken by sorted path.
        schema: columns that each of them has to have.

    Raises:
        InputError: if there is no shard, or a file is another thing.
    """

    def __init__(self, paths: Iterable[Path], schema: pa.Schema) -> None:
        self.paths, self.schema = tuple(file for path in paths for file in _shard_files(Path(path))), schema
        self._maps = [_mapped(file) for file in self.paths]
        self._readers = [_open(file, held, schema) for file, held in zip(self.paths, self._maps, strict=True)]
        self._starts = np.cumsum([0] + [reader.num_record_batches for reader in self._readers])

    def __len__(self) -> int:
        return int(self._starts[-1])

    def batch(self, index: int) -> pa.RecordBatch:
        """One row. Unless it is compressed, its values stay in the file until they are looked at."""
        shard = int(np.searchsorted(self._starts, index, side="right")) - 1
        return self._readers[shard].get_batch(index - int(self._starts[shard]))

    def columns(self, names: Sequence[str]) -> pa.Table:
        """Some columns of all rows, a copy of their own; no other is read or decompressed.

        A file at a time: a row takes some 30 kB before it is joined with the others.
        """
        chosen = pa.ipc.IpcReadOptions(included_fields=[self.schema.get_field_index(name) for name in names])
        tables = []
        for held in self._maps:
            rows = pa.ipc.open_file(pa.BufferReader(pa.py_buffer(held)), options=chosen).read_all()
            tables.append(rows.combine_chunks())
            held.madvise(mmap.MADV_DONTNEED)
        return pa.concat_tables(tables)

    def forget(self) -> None:
        """Give back the memory of what was looked at.

        Pages of a mapped file count as the process' own from the first look on: after an epoch, that would be all. They
        stay in the system's cache, as far as it has room, and a batch that is still at hand is read anew from there.
        """
        for held in self._maps:
            held.madvise(mmap.MADV_DONTNEED)


def write_rows(path: Path, schema: pa.Schema, rows: Iterable[dict], compression: str | None = None) -> int:
    """Write a shard, a row at a time; returns the number of rows."""
    count = 0
    with rows_written(path, schema, compression) as write:
        for row in rows:
            write(row)
            count += 1
    return count


@contextmanager
def rows_written(path: Path, schema: pa.Schema, compression: str | None = None) -> Iterator[Callable[[dict], None]]:
    """Open a shard, for what writes a row to it; the file is there once all are written."""
    options = pa.ipc.IpcWriteOptions(compression=compression)
    with (
        written_whole(path) as temporary,
        pa.OSFile(str(temporary), "wb") as sink,
        pa.ipc.new_file(sink, schema, options=options) as out,
    ):
        yield lambda row: out.write_batch(pa.RecordBatch.from_pylist([row], schema))


def _shard_files(path: Path) -> list[Path]:
    files = sorted(path.glob("[!.]*.arrow")) if path.is_dir() else [path]
    if not files:
        raise InputError(f"{path}: expected shards *.arrow, found none; run pack_shards")
    return files


def _mapped(path: Path) -> mmap.mmap:
    try:
        with open(path, "rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:  # ValueError: the file is empty.
        raise InputError(f"{path}: expected an Arrow IPC file, found: {error}") from error


def _open(path: Path, held: mmap.mmap, schema: pa.Schema) -> pa.RecordBatchFileReader:
    try:
        reader = pa.ipc.open_file(pa.BufferReader(pa.py_buffer(held)))
    except (OSError, pa.ArrowInvalid) as error:
        raise InputError(f"{path}: expected an Arrow IPC file, found: {error}") from error
    if not reader.schema.equals(schema):
        raise InputError(f"{path}: expected columns {schema.names}, found {reader.schema.names}; run pack_shards again")
    return reader
