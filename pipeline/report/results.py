"""Results of a subject that the report reads; some may not be there."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table
from pipeline.config.write_report import WriteReport
from pipeline.report.pictures import Pictures
from pipeline.report.requests import Asked

NAMES = ("subject", "variant", "dial", "setting")
"""Columns of names, which may look like numbers."""


@dataclass(frozen=True)
class Results:
    """A subject's results.

    Attributes:
        folder: results/SUBJECT.
        project: folder results, for what belongs to no subject: hard_cases.csv, effects_comparison.csv, scaling/; none
            of them need be there.
        changed_settings: {stage: {setting: value}} and what else differs from the defaults.
        requests: stage -> what its jobs ask for.
    """

    folder: Path
    project: Path
    changed_settings: dict
    settings: WriteReport
    pictures: Pictures
    requests: dict[str, Asked] = field(default_factory=dict)

    @cached_property
    def capture(self) -> dict:
        """capture.json of index_capture."""
        return read_json(self.folder / "index/capture.json")

    @property
    def hard_cases(self) -> Path:
        """The csv of the hard cases."""
        return self.project / "hard_cases.csv"

    @property
    def subject(self) -> str:
        """Name of the subject."""
        return self.capture["subject"]

    def make(self, file: str) -> str:
        """The command that makes a file of the results."""
        return f"make results/{self.subject}/{file}"

    def table(self, name: str) -> pd.DataFrame:
        """A parquet table of the results."""
        return read_table(self.folder / name)

    def csv(self, name: str) -> pd.DataFrame:
        """A csv table of the results."""
        return read_csv(self.folder / name)


def read_csv(path: Path) -> pd.DataFrame:
    """Read a csv table.

    Raises:
        InputError: if the file is missing or not a csv table.
    """
    try:
        return pd.read_csv(path, dtype=dict.fromkeys(NAMES, str))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected a csv table, found: {error}") from error


def missing_files(folder: Path, files: Iterable[str]) -> list[str]:
    """Files of a folder that are not there."""
    return [file for file in files if not (folder / file).exists()]
