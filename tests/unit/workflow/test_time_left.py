"""What is left of a run, and how long that should take."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.budget import job_costs
from pipeline.config.loading import load_project
from pipeline.config.project import SECTIONS
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.time_left import StageLeft, as_lines, main, pace_of, planned_jobs, stage_of, stages_left

TERMS = """\
stage,cost,sizes,coefficient,worst
index_capture,seconds,frames cameras,0.5,3
track_mesh,seconds,frames,2,1.5
train_avatar,seconds,,600,2
"""
"""Seconds of a processor; the worst runs play no part here."""

SUBJECT = "source: synthetic\nchunk_frames: 10\nsynthesize_capture: {cameras: 4, frames: 30}\n"


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> JobFiles:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(job_costs, "TABLE", tmp_path / "job_costs.csv")
    (tmp_path / "job_costs.csv").write_text(TERMS)
    (tmp_path / "subjects").mkdir()
    (tmp_path / "subjects/someone.yaml").write_text(SUBJECT)
    return JobFiles(load_project({}, {}, tmp_path / "subjects"), "someone")


@pytest.mark.parametrize(
    ("rule", "stage"),
    [
        ("track_mesh", "track_mesh"),
        ("evaluate_avatar_without_pictures", "evaluate_avatar"),
        ("inspect_images", "index_capture"),
        ("score_images", "evaluate_avatar"),
        ("find_boards", "calibrate_cameras"),
        ("measure_lights", "calibrate_lights"),
        ("all", None),
    ],
)
def test_rules_are_known_by_their_stage(rule: str, stage: str | None) -> None:
    assert stage_of(rule) == stage


def test_every_stage_is_its_own_rule() -> None:
    assert [stage_of(stage) for stage in SECTIONS] == list(SECTIONS)


def test_jobs_of_chunks_cost_what_their_frames_do_in_data_order(files: JobFiles) -> None:
    """Ten frames of two seconds, three times; all thirty of four cameras, half a second each."""
    found = stages_left({"train_avatar": 1, "track_mesh": 3, "index_capture": 1, "all": 1}, files)
    assert found == [
        StageLeft("index_capture", 1, 60.0), StageLeft("track_mesh", 3, 60.0), StageLeft("train_avatar", 1, 600.0),
    ]  # fmt: skip
    assert stages_left({"train_avatar": 1}, files, pace=1.5) == [StageLeft("train_avatar", 1, 900.0)]


def test_pace_is_that_of_finished_jobs(files: JobFiles) -> None:
    folder = Path("results/someone/benchmarks")
    assert pace_of(folder.parent, files) is None
    folder.mkdir(parents=True)
    for name, seconds in (("track_mesh.0000", 30.0), ("track_mesh.0001", 10.0), ("elsewhere", 1e6)):
        (folder / f"{name}.tsv").write_text(f"s\tcpu_time\n0.1\t{seconds}\n")
    assert pace_of(folder.parent, files) == pytest.approx((30 + 10) / (20 + 20))
    (folder / "train_avatar.full.tsv").write_text("s\tcpu_time\n1.0\t1240.0\n")
    assert pace_of(folder.parent, files) == pytest.approx((40 + 1240) / (40 + 600))


def test_table_ends_with_the_time_that_is_left() -> None:
    left = [StageLeft("track_mesh", 3, 60.0), StageLeft("train_avatar", 1, 7200.0)]
    *rows, last = as_lines(left, 4, None)
    assert [row.split() for row in rows[1:]] == [["track_mesh", "3", "1.0"], ["train_avatar", "1", "120.0"]]
    assert last == "at least 30 min (0.5 h) on 4 processors; no job is finished: as job_costs.csv expects"
    assert as_lines(left, 1, 2.0)[-1].endswith("finished jobs took 2 of what was expected, and so should these")
    assert as_lines([], 2, None) == ["nothing is left"]


def test_other_targets_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["time_left", "captures/someone"])
    with pytest.raises(SystemExit, match="target: expected results/NAME/FILE, found captures/someone"):
        main()


def test_refused_plan_says_why(files: JobFiles) -> None:
    with pytest.raises(InputError, match="Snakefile"):
        planned_jobs("results/someone/metrics.csv", [])
