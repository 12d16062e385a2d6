"""Hard cases take down their errors; with --hard-cases FILE they end in a table, printed and written there as csv."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.results.hard_case import HardCase, HardCaseTable

OPTION = "--hard-cases"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, type=Path, metavar="FILE", help="print the table of hard cases, and write it as csv")


def pytest_configure(config: pytest.Config) -> None:
    # Not known if pytest was given a folder above this one. Processes of pytest-xdist leave the table to their parent.
    path = config.getoption(OPTION, None)
    if path is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(HardCaseTable(path))


@pytest.fixture
def case(record_property: Callable[[str, float | str], None]) -> HardCase:
    """The row of the table that this test fills."""
    return HardCase(record_property)
