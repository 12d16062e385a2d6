"""What Snakemake's benchmarks say of jobs, and do not."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from snakemake import benchmark

from pipeline.base.finished_jobs import USED, FinishedJob, finished_jobs, last_look, processor_seconds

HEAD = "s\th:m:s\tmax_rss\tcpu_time\n"


def looks_of_snakemake(monkeypatch: pytest.MonkeyPatch, count: int) -> np.ndarray:
    """Seconds after a job's start at which Snakemake looks at it, as its own timer says, which is not waited for."""
    pauses = []

    class Timer:
        def __init__(self, pause: float, act) -> None:
            pauses.append(pause)
            self.act = act

        def start(self) -> None: ...

    class Looking(benchmark.ScheduledPeriodicTimer):
        def work(self) -> None: ...

    monkeypatch.setattr(benchmark, "DaemonTimer", Timer)
    looking = Looking(benchmark.BENCHMARK_INTERVAL)
    looking.start()
    while len(pauses) < count:
        looking._timer.act()
    return np.cumsum([0.0, *pauses])


def test_looks_are_snakemakes(monkeypatch: pytest.MonkeyPatch) -> None:
    looks = looks_of_snakemake(monkeypatch, 50)
    for wall in np.arange(0.1, looks[-1], 0.19):
        assert last_look(wall) == pytest.approx(looks[looks <= wall].max()), wall


def test_what_follows_the_last_look_goes_on_as_before(tmp_path: Path) -> None:
    """Two processes for 40 s, looked at after 15; and one for 7.2, looked at after 7."""
    (tmp_path / "train_avatar.full.tsv").write_text(HEAD + "40.0\t0:00:40\t900.5\t30.0\n")
    (tmp_path / "track_mesh.0003.tsv").write_text(HEAD + "9\t0:00:09\t1\t1\n7.2\t0:00:07\t300\t7.0\n")
    assert finished_jobs(tmp_path) == [
        FinishedJob("track_mesh", ("0003",), 7.2, 7.2, 300.0),
        FinishedJob("train_avatar", ("full",), 40.0, 80.0, 900.5),
    ]


def test_what_a_log_says_is_preferred(tmp_path: Path) -> None:
    """Of 75.07 s, Snakemake may have seen the first 45 or all."""
    benchmarks, logs = tmp_path / "benchmarks", tmp_path / "logs"
    benchmarks.mkdir(), logs.mkdir()
    for name in ("train_avatar.full", "track_mesh.0000"):
        (benchmarks / f"{name}.tsv").write_text(HEAD + "75.07\t0:01:15\t900.5\t76.6\n")
    said = f"12:00:00 train_avatar: {USED.format(60.5)}\n12:00:01 train_avatar: {USED.format(120.25)}\n"
    (logs / "train_avatar.full.log").write_text("12:00:00 train_avatar: 400 steps in 68 s\n" + said)
    (logs / "track_mesh.0000.log").write_text(f"12:00:00 track_mesh: {USED.format(1)} of others\n")
    assert [job.cpu_s for job in finished_jobs(benchmarks)] == [pytest.approx(76.6 * 75.07 / 75), 120.25]


def test_processor_seconds_count_children() -> None:
    before, burn = processor_seconds(), "import time\nwhile time.process_time() < 0.3: pass"
    subprocess.run([sys.executable, "-c", burn], check=True)
    assert processor_seconds() - before > 0.3


@pytest.mark.parametrize("missing", ["NA", "-", ""])
def test_job_too_short_to_be_looked_at_has_its_wall_time_alone(tmp_path: Path, missing: str) -> None:
    (tmp_path / "book_patterns.tsv").write_text(HEAD + f"0.2\t0:00:00\t{missing}\t{missing}\n")
    (tmp_path / "interrupted.tsv").write_text("")
    (job,) = finished_jobs(tmp_path)
    assert (job.stage, job.words, job.wall_s) == ("book_patterns", (), 0.2)
    assert math.isnan(job.cpu_s) and math.isnan(job.peak_mb)


def test_first_look_is_not_drawn_out(tmp_path: Path) -> None:
    """A job of 0.3 s, looked at when it had just begun: nothing tells how it went on."""
    (tmp_path / "fit_eyes.tsv").write_text(HEAD + "0.3\t0:00:00\t10\t0.1\n")
    assert finished_jobs(tmp_path)[0].cpu_s == pytest.approx(0.1)
