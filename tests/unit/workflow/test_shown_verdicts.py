"""What a finished run says of its calibration."""

from __future__ import annotations

import os
from pathlib import Path

import pandas as pd

from pipeline.base.files import write_table
from pipeline.base.verdicts import Verdict, verdict_table
from pipeline.workflow.shown_verdicts import MOST_SHOWN, shown_verdicts


def planted(folder: Path, *verdicts: Verdict, name: str = "verdicts_lights.csv", time: float = 200.0) -> Path:
    path = folder / "someone/calibration" / name
    write_table(path, verdict_table(verdicts))
    os.utime(path, (time, time))
    return path


def test_weak_and_failed_verdicts_of_this_run_are_shown(tmp_path: Path) -> None:
    good, weak = Verdict("light", "L0", "good", "fine"), Verdict("light", "L1", "weak", "uncertain, by 12 mm")
    path = planted(tmp_path, good, weak, Verdict("ball", "a", "failed", "no outline"))
    planted(tmp_path, weak, name="verdicts_color.csv", time=100.0)
    assert shown_verdicts(tmp_path, 150.0)[1] == [
        f"{path}: light L1: weak: uncertain, by 12 mm",
        f"{path}: ball a: failed: no outline",
    ]


def test_all_that_was_judged_is_counted_also_when_all_is_well(tmp_path: Path) -> None:
    good, weak = Verdict("light", "L0", "good", "fine"), Verdict("light", "L1", "weak", "uncertain, by 12 mm")
    planted(tmp_path, good, weak, Verdict("ball", "a", "good", "fine"))
    write_table(tmp_path / "someone/verdicts_eyes.csv", verdict_table([Verdict("gaze", "left", "good", "fine")]))
    table, _ = shown_verdicts(tmp_path, 150.0)
    assert [line.split() for line in table] == [
        ["subject", "verdicts", "on", "good", "weak", "failed"],
        ["someone", "light", "1", "1", "0"],
        ["someone", "ball", "1", "0", "0"],
        ["someone", "gaze", "1", "0", "0"],
    ]
    assert len({len(line) for line in table}) == 1


def test_many_verdicts_are_counted(tmp_path: Path) -> None:
    planted(tmp_path, *(Verdict("light", f"L{number}", "weak", "far") for number in range(MOST_SHOWN + 7)))
    table, lines = shown_verdicts(tmp_path, 0.0)
    assert table[1].split() == ["someone", "light", "0", str(MOST_SHOWN + 7), "0"]
    assert len(lines) == MOST_SHOWN + 1
    assert lines[-1] == "... and 7 more that are weak or failed"


def test_empty_tables_and_folders_say_nothing(tmp_path: Path) -> None:
    assert shown_verdicts(tmp_path, 0.0) == ([], [])
    write_table(tmp_path / "someone/calibration/verdicts_color.csv", pd.DataFrame(columns=["kind", "name", "grade"]))
    assert shown_verdicts(tmp_path, 0.0) == ([], [])
