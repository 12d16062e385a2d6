"""While a stage imports, garbage collection pauses and Ctrl-C ends it at once; not otherwise."""

from __future__ import annotations

import gc
import signal
import subprocess
import sys

import pytest

from pipeline.base.start_up import end_by_interrupts, pause_collection, resume_collection


class Node:
    """An object that the collector looks at."""


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
    kept = [Node() for _ in range(1000)]
    before = gc.get_freeze_count()
    pause_collection()
    assert gc.isenabled()
    resume_collection()
    # What is frozen may die, from one line to the next; freezing would have added what is kept here.
    assert gc.get_freeze_count() < before + len(kept)


@pytest.mark.parametrize(
    ("started", "before", "after"),
    [
        ("-m", signal.default_int_handler, signal.SIG_DFL),
        ("-m", signal.SIG_IGN, signal.SIG_IGN),
        ("stage.py", signal.default_int_handler, signal.default_int_handler),
    ],
)
def test_interrupts_while_importing_leave_no_traceback(monkeypatch, started, before, after):
    monkeypatch.setattr(sys, "argv", [started])
    kept = signal.signal(signal.SIGINT, before)
    try:
        end_by_interrupts()
        assert signal.getsignal(signal.SIGINT) == after
    finally:
        signal.signal(signal.SIGINT, kept)
