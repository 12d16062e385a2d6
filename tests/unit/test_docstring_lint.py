"""The lint of first sentences finds each kind of defect and nothing else."""

from __future__ import annotations

import importlib.util
import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def lint(repo_root):
    spec = importlib.util.spec_from_file_location("lint_docstrings", repo_root / ".ci/lint_docstrings.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


NINETY = "A" + "b" * 88 + "."

GOOD = [
    "Camera poses of a rig.",
    "Turn a stage's `run` into its command line.\n\n    Args:\n        run: the stage.\n    ",
    NINETY,
    "Radiance at a texel, e.g. of skin, by Eq. 3 of RGCA. What follows may ask: how?",
    "Settings of a stage, in three groups:\n\n    - cameras\n    ",
    "Files named `a.b.csv` (as Snakemake has them.)",
    "Points p, q, ... of a line. More.",
    "However often a camera moved: its poses.",
]

BAD = {
    "A" + "b" * 89 + ".": "91 letters",
    "Camera poses of a rig, which is\n    a set of cameras.": "first line",
    "\n    Camera poses.\n    ": "first line",
    "Camera poses of a rig": "full stop",
    "Camera poses of a rig\n\n    And more.\n    ": "full stop",
    "Raises:\n    InputError: if the file is missing.\n    ": "starts with a section",
    **{f"{word} a camera sees.": f"starts with '{word}'" for word in
       ("What", "Which", "Where", "Those", "How", "When", "Whether", "If", "Why", "Who")},
}  # fmt: skip


@pytest.mark.parametrize("text", GOOD)
def test_good_first_sentence_passes(lint, text):
    assert len(NINETY) == 90
    assert lint.complaints(text) == []


@pytest.mark.parametrize(("text", "complaint"), BAD.items())
def test_bad_first_sentence_has_one_complaint(lint, text, complaint):
    (found,) = lint.complaints(text)
    assert complaint in found


def test_public_names_are_checked_with_their_lines(lint):
    source = '''"""What a module is."""

class Rig:
    """Which cameras."""

    def turn(self):
        """How it turns."""

        def inner():
            """Whether anything is checked in here."""

    def _hidden(self):
        """If it is private."""

class _Private:
    """Why not."""

    def method(self):
        """Who asks."""

async def later():
    """When it is."""

def undocumented():
    return 1
'''
    assert [line for line, _ in lint.defects(source)] == [1, 4, 7, 22]
    assert [message.split(":")[0] for _, message in lint.defects(source)] == ["module", "Rig", "turn", "later"]


def test_command_reports_given_files_and_fails(repo_root, tmp_path):
    good, bad = tmp_path / "good.py", tmp_path / "bad.py"
    good.write_text('"""A good module."""\n')
    bad.write_text('"""A module."""\n\n\ndef f():\n    """Where it is"""\n')
    command = [sys.executable, repo_root / ".ci/lint_docstrings.py"]
    passed = subprocess.run([*command, good], capture_output=True, text=True)
    assert (passed.returncode, passed.stdout) == (0, "")
    failed = subprocess.run([*command, good, bad], capture_output=True, text=True)
    assert failed.returncode == 1
    assert [line.split(": ")[0] for line in failed.stdout.splitlines()] == [f"{bad}:5"] * 2
    counted = subprocess.run([*command, "--summary", good, bad], capture_output=True, text=True)
    assert counted.stdout.splitlines()[-1].split() == ["2", "in", "all"]
