"""Errors that dials are judged by, of planted outputs whose error is known; and time that counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pipeline.base.exr import write_exr
from pipeline.base.files import write_table
from pipeline.capture.records import ImageRecord
from pipeline.capture.shards import write_image_shard
from pipeline.dials import jobs
from pipeline.dials.calibration import LIGHTS
from pipeline.dials.dial import CostedStage, Metric
from pipeline.dials.irradiance import IRRADIANCE
from pipeline.dials.packing import PACKING
from pipeline.dials.relighting import RELIGHTING
from pipeline.dials.subject import Subject
from pipeline.geometry.cameras import write_cameras
from pipeline.metrics.cost import Cost
from pipeline.metrics.measured_run import MeasuredRun
from tests.support.figures.walking import ring_of_cameras

FLOAT32 = 1e-6
"""Relative rounding of what files hold, a few units in the last place."""


@pytest.fixture
def subject(tmp_path) -> Subject:
    return Subject(tmp_path / "someone", tmp_path / "capture", 1, 64, {"track_mesh": {"outline_rounds": 7}})


def test_irradiance_is_a_root_mean_square_over_the_texels_of_the_charts(subject, tmp_path):
    """Two maps of six texels, four of them in charts: wrong by 0.3 and 0.4 in one, by nothing in the other."""
    wanted = np.array([[1, 2, 3], [4, 0, 0]], np.float32)
    wrong = wanted + np.array([[0.3, 0, -0.4], [0, 0, 0]], np.float32)
    for name, first in (("found", wrong), ("expected", wanted)):
        write_exr(tmp_path / name / "000003.exr", first, half=False)
        write_exr(tmp_path / name / "000011.exr", wanted, half=False)
    write_table(tmp_path / "0000.parquet", pd.DataFrame({"frame": [3, 11], "texels": [4, 4]}))
    files = [{"maps": tmp_path / name, "table": tmp_path / "0000.parquet"} for name in ("found", "expected")]
    assert IRRADIANCE.metrics[0].error(subject, *files) == pytest.approx(np.sqrt((0.09 + 0.16) / 8), rel=FLOAT32)


@pytest.mark.parametrize("exposure", [1.0, 8.0])
def test_relit_pictures_a_tenth_too_bright_are_off_by_a_tenth_at_any_exposure(subject, tmp_path, exposure):
    rgb = exposure * np.random.default_rng(0).uniform(0, 1, (4, 5, 3)).astype(np.float32)
    for name, gain in (("found", 1.1), ("expected", 1.0)):
        for still in range(2):
            write_exr(tmp_path / name / f"{still}.exr", np.float32(gain) * rgb, half=False)
    files = [{"stills": tmp_path / name} for name in ("found", "expected")]
    assert RELIGHTING.metrics[0].error(subject, *files) == pytest.approx(0.1, rel=FLOAT32 / 0.1)


def crop(image: np.ndarray) -> ImageRecord:
    height, width = image.shape[:2]
    held_out = dict.fromkeys(("test_camera", "test_frame", "test_segment", "test_pattern", "fully_lit"), False)
    mask, eye = np.ones((height, width), np.float32), np.eye(3)
    return ImageRecord("a", 0, **held_out, x0=0, y0=0, width=width, height=height, image=image, mask=mask,
                       K=eye, R=eye, t=np.zeros(3))  # fmt: skip


def test_error_of_packing_is_a_mean_over_all_channels_however_many_crops(subject, tmp_path):
    image = np.full((3, 4, 3), 0.5, np.float32)
    for count in (1, 3):
        files = [{"train": tmp_path / f"{count}{name}.arrow"} for name in ("found", "expected")]
        write_image_shard(files[0]["train"], [crop(image + np.float32(0.002))] * count, "float32")
        write_image_shard(files[1]["train"], [crop(image)] * count, "float32")
        assert PACKING.metrics[0].error(subject, *files) == pytest.approx(0.002, rel=FLOAT32 / 0.002)


def test_lights_that_are_two_millimetres_off_are_off_by_two_millimetres(subject, tmp_path):
    """In the stage; in the rig as well, as the cameras of both agree."""
    places = np.random.default_rng(1).normal(size=(5, 3))
    files = []
    for name, shift in (("found", 0.002), ("expected", 0.0)):
        table = pd.DataFrame(places + np.array([0, shift, 0]), columns=["x", "y", "z"]).assign(light=list("abcde"))
        write_table(tmp_path / name / "lights.parquet", table)
        write_cameras(tmp_path / name / "cameras.json", ring_of_cameras(5))
        files.append({"lights": tmp_path / name / "lights.parquet", "rig": tmp_path / name / "cameras.json"})
    for metric in LIGHTS.metrics:
        assert metric.name.endswith("mm")
        assert metric.error(subject, *files) == pytest.approx(2, rel=1e-5)


STAGE = CostedStage(
    name="track_mesh",
    inputs=(),
    outputs={},
    metrics=(Metric("off", lambda subject, output, expected: 0.0, lambda subject: 1.0),),
    unit="steps",
    work=lambda output: 1,
    afterwards=("pack_shards", "train_avatar"),
    timed=("pack_shards",),
)


def test_dial_turns_even_what_the_subject_has_set_itself(subject, tmp_path):
    words = STAGE.command(subject, tmp_path / "out", {"outline_rounds": 2})
    assert words[words.index("--outline-rounds") + 1] == "2"
    words = STAGE.command(subject, tmp_path / "out", {"image_rounds": 2})
    assert words[words.index("--outline-rounds") + 1] == "7"


def test_seconds_of_stages_that_only_judge_do_not_count(subject, tmp_path, monkeypatch):
    """The stage itself takes 1 s, the next 2 s, which counts; the last 4 s and most memory, which do not."""
    seconds = {"track_mesh": 1.0, "pack_shards": 2.0, "train_avatar": 4.0}

    def run(command: list[str]) -> MeasuredRun:
        spent = seconds[command[2].removeprefix("pipeline.stages.")]
        return MeasuredRun(command, 0, spent, 10 * spent, 100 * spent, False, "")

    monkeypatch.setattr(jobs, "run_measured", run)
    cost = Cost("rounds", "2", {"off": 1.0}, "steps")
    job = jobs.Job(replace(STAGE, files={"trackings": "{out}"}), {"outline_rounds": 2}, [(cost, None)])
    jobs.measure(job, subject, Path(tmp_path / "scratch"))
    assert (cost.seconds, cost.cpu_seconds, cost.peak_mb) == ([3.0], [30.0], [200.0])
