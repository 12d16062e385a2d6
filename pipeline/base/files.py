"""Reading and writing the files between stages: whole or not at all, and never with pickle."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.compute
import pyarrow.parquet as pq
import safetensors.numpy

from pipeline.base.errors import InputError
from pipeline.base.whole_files import written_whole

ROWS_AT_A_TIME = 1 << 16
"""Of a table of which some rows are wanted: some 10 MB."""


def write_json(path: Path, content: Any) -> None:
    """Write `content` as indented JSON; floats keep all their digits."""
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        InputError: the file is missing, no plain file, or not JSON.
    """
    _require_plain(path)
    try:
        return json.loads(Path(path).read_text())
    except (OSError, ValueError) as error:  # ValueError: not JSON, or not even text.
        raise InputError(f"{path}: expected a JSON file, found: {error}") from error


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a parquet (or, by suffix, csv) table without its index."""
    with written_whole(path) as temporary:
        if Path(path).suffix == ".csv":
            table.to_csv(temporary, index=False)
        else:
            # On this thread alone, for the reason that `read_parquet` has.
            whole = pyarrow.Table.from_pandas(table, preserve_index=False, nthreads=1)
            pq.write_table(whole, temporary, row_group_size=ROWS_AT_A_TIME)


def read_table(path: Path) -> pd.DataFrame:
    """Read a parquet table.

    Raises:
        InputError: the file is missing, no plain file, or not a parquet table.
    """
    _require_plain(path)
    try:
        return read_parquet(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a parquet table, found: {error}") from error


def read_rows(path: Path, column: str, values: Collection[Any]) -> pd.DataFrame:
    """Read the rows of a parquet table whose column has one of these values.

    Few others are in memory at a time, and groups of rows without any are not read at all: of a table that is sorted by
    the column, hardly more than what is wanted.

    Raises:
        InputError: the file is missing, no plain file, or not a parquet table with such a column.
    """
    _require_plain(path)
    try:
        with pq.ParquetFile(path, pre_buffer=False) as file:
            wanted = pyarrow.array(list(values), file.schema_arrow.field(column).type)
            groups = _groups_with(file, column, values)
            batches = file.iter_batches(ROWS_AT_A_TIME, row_groups=groups, use_threads=False) if groups else ()
            kept = [rows.filter(pyarrow.compute.is_in(rows[column], wanted)) for rows in batches]
            return pyarrow.Table.from_batches(kept, file.schema_arrow).to_pandas(use_threads=False)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: expected a parquet table with a column {column}, found: {error}") from error


def _groups_with(file: pq.ParquetFile, column: str, values: Collection[Any]) -> list[int]:
    """Groups of rows in which one of these values may be, by the least and the largest that they say they hold."""
    place, found = file.schema.names.index(column), []
    for number in range(file.num_row_groups):
        known = file.metadata.row_group(number).column(place).statistics
        if known is None or not known.has_min_max or any(known.min <= value <= known.max for value in values):
            found.append(number)
    return found


def read_distinct(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """Read the different rows that a parquet table has in some columns.

    Few others are in memory at a time.

    Raises:
        InputError: the file is missing, no plain file, or not a parquet table with such columns.
    """
    _require_plain(path)
    try:
        with pq.ParquetFile(path, pre_buffer=False) as file:
            found = file.schema_arrow.empty_table().select(list(columns)).to_pandas()
            for rows in file.iter_batches(ROWS_AT_A_TIME, columns=list(columns), use_threads=False):
                found = pd.concat([found, rows.to_pandas(use_threads=False)], ignore_index=True).drop_duplicates()
            return found.reset_index(drop=True)
    except (OSError, ValueError, KeyError) as error:
        raise InputError(
            f"{path}: expected a parquet table with columns {', '.join(columns)}, found: {error}"
        ) from error


def read_parquet(path: Path) -> pd.DataFrame:
    """Read a parquet table on this thread alone.

    `pandas.read_parquet` hands the file to threads of Arrow, and waits for ever if the system refuses one of them its
    stack, as it does when memory is short.

    Raises:
        OSError, ValueError, pyarrow.ArrowException: it cannot be read.
    """
    with pq.ParquetFile(path, pre_buffer=False) as file:
        return file.read(use_threads=False).to_pandas(use_threads=False)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str] | None = None) -> None:
    """Write named arrays, and optional text metadata, as one safetensors file."""
    contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    with written_whole(path) as temporary:
        # Not save_file, which makes files that only their owner can read, whatever the umask.
        temporary.write_bytes(safetensors.numpy.save(contiguous, metadata=dict(metadata or {})))


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read the named arrays of a safetensors file.

    Raises:
        InputError: the file is missing, no plain file, or not safetensors.
    """
    _require_plain(path)
    try:
        return safetensors.numpy.load_file(path)
    except (OSError, safetensors.SafetensorError) as error:
        raise InputError(f"{path}: expected a safetensors file, found: {error}") from error


def _require_plain(path: Path) -> None:
    """Refuse devices and pipes: they may be read for ever."""
    if (path := Path(path)).exists() and not path.is_file():
        raise InputError(f"{path}: expected a file, found {'a folder' if path.is_dir() else 'a device or a pipe'}")


def digest_file(path: Path) -> str:
    """Hexadecimal BLAKE2b-128 of a file's bytes. Equal digests mean equal content in this project."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, _new_digest).hexdigest()


def digest_bytes(content: bytes) -> str:
    """Same digest as `digest_file`, of a file that is already in memory."""
    digest = _new_digest()
    digest.update(content)
    return digest.hexdigest()


def _new_digest() -> hashlib.blake2b:
    return hashlib.blake2b(digest_size=16)
