"""Jobs that share the images of a large capture: which there are, what they read, and how large they are."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
import yaml

from pipeline.config.loading import load_project
from pipeline.workflow import shared_images
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_size import job_size
from pipeline.workflow.shared_images import (
    chunk_words,
    inspected_tables,
    joined_size,
    score_tables,
    scored_files,
    scoring_flags,
    share_size,
)


@pytest.mark.parametrize(
    ("least", "firsts"),
    [(1, [0, 1, 2, 3, 4]), (40, [0, 1, 2, 3, 4]), (41, [0, 2, 4]), (160, [0, 4]), (161, []), (4096, [])],
)
def test_jobs_have_as_few_chunks_as_hold_the_images_asked_for(project, least, firsts):
    files = JobFiles(project(chunk_images=least), "someone")
    assert inspected_tables(files) == [f"results/someone/inspected/{first:04d}.parquet" for first in firsts]
    assert score_tables(files) == [f"results/someone/scores/full/{first:04d}.parquet" for first in firsts]


def test_one_chunk_is_one_job_whatever_it_holds(project, monkeypatch):
    """And its images are not even counted: a start takes no longer."""
    monkeypatch.delattr(shared_images, "job_size")
    files = JobFiles(project(chunk_frames=24, chunk_images=1), "someone")
    assert inspected_tables(files) == score_tables(files) == []


def test_each_avatar_is_scored_by_jobs_of_its_own(project):
    own = {"few": {"trace_irradiance": {"samples": 4}}}
    files = JobFiles(project(chunk_images=160, variants={"full": {}, **own}), "someone")
    places = [f"{name}/{first}" for name in ("few", "full") for first in ("0000", "0004")]
    assert score_tables(files) == [f"results/someone/scores/{place}.parquet" for place in places]
    last = JobFiles(files.project, "someone", "few", "0004")
    assert scored_files(last) == [
        "results/someone/shards/test/0004.arrow",
        "results/someone/shards/validation/0004.arrow",
        "results/someone/variants/few/frames/0004.arrow",
    ]


def test_a_job_is_told_its_chunks_and_asks_for_their_size(project):
    loaded = project(chunk_images=41)
    first, last = (JobFiles(loaded, "someone", "full", chunk) for chunk in ("0000", "0004"))
    assert (chunk_words(first), chunk_words(last)) == (
        ["--chunk", "0", "--chunks", "2"],
        ["--chunk", "4", "--chunks", "1"],
    )
    assert len(scored_files(first)) == 6
    assert (share_size(first).frames, share_size(last).frames, share_size(first).listed) == (10, 5, 0)


def test_a_job_that_joins_handles_no_image_and_reads_of_all(project):
    files = JobFiles(project(chunk_images=41), "someone")
    joining = joined_size(files, inspected_tables(files))
    assert (joining.frames, joining.listed) == (0, 24 * 8)
    assert joined_size(files, []) == job_size(files) and job_size(files).frames == 24


def test_pictures_and_names_of_protocols_do_not_decide_scores(project):
    flags = [
        scoring_flags(JobFiles(project(evaluate_avatar=each), "someone"))
        for each in ({}, {"pictures": False}, {"intrinsic_layers": False}, {"protocol": "ava256"}, {"lpips_net": "vgg"})
    ]
    assert flags[0] == flags[1] == flags[2] == flags[3] != flags[4]


@pytest.mark.parametrize(("watched", "jobs"), [(9, 2), (10, 0)])
def test_files_that_are_watched_one_by_one_are_inspected_by_one_job(project, watched, jobs):
    """Three tables, six images and a description are ten files."""
    project()
    folder = Path("captures/recorded")
    folder.mkdir(parents=True)
    names = ("cameras", "frames", "lights")
    (folder / "capture.yaml").write_text(yaml.safe_dump({name: f"{name}.csv" for name in names}))
    pd.DataFrame({"camera": ["a"], "width": 4, "height": 4}).to_csv(folder / "cameras.csv", index=False)
    pd.DataFrame({"frame": range(6)}).to_csv(folder / "frames.csv", index=False)
    pd.DataFrame({"light": ["l"]}).to_csv(folder / "lights.csv", index=False)
    for frame in range(6):
        (folder / f"{frame}.png").touch()
    loaded = load_project({"track_capture_files": watched, "chunk_frames": 3, "chunk_images": 3}, {}, folder / "none")
    assert len(inspected_tables(JobFiles(loaded, "recorded"))) == jobs
    assert len(score_tables(JobFiles(loaded, "recorded"))) == 2
