"""Hard cases take down their errors; with --hard-cases FILE they end in a table, printed and written there as csv."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.hard_case import PROPERTY, HardCase, HardCaseTable

OPTION = "--hard-cases"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(OPTION, type=Path, metavar="FILE", help="print the table of hard cases, and write it as csv")


def pytest_configure(config: pytest.Config) -> None:
    # Not known where pytest came by these tests from a folder above; processes of pytest-xdist leave it to their parent.
    path = config.getoption(OPTION, None)
    if path is not None and not hasattr(config, "workerinput"):
        config.pluginmanager.register(HardCaseTable(path))


@pytest.fixture
def case(request: pytest.FixtureRequest) -> HardCase:
    """The row of the table that this test fills."""
    case = HardCase()
    request.node.user_properties.append((PROPERTY, case.row))
    return case
