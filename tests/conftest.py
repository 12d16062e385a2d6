"""Fixtures and settings of all tests."""

from __future__ import annotations

import atexit
import gc
import os
from pathlib import Path

import matplotlib
import pytest
from hypothesis import settings

from tests.support import first_calls
from tests.support.named_skips import NamedSkips
from tests.support.network import guard
from tests.support.order import longest_first

matplotlib.use("Agg")

# Runs are repeatable, and a busy machine fails no test.
settings.register_profile("project", deadline=None, derandomize=True, print_blob=False)
settings.load_profile("project")

# No test talks to another machine, nor does what it starts: docs/security.md.
guard.install()

# Importing all tests and what they test makes a million objects that stay: nobody looks through them while they come,
# nor ever again.
gc.disable()
atexit.register(gc.freeze)

# Nobody pulls the plug on a test: its thousands of files need not wait for the disk.
os.fsync = lambda descriptor: None

# Stages that tests start as processes share the cores with the tests.
os.environ.setdefault("OMP_NUM_THREADS", "2")


def pytest_configure(config: pytest.Config) -> None:
    """Have the process that sees all results look why tests are skipped."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(NamedSkips())


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """In a process of pytest-xdist, put the files first that take longest; alone, the quick ones stay in front."""
    if hasattr(config, "workerinput"):
        items[:] = longest_first(items)


def pytest_collection_finish() -> None:
    """Collect what tests leave behind, not after each 700 objects: that took 3 % of all tests' time."""
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Each file has its own first calls."""
    first_calls.in_file(item.path)


@pytest.fixture(scope="session")
def repo_root() -> Path:
    """The folder that holds the Snakefile."""
    return Path(__file__).resolve().parents[1]
