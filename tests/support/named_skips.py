"""Skipped tests: a run fails if one has no reason that lies in the machine.

A package that cannot be imported is none: a dependency that is broken would else take its tests with it, and nobody
would look.
"""

from __future__ import annotations

import re

import pytest

REASONS = (
    "no Chromium", "no node:", "no viewer/node_modules", "no splat-transform", "no LLVM library", "no strace",
    "strace cannot trace here", "no git repository", "no CUDA device", "no gsplat", "the Python package bpy",
    "takes minutes: make (slurm|storage)-test", "no .venv-detect", "no .*(munge|slurm|moto)", "needs captures/",
    "needs .*beside the repository", "a service of Linux",
)  # fmt: skip
"""How reasons begin that a machine may have: programs, hardware and recordings that no package brings."""


def is_known(reason: str) -> bool:
    """Tell whether a test may be skipped for this reason."""
    text = reason.removeprefix("Skipped: ")
    return any(re.match(known, text) for known in REASONS)


class NamedSkips:
    """Plugin of pytest that gathers the reasons and ends the run with an error if one is not known."""

    def __init__(self) -> None:
        self.unknown: list[str] = []

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Take a module that was skipped as a whole."""
        self._take(report)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Take a test; those expected to fail are none that were skipped."""
        if not hasattr(report, "wasxfail"):
            self._take(report)

    def _take(self, report: pytest.CollectReport | pytest.TestReport) -> None:
        if report.skipped and isinstance(report.longrepr, (tuple, list)) and not is_known(report.longrepr[2]):
            self.unknown.append(f"{report.nodeid}: {report.longrepr[2]}")

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run that else passed."""
        if self.unknown and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Name what was skipped without a reason."""
        for line in sorted(set(self.unknown)):
            terminalreporter.write_line(f"skipped for a reason that is none of tests/support/named_skips.py: {line}")
