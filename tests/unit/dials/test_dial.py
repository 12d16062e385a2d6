"""Command lines, truth and obstacles of made-up dials, and what the real ones take from a subject."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from pipeline.avatar.spec.planned import resolve_spec, unread_settings
from pipeline.base.errors import InputError
from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.config.effects import EFFECTS
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.config.measure_cost import COSTED_STAGES
from pipeline.config.project import SECTIONS
from pipeline.config.train_avatar import TrainAvatar
from pipeline.dials.calibration import CAMERAS
from pipeline.dials.catalogue import DIALS
from pipeline.dials.dial import CostedStage, Dial, Metric, possible_dials
from pipeline.dials.papers import PAPERS_DIALS
from pipeline.dials.relighting import outdoors
from pipeline.dials.subject import Subject
from pipeline.dials.tolerances import small_focal_percent, small_length_mm, small_light_mm
from pipeline.dials.tracking import TRACKING
from pipeline.dials.trained import TRACED_AND_TRAINED
from pipeline.geometry.cameras import write_cameras
from tests.support.figures.walking import ring_of_cameras

STAGE = CostedStage(
    name="track_mesh",
    files={"trackings": "{out}"},
    inputs=("index/frames.parquet",),
    outputs={"tracking": ("0000.safetensors", "tracking.safetensors"), "table": ("0000.parquet", None)},
    metrics=(Metric("wrongness", lambda subject, output, expected: 0.0, lambda subject: 1.0),),
    unit="steps",
    work=lambda output: 1,
)
DIAL = Dial("rounds", STAGE, "outline_rounds", lambda subject: (0, 5))


@pytest.fixture
def subject(tmp_path: Path) -> Subject:
    results = tmp_path / "my results/someone"
    (results / "index").mkdir(parents=True)
    (results / "index/frames.parquet").touch()
    return Subject(results, tmp_path / "capture", 3, 64, {"track_mesh": {"inlier_px": 4.5}})


def test_command_has_the_subjects_settings_and_the_one_that_changes(subject, tmp_path) -> None:
    words = STAGE.command(subject, tmp_path / "out", {"outline_rounds": 2})
    assert words[1:3] == ["-m", "pipeline.stages.track_mesh"]
    given = dict(pairwise(words))  # a flag may have no value, or several
    assert given["--index"] == f"{subject.results}/index"
    assert given["--out"] == str(tmp_path / "out")
    assert given["--cameras"] == f"{subject.results}/calibration/cameras.json"
    assert (given["--chunk"], given["--chunk-size"]) == ("0000", "64")
    assert (given["--inlier-px"], given["--outline-rounds"]) == ("4.5", "2")


def test_value_out_of_range_is_refused_before_anything_runs(subject, tmp_path) -> None:
    with pytest.raises(ValidationError, match="outline_rounds"):
        STAGE.command(subject, tmp_path, {"outline_rounds": -1})


def test_truth_counts_only_if_all_of_it_is_there(subject) -> None:
    assert STAGE.truth(subject) is None
    path = subject.capture / "truth/tracking.safetensors"
    path.parent.mkdir(parents=True)
    path.touch()
    assert STAGE.truth(subject) == {"tracking": path}
    without = replace(STAGE, outputs={"table": ("0000.parquet", None)})
    assert without.truth(subject) is None


class TestPossibleDials:
    def test_all_that_can_be_turned(self, subject) -> None:
        lacking = replace(DIAL, name="more", stage=replace(STAGE, inputs=("atlas.safetensors",)))
        given = replace(DIAL, name="given", stage=replace(STAGE, runs_on=lambda subject: False))
        possible, reasons = possible_dials([DIAL, lacking, given], [], subject)
        assert possible == [DIAL]
        assert len(reasons) == 2
        assert "more: expected atlas.safetensors in" in reasons[0]
        assert "given: track_mesh takes what it is given" in reasons[1]

    def test_all_problems_of_those_wanted_at_once(self, subject) -> None:
        lacking = replace(DIAL, name="more", stage=replace(STAGE, inputs=("atlas.safetensors",)))
        with pytest.raises(InputError, match="2 problems") as error:
            possible_dials([DIAL, lacking], ["rounds", "more", "nonsense"], subject)
        assert "nonsense: expected one of rounds, more, found no such dial" in str(error.value)
        assert "more: expected atlas.safetensors" in str(error.value)

    def test_none_at_all(self, subject) -> None:
        lacking = replace(DIAL, stage=replace(STAGE, inputs=("atlas.safetensors",)))
        with pytest.raises(InputError, match=r"rounds: expected atlas\.safetensors"):
            possible_dials([lacking], [], subject)


@pytest.mark.parametrize("dial", DIALS, ids=lambda dial: dial.name)
def test_dial_turns_a_setting_that_its_stage_has(dial) -> None:
    assert {dial.setting, *dial.fixed} <= set(SECTIONS[dial.stage.name].model_fields)
    assert dial.setting not in dial.fixed
    assert set(dial.stage.afterwards) <= set(SECTIONS)


@pytest.mark.parametrize("dial", PAPERS_DIALS, ids=lambda dial: dial.name)
def test_papers_choices_are_read_by_what_is_built(dial) -> None:
    """Every value is taken, and no part of the model ignores it: each makes another model, or other steps."""
    planned, built = set(EFFECTS) - {"eyes"}, []
    for value in dial.values(None):
        settings = TrainAvatar(**dial.change(value))
        spec = resolve_spec(settings, planned, "head" if dial.setting == "geometry" else "body")
        assert dial.setting not in unread_settings(settings, spec), value
        built.append((spec, settings.cameras_per_step, settings.refine_lights, settings.refine_cameras))
    assert len(set(built)) == len(built)


def test_workflow_knows_all_stages_that_are_measured() -> None:
    assert set(COSTED_STAGES) == {dial.stage.name for dial in DIALS}


def test_names_of_dials_differ() -> None:
    assert len({dial.name for dial in DIALS}) == len(DIALS)


def test_stages_that_follow_are_run_like_any_other(subject) -> None:
    stage = replace(STAGE, files={"irradiance": "{out}/0000"}, afterwards=("pack_shards",))
    command = stage.later_commands(subject, Path("/tmp/out"))["pack_shards"]
    assert command[1:3] == ["-m", "pipeline.stages.pack_shards"]
    assert command[command.index("--irradiance") + 1] == "/tmp/out/0000"
    assert command[command.index("--atlas") + 1] == f"{subject.results}/atlas.safetensors"
    assert STAGE.later_commands(subject, Path("/tmp/out")) == {}


def test_what_only_heads_have_is_asked_for_where_it_is(subject) -> None:
    stage = replace(STAGE, files={"textures": "{out}/a"}, afterwards=("bake_textures", "pack_shards", "train_avatar"))
    command = stage.later_commands(subject, Path("/tmp/out"))
    assert list(command) == ["pack_shards", "train_avatar"]
    assert "--textures" not in command["pack_shards"] and "--fitted-eyes" not in command["train_avatar"]
    (subject.results / "textures").mkdir()
    command = stage.later_commands(subject, Path("/tmp/out"))
    assert list(command) == ["bake_textures", "pack_shards", "train_avatar"]
    assert command["pack_shards"][command["pack_shards"].index("--textures") + 1] == "/tmp/out/a"
    assert "--fitted-eyes" not in command["train_avatar"]
    (subject.results / "eyes.json").touch()
    assert "--fitted-eyes" in stage.later_commands(subject, Path("/tmp/out"))["train_avatar"]


def test_pictures_are_of_test_images() -> None:
    with pytest.raises(ValidationError, match="splits: expected test among them"):
        EvaluateAvatar(splits=("validation",))
    assert EvaluateAvatar(splits=("validation",), pictures=False).splits == ("validation",)


def test_psnr_lost_is_against_the_reference(subject, tmp_path) -> None:
    metric = TRACED_AND_TRAINED.metrics[0]
    files = []
    # Two validation images under part of the lights; a fully lit one, and a test image, do not count.
    table = pd.DataFrame({"validation": [True, True, True, False], "fully_lit": [False, False, True, False]})
    table = table.assign(camera="a", frame=range(4))
    for name, psnr in (("found", [27.5, 26.5, 20, 10]), ("expected", [28.25, 27.75, 30, 30])):
        write_table(tmp_path / f"{name}.parquet", table.assign(psnr_db=psnr))
        files.append({"per_image": tmp_path / f"{name}.parquet"})
    assert metric.error(subject, *files) == pytest.approx((0.75 + 1.25) / 2)
    assert metric.error(subject, *files[::-1]) == pytest.approx(-1.0)
    # Two blocks of one frame each: 0.25 off their mean, over the root of 2, with one degree of freedom.
    assert metric.scatter(subject, *files) == pytest.approx(0.25)
    write_table(files[1]["per_image"], table.assign(camera="b", psnr_db=30.0))
    with pytest.raises(InputError, match="expected the images of"):
        metric.error(subject, *files)


class TestVertices:
    def errors(self, subject: Subject, turn: np.ndarray, shift: np.ndarray, truth: bool) -> list[float]:
        """Of a tracking in a frame that is turned and shifted against the true one.

        A fifth of its vertices is off by 100 mm, the others by 5 mm.
        """
        rig = ring_of_cameras(6)
        true = np.random.default_rng(0).normal(size=(4, 50, 3)).astype(np.float32)
        found = true[[1, 3]] + np.float32([0, 0.003, 0.004])
        found[:, :10] = true[[1, 3], :10] + np.float32([0.1, 0, 0])
        moved = {name: replace(c, R=c.R @ turn.T, t=c.t - c.R @ turn.T @ shift) for name, c in rig.items()}
        write_cameras(subject.results / "calibration/cameras.json", moved)
        output, expected = subject.results / "found.safetensors", subject.results / "true.safetensors"
        write_arrays(output, {"frames": np.array([11, 13]), "vertices": (found @ turn.T + shift).astype(np.float32)})
        write_arrays(expected, {"frames": np.array([10, 11, 12, 13]), "vertices": true})
        wanted = {"tracking": expected}
        if truth:
            wanted["rig"] = subject.results / "rig.json"
            write_cameras(wanted["rig"], rig)
        return [metric.error(subject, {"tracking": output}, wanted) for metric in TRACKING.metrics]

    def test_frame_of_the_stage_is_no_error_where_the_truth_is_known(self, subject) -> None:
        turn = cv2.Rodrigues(np.array([0.01, 0.02, -0.01]))[0]
        assert self.errors(subject, turn, np.array([0.02, 0, 0.01]), truth=True) == pytest.approx([5, 100], rel=1e-3)

    def test_frames_are_matched_by_number(self, subject) -> None:
        assert self.errors(subject, np.eye(3), np.zeros(3), truth=False) == pytest.approx([5, 100], rel=1e-3)


class TestValues:
    def values(self, name: str, subject: Subject) -> list:
        (dial,) = (dial for dial in DIALS if dial.name == name)
        return list(dial.values(subject))

    @pytest.mark.parametrize(
        ("side", "sizes"), [(160, [20, 40, 80, 160]), (4096, [128, 256, 512, 1024]), (64, [16, 32, 64])]
    )
    def test_masks_up_to_the_images_size(self, subject, side, sizes) -> None:
        write_table(subject.results / "index/cameras.parquet", pd.DataFrame({"width": [48], "height": [side]}))
        assert self.values("mask_size", subject) == sizes

    def test_samples_up_to_all_lights(self, subject) -> None:
        lit = pd.DataFrame({"frame": [0] * 24 + [1] * 5, "light": [*range(24), *range(5)]})
        write_table(subject.results / "patterns.parquet", lit)
        assert self.values("irradiance_power", subject) == ["1", "2", "4", "8", "16", "full"]

    def test_shares_of_board_views(self, subject) -> None:
        views = [{"camera": camera, "view": view} for camera in ("a", "b") for view in range(40)]
        write_json(subject.results / "index/calibration_cameras.json", {"method": "charuco", "views": views})
        assert self.values("board_views", subject) == [8, 14, 20, 30, None]

    def test_positions_of_the_ball(self, subject) -> None:
        images = [{"position": position, "camera": "a"} for position in ("0", "1", "2", "2")]
        write_json(subject.results / "index/calibration_lights.json", {"method": "mirror_ball", "images": images})
        assert self.values("ball_positions", subject) == [1, 2, None]


def test_tolerances_are_what_a_tenth_of_a_pixel_is(subject) -> None:
    rig = ring_of_cameras(6)
    write_cameras(subject.results / "calibration/cameras.json", rig)
    write_json(subject.results / "index/capture.json", {"images": {"downsample_from_sensor": 4}})
    camera = next(iter(rig.values()))
    # The ring's cameras look at one point on the first one's axis; its distance from the axis of another is least.
    distance_m = 1000 * np.median([np.linalg.norm(c.center - axis_crossing(rig)) / c.K[0, 0] for c in rig.values()])
    assert small_length_mm(subject) == pytest.approx(0.1 * 4 * distance_m, rel=1e-6)
    longer = max(camera.width, camera.height) / 4
    assert small_focal_percent(subject) == pytest.approx(100 * 0.1 / (longer / 2))
    lights = axis_crossing(rig) + np.array([[2.0, 0, 0], [0, -2.0, 0], [0, 0, 2.0]])
    table = pd.DataFrame(lights, columns=["x", "y", "z"]).assign(light=["a", "b", "c"])
    write_table(subject.results / "calibration/lights.parquet", table)
    # The inverse square law: a distance of 2 m that is wrong by 10 mm makes 1 % of the light.
    assert (2.0 / (2.0 - small_light_mm(subject) / 1000)) ** 2 == pytest.approx(1.01, abs=1e-3)


def axis_crossing(rig: dict) -> np.ndarray:
    """Where the axes of the first two cameras that are not opposite each other come closest."""
    first, second = list(rig.values())[:2]
    a, b = first.R[2], second.R[2]
    along = np.linalg.lstsq(np.stack([a, -b], 1), second.center - first.center, rcond=None)[0]
    return (first.center + along[0] * a + second.center + along[1] * b) / 2


class TestCameras:
    @pytest.fixture
    def errors(self, subject):
        """Errors of a rig by metric, against a ring of six of which the workflow has calibrated five."""
        true = ring_of_cameras(6)
        expected = {"rig": subject.capture / "cameras.json"}
        write_cameras(expected["rig"], true)
        write_json(subject.results / "index/capture.json", {"images": {"downsample_from_sensor": 4}})
        write_cameras(subject.results / "calibration/cameras.json", dict(list(true.items())[:5]))

        def of(rig: dict) -> dict[str, float]:
            output = {"rig": subject.results / "rig.json"}
            write_cameras(output["rig"], rig)
            return {metric.name: metric.error(subject, output, expected) for metric in CAMERAS.metrics}

        return true, of

    def test_camera_that_nobody_calibrates_is_no_error(self, errors) -> None:
        true, of = errors
        assert max(of(dict(list(true.items())[:5])).values()) < 1e-6

    def test_camera_that_only_this_setting_loses_is_one(self, errors) -> None:
        true, of = errors
        assert set(of(dict(list(true.items())[1:])).values()) == {np.inf}


def test_dials_that_are_chosen_turn_settings_of_their_own() -> None:
    """What presets and budgets write is one value for each setting."""
    turned = [(dial.stage.name, dial.setting) for dial in DIALS if dial.chosen]
    assert len(set(turned)) == len(turned) == 6


def test_all_dials_of_the_design_are_there() -> None:
    settings = {(dial.stage.name, dial.setting) for dial in DIALS}
    assert settings >= {
        ("trace_irradiance", "samples"), ("trace_irradiance", "spread"), ("unwrap_atlas", "texel_pixels"),
        ("train_avatar", "transfer_degree"), ("relight_avatar", "environment_height"),
        ("relight_avatar", "prefiltered_height"), ("train_avatar", "depth"), ("train_avatar", "steps"),
        ("track_mesh", "image_rounds"), ("pack_shards", "codec"),
    }  # fmt: skip
    samplings = {dial.fixed.get("sampling") for dial in DIALS if dial.setting == "samples" and dial.fixed}
    assert samplings == {"uniform", "power", "arriving"}


def test_what_errors_are_relative_to_is_said(subject) -> None:
    images = pd.DataFrame({"camera": [f"cam{n}" for n in range(6)] * 2, "test_camera": ([False] * 5 + [True]) * 2})
    images.to_parquet(subject.results / "index/images.parquet")
    named = {dial.name: dial.against(subject) for dial in DIALS if dial.stage.name in ("train_avatar", "unwrap_atlas")}
    assert named["transfer_degree"].startswith("reference 8, steps 200, shading transfer")
    assert named["texel_size"] == "reference 0.45, steps 400"
    assert named["training_steps"] == "reference 1600"
    (cameras,) = (dial for dial in DIALS if dial.name == "training_cameras")
    assert list(cameras.values(subject)) == [2, 4, 0]
    (spread,) = (dial for dial in DIALS if dial.name == "irradiance_spread")
    assert spread.against(subject).startswith("reference samples full")


def test_panorama_of_the_dials_has_a_sun_and_a_horizon() -> None:
    sky = outdoors()
    light = sky.irradiances().sum(0)
    sun = sky.radiance.max(-1) > 100
    sun_light = (sky.radiance * sky.solid_angles()[:, None, None])[sun].sum(0)
    assert (sun_light / light).min() > 0.2 and (sun_light / light).max() < 0.8
    assert sky.directions()[sun][:, 1].min() > 0.5
    assert sky.radiance[-1].max() < 0.2 < sky.radiance[100].min()
