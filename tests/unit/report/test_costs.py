"""Numbers of planted benchmarks, as they stand on the page: units, retries, sums and peaks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pipeline.base.files import write_json
from pipeline.config.write_report import WriteReport
from pipeline.report.costs import hard_cases, stages
from pipeline.report.pictures import Pictures
from pipeline.report.results import Results


@pytest.fixture
def results(tmp_path: Path) -> Results:
    """Two chunks of a stage, one of which was tried twice, and an hour of training that was looked at till its end."""
    (tmp_path / "benchmarks").mkdir()
    write_json(tmp_path / "index/capture.json", {"subject": "someone"})
    rows = {
        "track_mesh.0000": ["10.0 9.0 300.0", "15.0 25.0 500.0"], "track_mesh.0001": ["45.0 50.0 400.0"],
        "train_avatar.full": ["3540.0 7050.0 2000.0"],
    }  # fmt: skip
    for job, lines in rows.items():
        text = "s cpu_time max_rss\n" + "\n".join(lines) + "\n"
        (tmp_path / f"benchmarks/{job}.tsv").write_text(text.replace(" ", "\t"))
    return Results(tmp_path, tmp_path, {}, WriteReport(), Pictures(10**6))


def test_time_is_that_of_the_last_try_and_in_minutes_and_memory_is_the_largest_jobs(results: Results) -> None:
    html = stages(results).html
    # 15 + 45 + 3540 s are an hour.
    assert "60.0 minutes of stages in all" in html and "the largest took 2000 MB" in html
    rows = re.findall(r"<tr><t[hd][^>]*>(track_mesh|train_avatar)(.*?)</tr>", html, re.DOTALL)
    cells = {stage: re.findall(r"<td[^>]*>([^<]*)</td>", rest) for stage, rest in rows}
    # Jobs, wall and CPU in seconds, peak; what jobs would ask for is not known here.
    assert [cell for cell in cells["track_mesh"] if cell] == ["2", "60.0", "75.0", "500"]
    assert [cell for cell in cells["train_avatar"] if cell] == ["1", "3540.0", "7080.0", "2000"]


def test_bars_are_shares_of_the_longest_stage(results: Results) -> None:
    shares = [float(share) for share in re.findall(r"width: ?([\d.]+)%", stages(results).html)]
    assert sorted(shares) == pytest.approx([100 * 60 / 3540, 100], abs=0.1)


def test_hard_case_without_a_verdict_does_not_pass(results: Results) -> None:
    head = "case,group,value_error,value_bound,gradient_error,gradient_bound,verdict,naive_error"
    rows = ["a,g,1e-9,1e-8,,,PASS,1", "b,g,1,1e-8,,,FAIL,", "c,g,1e-9,1e-8,,,,"]
    results.hard_cases.write_text("\n".join([head, *rows]) + "\n")
    text = hard_cases(results).html
    assert "3 cases, 1 pass, 2 do not" in text and "For 1 of them a plausible" in text
