"""Reading parquet tables of a capture with typed columns."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pandas as pd
import pyarrow

from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_parquet as read_whole
from pipeline.capture.index.csv_tables import DTYPES, Kind
from pipeline.capture.paths import locate


def read_parquet(root: Path, path: str, columns: Mapping[str, Kind], complaints: Complaints) -> pd.DataFrame | None:
    """Read the wanted columns of a parquet table; None, and a complaint, if that fails."""
    try:
        table = read_whole(locate(root, path))
    except (InputError, pyarrow.ArrowException, OSError, ValueError) as error:
        complaints.add(path, "table", expected="a parquet table", found=str(error))
        return None
    if missing := [column for column in columns if column not in table.columns]:
        complaints.add(path, "columns", expected=", ".join(columns), found=f"no {', '.join(missing)}")
        return None
    try:
        return table[list(columns)].astype({column: DTYPES[kind] for column, kind in columns.items()})
    except (TypeError, ValueError) as error:
        numbers = [column for column, kind in columns.items() if kind in ("whole", "number")]
        complaints.add(path, "columns", expected=f"numbers in {', '.join(numbers)}", found=str(error))
        return None
