"""What jobs ask for by the sizes of a capture, and what these sizes are before anything has run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from safetensors.numpy import save_file

from pipeline.base.errors import InputError
from pipeline.budget import job_costs
from pipeline.budget.job_costs import read_costs
from pipeline.budget.job_size import JobSize
from pipeline.config.loading import load_project
from pipeline.config.project import SECTIONS
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_requests import memory_mb, minutes, request, request_words, useful_threads
from pipeline.workflow.job_size import job_size, unknown_size

SIZE = JobSize(
    cameras=10, lights=20, frames=30, pixels=50_000, texels=40_000, steps=1000, step_pixels=100_000, avatars=1,
    processes=2, decode_threads=4,
)  # fmt: skip
PAPER = JobSize(
    cameras=512, lights=1024, frames=64, pixels=1332 * 1152, texels=630_000, steps=300_000, step_pixels=4 * 1332 * 1152,
    avatars=1, processes=2, decode_threads=4,
)  # fmt: skip
"""A chunk of RFGCA's capture."""

TERMS = """\
stage,cost,sizes,coefficient,worst
pack_shards,mb,,200,1.5
pack_shards,mb,threads pixels,0.001,1.5
pack_shards,seconds,,10,1
pack_shards,seconds,frames cameras,2,1
train_avatar,mb,processes,300,1
train_avatar,seconds,steps,0.5,1
evaluate_avatar,mb,,900,1
evaluate_avatar,seconds,,100,1
"""


@pytest.fixture(autouse=True)
def _committed_table(repo_root, monkeypatch):
    monkeypatch.setattr(job_costs, "TABLE", repo_root / job_costs.TABLE)


@pytest.fixture
def planted(tmp_path, monkeypatch):
    """A table of round numbers in place of the committed one."""
    path = tmp_path / "job_costs.csv"
    path.write_text(TERMS)
    monkeypatch.setattr(job_costs, "TABLE", path)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A function: the jobs of a subject in the current folder, with these settings."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config/subjects").mkdir(parents=True)

    def load(**settings):
        (tmp_path / "config/subjects/someone.yaml").write_text(yaml.safe_dump(settings))
        return load_project({}, {}, tmp_path / "config/subjects")

    return load


@pytest.mark.usefixtures("planted")
def test_request_is_the_sum_of_terms_with_margin_and_start():
    # 1.25 * 1.5 (200 + 0.001 * 2 threads * 50,000) + 400 = 962, rounded up.
    assert memory_mb("pack_shards", SIZE, 2, attempt=1) == 1000
    # 300 s + 2 (10 + 2 * 30 * 10) s = 25.3 minutes.
    assert minutes("pack_shards", SIZE, 1, attempt=1) == 26
    # Three threads take over as much as two that work all the time.
    assert minutes("pack_shards", SIZE, 3, attempt=1) == 16


@pytest.mark.usefixtures("planted")
def test_each_attempt_asks_for_twice_as_much():
    assert [memory_mb("pack_shards", SIZE, 2, attempt) for attempt in (1, 2, 3)] == [1000, 2000, 3900]
    assert [minutes("pack_shards", SIZE, 1, attempt) for attempt in (1, 2, 3)] == [26, 51, 102]


@pytest.mark.usefixtures("planted")
def test_stage_that_trains_again_asks_for_the_largest_memory_and_all_times():
    # 1.25 * max(300 * 2, 900) + 400 = 1525; 300 s + 2 * 6 * (0.5 * 1000 + 100) s.
    assert memory_mb("budget_errors", SIZE, 1, attempt=1) == 1600
    assert minutes("budget_errors", SIZE, 1, attempt=1) == 125


def test_every_stage_has_a_request_that_larger_captures_exceed():
    for stage in SECTIONS:
        small, large = request(stage, SIZE), request(stage, PAPER)
        assert small.threads >= 1 and small.mem_mb >= 400 and small.minutes >= 5, stage
        assert (large.threads, large.mem_mb, large.minutes) >= (small.threads, small.mem_mb, small.minutes), stage
    assert request("compare_subjects", unknown_size()).mem_mb >= 400


@pytest.mark.parametrize("name", ["frames", "cameras", "pixels"])
def test_work_on_images_takes_longer_with_more_of_each(name):
    for stage in ("index_capture", "pack_shards", "evaluate_avatar"):
        more = replace(PAPER, **{name: 4 * getattr(PAPER, name)})
        assert minutes(stage, more, 1, 1) > minutes(stage, PAPER, 1, 1), stage


def test_training_takes_longer_with_steps_and_texels_and_more_memory_with_frames_that_it_keeps():
    once = minutes("train_avatar", PAPER, 2, 1)
    assert 1.8 < minutes("train_avatar", replace(PAPER, steps=600_000), 2, 1) / once < 2.01
    assert minutes("train_avatar", replace(PAPER, texels=1_260_000), 2, 1) > once

    def asked(frames, cache_mb):
        return memory_mb("train_avatar", replace(PAPER, frames=frames, cache_mb=cache_mb), 2, 1)

    assert asked(640, 1_000_000) > 2 * asked(64, 1_000_000)
    assert asked(5000, 16_000) == asked(640, 16_000)
    assert asked(5000, 16_000) <= asked(64, 0) + 1.25 * 1.2 * 16_000  # a margin, and the worst run
    assert asked(5000, 0) == asked(64, 0)


def test_stages_that_look_at_some_cameras_ask_no_more_for_others():
    long = replace(PAPER, frames=5000)
    for stage, most in (("track_mesh", 24), ("book_patterns", 16)):
        fewer, as_many = (memory_mb(stage, replace(long, cameras=cameras), 1, 1) for cameras in (most // 2, most))
        assert fewer < as_many == memory_mb(stage, long, 1, 1), stage
    assert memory_mb("track_mesh", replace(PAPER, tracking_cameras=48), 1, 1) > memory_mb("track_mesh", PAPER, 1, 1)


def test_threads_follow_the_pieces_of_the_work():
    assert useful_threads("index_capture", SIZE) == 4
    assert [useful_threads("trace_irradiance", replace(SIZE, frames=n)) for n in (2, 12, 64, 500)] == [2, 3, 16, 16]
    assert useful_threads("track_mesh", PAPER) == 1
    # A training process has one thread on a small atlas, and its share of all on a large one.
    assert useful_threads("train_avatar", SIZE) == 2
    assert useful_threads("train_avatar", PAPER) == 14
    assert useful_threads("train_avatar", replace(PAPER, processes=32)) == 32


def test_size_of_a_synthetic_subject_is_that_of_its_settings(project):
    made = {"cameras": 5, "lights": 8, "frames": 23, "width": 64, "height": 80}
    trained = {"steps": 60, "cameras_per_step": 3, "frames_per_step": 2, "steps_together": 4}
    loaded = project(
        source="synthetic", synthesize_capture=made, chunk_frames=10, unwrap_atlas={"size": 100}, train_avatar=trained,
        variants={"full": {}, "long": {"steps": 90}},
    )  # fmt: skip
    expected = JobSize(
        cameras=5, lights=8, frames=23, pixels=5120, texels=6000, steps=90, step_pixels=6 * 5120, avatars=2,
        processes=4, decode_threads=4, listed=5 * 23,
    )  # fmt: skip
    assert job_size(JobFiles(loaded, "someone")) == expected
    assert job_size(JobFiles(loaded, "someone", chunk="0001")).frames == 10
    assert job_size(JobFiles(loaded, "someone", "full")).steps == 60


def test_size_of_a_recorded_subject_is_read_anew_when_its_tables_are_there(project):
    files = JobFiles(project(), "someone")
    before = job_size(files)
    assert (before.cameras, before.lights, before.frames, before.pixels) == (8, 24, 24, 19_200)
    folder = files.project.settings.captures
    root = Path(folder) / "someone"
    root.mkdir(parents=True)
    pd.DataFrame({"camera": ["a", "b"], "width": [10, 30], "height": 10}).to_csv(root / "cameras.csv", index=False)
    pd.DataFrame({"frame": range(70)}).to_csv(root / "frames.csv", index=False)
    pd.DataFrame({"light": ["x", "y", "z"]}).to_csv(root / "lights.csv", index=False)
    (root / "capture.yaml").write_text("cameras: cameras.csv\nframes: frames.csv\nlights: lights.csv\n")
    after = job_size(files)
    assert (after.cameras, after.lights, after.frames, after.pixels) == (2, 3, 70, 200)
    assert job_size(replace(files, chunk="0000")).frames == 64


def test_texels_are_counted_as_soon_as_there_is_an_atlas(project, tmp_path):
    files = JobFiles(project(unwrap_atlas={"most": 200}), "someone")
    assert job_size(files).texels == 24_000
    path = tmp_path / "results/someone/atlas.safetensors"
    path.parent.mkdir(parents=True)
    for content in (b"cut", b"no safetensors file at all", b"\x02\0\0\0\0\0\0\0[]"):
        path.write_bytes(content)
        assert job_size(files).texels == 24_000
    save_file({"texel": np.zeros((123, 2), np.int32), "size": np.array([16])}, path)
    assert job_size(files).texels == 123


def test_requests_for_the_report_name_every_stage_and_count_a_chunk(project):
    files = JobFiles(project(source="synthetic", synthesize_capture={"frames": 500}, chunk_frames=10), "someone")
    words = request_words(files)
    assert [word.partition(":")[0] for word in words] == list(SECTIONS)
    chunk = request("pack_shards", job_size(replace(files, chunk="0000")))
    assert f"pack_shards:{chunk.mem_mb}:{chunk.minutes}" in words


@pytest.mark.parametrize(
    "text", ["", "stage,cost\na,mb\n", TERMS + "pack_shards,mb,pixels,many,1\n", TERMS + "pack_shards,mb,pixels\n"]
)
def test_table_that_is_none_is_refused_by_name(tmp_path, text):
    path = tmp_path / "costs.csv"
    if text:
        path.write_text(text)
    with pytest.raises(
        InputError, match=r"costs.csv: expected columns stage, cost, sizes, coefficient and worst, found"
    ):
        read_costs(path)
