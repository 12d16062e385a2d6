"""Garbage collection pauses while a stage imports, and only then."""

from __future__ import annotations

import gc
import subprocess
import sys

import pytest

from pipeline.base.start_up import pause_collection, resume_collection

SCRIPT = """
import gc, sys
from pipeline.base.start_up import pause_collection, resume_collection
sys.argv[0] = "-m"
pause_collection()
assert not gc.isenabled() and gc.get_freeze_count() == 0
resume_collection()
assert gc.isenabled() and gc.get_freeze_count() > 0
class Node:
    def __del__(self):
        print("collected")
node = Node()
node.itself = node
del node
gc.collect()
print("done")
"""


def test_what_comes_after_the_imports_is_collected(repo_root):
    words = [sys.executable, "-c", SCRIPT]
    done = subprocess.run(words, cwd=repo_root, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["collected", "done"]


@pytest.mark.parametrize("started", ["stage.py", "-c", ""])
def test_nothing_changes_where_python_was_started_otherwise(monkeypatch, started):
    monkeypatch.setattr(sys, "argv", [started])
    before = gc.get_freeze_count()
    pause_collection()
    assert gc.isenabled()
    resume_collection()
    assert gc.get_freeze_count() == before
