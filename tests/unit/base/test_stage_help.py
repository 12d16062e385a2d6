"""Help of a stage is that of its `run`, and comes before its libraries."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys

import pytest

from pipeline import STAGES
from pipeline.base.command import run_as_command
from pipeline.base.stage_help import answer_help, signature_alone

WORKED_WITH = {"cv2", "embreex", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "scipy", "torch", "trimesh"}
"""Libraries that take a tenth of a second and more to import."""


def printed(capsys, monkeypatch, run, program):
    monkeypatch.setattr(sys, "argv", ["stage", "--help"])
    with pytest.raises(SystemExit) as ended:
        run_as_command(run, program=program)
    assert ended.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("stage", STAGES)
def test_help_imports_no_library_of_the_work(stage, repo_root):
    words = [sys.executable, "-X", "importtime", "-m", f"pipeline.stages.{stage}", "--help"]
    done = subprocess.run(words, cwd=repo_root, capture_output=True, text=True, check=True)
    imported = set(re.findall(r"^import time: .*\| +(\S+)$", done.stderr, re.MULTILINE))
    assert f"usage: {stage}.py" in done.stdout
    assert {"tyro", "pipeline.base.command"} <= imported
    assert not {name.partition(".")[0] for name in imported} & WORKED_WITH


@pytest.mark.parametrize("stage", STAGES)
def test_help_from_the_signature_alone_is_that_of_the_stage(stage, repo_root, capsys, monkeypatch):
    run = importlib.import_module(f"pipeline.stages.{stage}").run
    alone = signature_alone(repo_root / f"pipeline/stages/{stage}.py")
    text = printed(capsys, monkeypatch, run, f"{stage}.py")
    assert "--" in text
    assert printed(capsys, monkeypatch, alone, f"{stage}.py") == text


@pytest.mark.parametrize(
    ("argv", "started"),
    [
        (["-m", "--out", "a"], ["python", "-m", "pipeline.stages.work", "--out", "a"]),
        (["work.py", "--help"], ["python", "work.py", "--help"]),
        (["-m", "--help"], ["python", "-m", "pipeline.stages.absent", "--help"]),
    ],
    ids=["no help asked", "no module", "no such stage"],
)
def test_anything_but_help_of_a_stage_goes_its_way(tmp_path, monkeypatch, argv, started):
    (tmp_path / "work.py").write_text("raise ValueError('must not run')\n")
    monkeypatch.setattr(sys, "argv", argv)
    monkeypatch.setattr(sys, "orig_argv", started)
    assert answer_help(tmp_path) is None


@pytest.mark.parametrize("words", [["-m", "stages.work"], ["-mstages.work"], ["-um", "stages.work"]])
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_stage_is_found_however_python_is_told(tmp_path, monkeypatch, capsys, words, flag):
    (tmp_path / "work.py").write_text(
        "from pathlib import Path\nimport not_installed\n\n\ndef run(*, out: Path) -> None:\n"
        '    """Do the work.\n\n    Args:\n        out: the folder.\n    """\n    not_installed.work(out)\n'
    )
    monkeypatch.setattr(sys, "argv", ["-m", flag])
    monkeypatch.setattr(sys, "orig_argv", ["python", *words, flag])
    with pytest.raises(SystemExit) as ended:
        answer_help(tmp_path)
    assert ended.value.code == 0
    assert "Do the work." in (text := capsys.readouterr().out) and "usage: work.py" in text
