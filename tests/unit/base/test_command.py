"""How a stage's command ends: by what its `run` raises."""

import signal
import sys

import pytest

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.stopping import Stopped


@pytest.mark.parametrize(
    ("raised", "code", "printed"),
    [
        (InputError("a.csv: expected rows"), 1, "error: a.csv: expected rows\n"),
        (Stopped("stopped after 3 steps", signal.SIGTERM), 143, "stopped after 3 steps\n"),
        (Stopped("stopped after 3 steps", signal.SIGINT), 130, "stopped after 3 steps\n"),
    ],
)
def test_says_why_and_exits_with_a_code(monkeypatch, capsys, raised, code, printed):
    def run() -> None:
        raise raised

    monkeypatch.setattr(sys, "argv", ["stage"])
    with pytest.raises(SystemExit) as ended:
        run_as_command(run)
    assert ended.value.code == code
    assert capsys.readouterr().err == printed


@pytest.mark.parametrize("words", [["--promise", "a=b"], ["--promise=a=b"], ["--estimate", "a=b"]])
def test_flag_under_its_old_name_is_understood(monkeypatch, words):
    seen = []

    def run(*, estimate: str) -> None:
        """Note it.

        Args:
            estimate: any text.
        """
        seen.append(estimate)

    monkeypatch.setattr(sys, "argv", ["stage", *words])
    run_as_command(run, renamed={"--promise": "--estimate"})
    assert seen == ["a=b"]
