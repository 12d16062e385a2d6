"""Progress that says how much time is left: a bar in a terminal, lines in a log."""

import io
import logging
import re
import sys

import pytest

import pipeline.base.progress as module
from pipeline.base.progress import LOG_EVERY_S, progress


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass only when the test says so."""
    now = [0.0]
    monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    return now


def lines_of(caplog, clock, items, seconds_each, **options):
    with caplog.at_level(logging.INFO):
        for _ in progress(items, "work", **options):
            clock[0] += seconds_each
    return [record.message for record in caplog.records if record.name == "work"]


def test_a_log_has_lines_with_the_time_left_and_not_too_many(caplog, clock):
    found = lines_of(caplog, clock, range(1000), 4.0)
    assert found[0] == "4 of 1000, 1:06:24 left"  # 996 items of 4 s
    assert len(found) == 1000 // 4
    assert LOG_EVERY_S < 4 * 4.0


def test_a_log_without_a_total_has_no_guess(caplog, clock):
    assert lines_of(caplog, clock, iter(range(9)), 10.0)[0] == "2 of ?"
    caplog.clear()
    assert lines_of(caplog, clock, iter(range(9)), 10.0, total=9)[0] == "2 of 9, 01:10 left"


def test_a_terminal_has_a_bar_with_the_time_left(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    assert list(progress(range(3), "work")) == [0, 1, 2]
    assert re.search(r"work: 100%.*3/3 \[\d\d:\d\d<\d\d:\d\d", terminal.getvalue())
