"""Tables that are larger than memory: read, brought into order and written piece by piece."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet as pq

from pipeline.base.files import ROWS_AT_A_TIME
from pipeline.base.whole_files import written_whole

MOST_ROWS = 1 << 19
"""That wait in memory while a table is brought into order, and that are read of it at a time: some 50 MB of keypoints,
and a few times as much while they are sorted."""

READ_BYTES = 1 << 20
"""Of a column that are read from disk at a time: some programs write all rows as one group."""


def read_pieces(path: Path, columns: Sequence[str]) -> Iterator[pd.DataFrame]:
    """Read columns of a parquet table a piece of rows at a time.

    Of a table without rows there is one piece, which has none.

    Raises:
        OSError, ValueError, pyarrow.ArrowException: it cannot be read.
    """
    with pq.ParquetFile(path, pre_buffer=False, buffer_size=READ_BYTES) as file:
        if file.metadata.num_rows == 0:
            yield file.schema_arrow.empty_table().select(list(columns)).to_pandas(use_threads=False)
        for rows in file.iter_batches(ROWS_AT_A_TIME, columns=list(columns), use_threads=False):
            yield rows.to_pandas(use_threads=False)


class PieceWriter:
    """A parquet table that is written as it is made.

    The file has the bytes that `write_table` gives of all pieces together.

    Attributes:
        rows: that were added.
    """

    def __init__(self, path: Path) -> None:
        self.rows = 0
        self._path = path
        self._waiting: list[pyarrow.Table] = []
        self._file: pq.ParquetWriter | None = None

    def add(self, piece: pd.DataFrame) -> None:
        """Append rows; all pieces have the columns and types of the first."""
        self._waiting.append(pyarrow.Table.from_pandas(piece, preserve_index=False, nthreads=1))
        self.rows += len(piece)
        if sum(map(len, self._waiting)) >= ROWS_AT_A_TIME:
            self._write(whole_groups=True)

    def finish(self) -> None:
        """Write what is left."""
        if self._file is None or any(map(len, self._waiting)):
            self._write(whole_groups=False)

    def close(self) -> None:
        """Close the file, whether it is whole or not."""
        if self._file is not None:
            self._file.close()

    def _write(self, whole_groups: bool) -> None:
        # In one chunk: where chunks end, pages of a column would end too.
        rows = pyarrow.concat_tables(self._waiting).combine_chunks()
        count = len(rows) // ROWS_AT_A_TIME * ROWS_AT_A_TIME if whole_groups else len(rows)
        if self._file is None:
            self._file = pq.ParquetWriter(self._path, rows.schema)
        self._file.write_table(rows[:count], row_group_size=ROWS_AT_A_TIME)
        self._waiting = [rows[count:]]


@contextmanager
def written_pieces(path: Path) -> Iterator[PieceWriter]:
    """Yield a writer of a parquet table, which is there only once it is whole.

    At least one piece has to be added.
    """
    with written_whole(path) as temporary:
        writer = PieceWriter(temporary)
        try:
            yield writer
            writer.finish()
        finally:
            writer.close()


class RangedRows:
    """Rows that come in any order, and are read again by ranges of a column.

    Those of a range come in the order in which they were added, with their index. No more than `MOST_ROWS` wait in
    memory; the others do in a file per range.
    """

    def __init__(self, folder: Path, column: str, starts: Sequence[int]) -> None:
        """Begin without rows.

        Args:
            folder: for the files, which are removed as they are read.
            starts: least value of each range but the first, ascending.
        """
        self._folder, self._column, self._starts = folder, column, np.array(starts, np.int64)
        self._waiting: dict[int, list[pyarrow.Table]] = {}
        self._count = 0

    def add(self, rows: pd.DataFrame) -> None:
        """Add rows with the columns and types of all others."""
        numbers = np.searchsorted(self._starts, rows[self._column].to_numpy(), side="right")
        order = np.argsort(numbers, kind="stable")
        table = pyarrow.Table.from_pandas(rows.iloc[order], preserve_index=True, nthreads=1)
        found, firsts, counts = np.unique(numbers[order], return_index=True, return_counts=True)
        for number, first, count in zip(found.tolist(), firsts.tolist(), counts.tolist(), strict=True):
            self._waiting.setdefault(number, []).append(table.slice(first, count))
        self._count += len(rows)
        if self._count > MOST_ROWS:
            self._spill()

    def ranges(self) -> Iterator[pd.DataFrame]:
        """Yield the rows of each range that has any, once."""
        for number in range(len(self._starts) + 1):
            if self._file(number).is_file() or number in self._waiting:
                yield self._range(number)

    def _range(self, number: int) -> pd.DataFrame:
        tables = [*self._spilled(number), *self._waiting.pop(number, [])]
        return pyarrow.concat_tables(tables).to_pandas(use_threads=False)

    def _file(self, number: int) -> Path:
        return self._folder / f"{number:06d}.arrows"

    def _spill(self) -> None:
        """Append a stream of rows to the file of each range: no file stays open, of however many ranges."""
        self._folder.mkdir(parents=True, exist_ok=True)
        options = pyarrow.ipc.IpcWriteOptions(compression="lz4")
        for number, tables in self._waiting.items():
            with (
                open(self._file(number), "ab") as file,
                pyarrow.ipc.new_stream(file, tables[0].schema, options=options) as stream,
            ):
                for table in tables:
                    stream.write_table(table)
        self._waiting, self._count = {}, 0

    def _spilled(self, number: int) -> Iterator[pyarrow.Table]:
        path = self._file(number)
        if path.is_file():
            with open(path, "rb") as file:
                while file.tell() < path.stat().st_size:
                    yield pyarrow.ipc.open_stream(file).read_all()
            path.unlink()


def range_starts(counts: Mapping[int, int], most: int) -> list[int]:
    """Least value of each range but the first, for ranges of few rows.

    Args:
        counts: rows by value.
        most: rows of a range, unless it is of a single value.
    """
    starts, inside = [], 0
    for value, count in sorted(counts.items()):
        if inside and inside + count > most:
            starts.append(value)
            inside = 0
        inside += count
    return starts
