"""One run of a program: its time, its memory, and what it printed if it failed."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.metrics import timed_child

LAST_LINES = 12
"""Lines of a failed program's output that are shown: an error with its place, not its whole log."""


@dataclass(frozen=True)
class MeasuredRun:
    """A program that ran to its end.

    Attributes:
        command: its path and arguments.
        code: exit code; negative: the signal that ended it.
        seconds: wall time from its start to its end, so with the interpreter's start and imports.
        cpu_seconds: of all its threads and of the processes it waited for; other programs hardly change it.
        peak_mb: largest resident memory [MiB]: its own or that of one process it waited for, whichever is more.
        refused: it is a stage that ended with an `InputError`: it did not break, it will not have its input.
        last_lines: the end of what it printed.
    """

    command: Sequence[str]
    code: int
    seconds: float
    cpu_seconds: float
    peak_mb: float
    refused: bool
    last_lines: str

    def require_success(self) -> MeasuredRun:
        """Itself.

        Raises:
            InputError: if the program failed, with its last lines.
        """
        if self.code != 0:
            said = self.last_lines or "nothing printed"
            raise InputError(f"{' '.join(self.command)}: expected exit code 0, found {self.code}:\n{said}")
        return self


def run_measured(command: Sequence[str]) -> MeasuredRun:
    """Run a program to its end; its output is kept from the terminal.

    Args:
        command: path of the program, then its arguments.

    Raises:
        InputError: if there is no such program.
    """
    with tempfile.TemporaryDirectory(prefix="measured_run_") as folder:
        printed, report = Path(folder, "printed"), Path(folder, "report.json")
        # Isolated and without site-packages: the launcher stays small. The program gets the environment as it is.
        launcher = [sys.executable, "-I", "-S", timed_child.__file__, str(report)]
        with printed.open("wb") as file:
            subprocess.run([*launcher, *command], stdout=file, stderr=subprocess.STDOUT, check=False)
        lines = printed.read_text(errors="replace").splitlines()
        last_lines = "\n".join(lines[-LAST_LINES:])
        if not report.exists():
            raise InputError(f"{command[0]}: expected a program, found: {last_lines}")
        measured = read_json(report)
    said_error = any(line.startswith("error: ") for line in lines)
    broke = any(line.startswith("Traceback (most recent call last)") for line in lines)
    refused = measured["code"] == 1 and said_error and not broke
    return MeasuredRun(list(command), **measured, refused=refused, last_lines=last_lines)
