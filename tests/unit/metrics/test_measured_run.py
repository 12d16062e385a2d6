"""Tiny programs whose time, memory and failures are known."""

from __future__ import annotations

import sys

import pytest

from pipeline.base.errors import InputError
from pipeline.metrics.measured_run import LAST_LINES, run_measured


def python(code: str) -> list[str]:
    return [sys.executable, "-S", "-c", code]


BARE_MB = 40
"""More than a bare Python holds (10 MiB), less than this test's process (over 100 MiB)."""


def test_memory_is_the_programs_own() -> None:
    small = run_measured(python("pass"))
    assert 1 < small.peak_mb < BARE_MB
    large = run_measured(python("held = b'x' * (200 * 2**20); del held"))
    assert 200 < large.peak_mb < 200 + BARE_MB


def test_wall_time_counts_waiting_and_processor_time_does_not() -> None:
    done = run_measured(python("import time; time.sleep(0.5)"))
    assert done.seconds > 0.5 > done.cpu_seconds > 0


def test_success_needs_no_word() -> None:
    done = run_measured(python("pass"))
    assert done.require_success() is done
    assert (done.code, done.last_lines) == (0, "")


def test_failure_shows_the_last_lines_and_the_command() -> None:
    code = "import sys\nfor i in range(100): print(f'line {i}', flush=True)\nsys.exit(3)"
    done = run_measured(python(code))
    with pytest.raises(InputError, match="expected exit code 0, found 3") as error:
        done.require_success()
    assert str(error.value).endswith("\n".join(f"line {i}" for i in range(100 - LAST_LINES, 100)))
    assert sys.executable in str(error.value)


def test_killed_program_is_a_failure() -> None:
    done = run_measured(python("import os; os.kill(os.getpid(), 9)"))
    assert done.code == -9
    assert not done.refused


def test_program_that_does_not_exist(tmp_path) -> None:
    with pytest.raises(InputError, match="nothing: expected a program, found"):
        run_measured([str(tmp_path / "nothing")])


@pytest.mark.parametrize(
    ("code", "refused"),
    [
        ("import sys; sys.exit('error: frames.csv: expected numbers, found none')", True),
        ("import sys; sys.exit('error: tables: 99 problems' + 99 * '\\n  frames.csv: expected numbers')", True),
        ("raise ValueError('error: a defect')", False),
        ("import sys; sys.exit(1)", False),
        ("print('error: ')", False),
    ],
)
def test_refusing_is_not_breaking(code, refused) -> None:
    assert run_measured(python(code)).refused is refused
