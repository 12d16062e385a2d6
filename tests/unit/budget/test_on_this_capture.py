"""What a capture's own size and kind say of times and errors that were measured on others."""

from __future__ import annotations

import math

import pandas as pd
import pytest
import yaml

from pipeline.budget.allocation import within_budget
from pipeline.budget.capture_size import CaptureSize, capture_size
from pipeline.budget.curves import read_curves, read_measured
from pipeline.budget.run_seconds import expected_texels
from pipeline.config.project import SubjectSettings
from pipeline.config.sections import merge
from tests.support.results.chosen_budgets import SAME_SIZE, SHADOWED, choose
from tests.support.results.curve_files import write_curves, write_subjects

pytestmark = pytest.mark.usefixtures("costs")

TEXELS = ("texel_size", "unwrap_atlas", "texel_pixels", "PSNR lost, dB", 0.1)
SUPERSAMPLING = ("supersampling", "train_avatar", "supersample", "PSNR lost, dB", 0.1)
STEPS = ("training_steps", "train_avatar", "steps", "PSNR lost, dB", 0.1)


@pytest.mark.parametrize(
    ("said", "texels"), [({}, 1600), ({"texel_pixels": 0.3}, 6400), ({"most": 50}, 1125), ({"size": 100}, 4500)]
)
def test_texels_that_are_asked_for(said, texels) -> None:
    settings = SubjectSettings(unwrap_atlas=said)
    assert expected_texels(settings, SAME_SIZE) == texels


class TestTexelsAreCounted:
    """Of texels whose side is 2, 1 and a half of the usual one."""

    @pytest.fixture
    def read(self, tmp_path):
        """Curves and subjects."""
        curves = {TEXELS: {"1.2": (1.0, 5.0, 400), "0.6": (0.5, 8.0, 1600), "0.3": (0.0, 20.0, 6400)}}
        path = write_curves(tmp_path / "curves", curves)
        return read_curves(path), read_measured(path.parent / "subjects.yaml")

    @pytest.fixture
    def estimate(self, read):
        """What to expect of an atlas that is asked for: a function of its settings, and of what the user has said."""

        def expected(atlas, said):
            settings = SubjectSettings(budget_minutes=1000, **SHADOWED, unwrap_atlas=atlas)
            return within_budget("someone", settings, said, SAME_SIZE, *read)[1]

        return expected

    @pytest.fixture
    def choice(self, read):
        """What minutes buy: a function of these, and of the machine's pace."""

        def chosen(minutes, pace=1.0):
            settings = SubjectSettings(budget_minutes=minutes, **SHADOWED)
            return within_budget("someone", settings, {}, SAME_SIZE, *read, pace)[1]

        return chosen

    @pytest.mark.parametrize(("atlas", "texels"), [({}, 6400), ({"most": 100}, 4500)])
    def test_time_is_of_those_that_this_capture_has(self, estimate, costs, atlas, texels) -> None:
        """Half as large are four times as many, unless the atlas may not hold them.

        Of 200 s of steps at 1,600 texels, half are of these; startup of 5 s is all of these.
        """
        costs(train_avatar={"": 2.0, "frames texels": 5 / 16_000, "steps": 0.05, "steps texels": 0.05 / 1600})
        found, times = estimate(atlas, {}), texels / 1600
        assert found.choices[0].factor == pytest.approx((1 + times) / 2)
        assert found.seconds["train_avatar"] == pytest.approx(2 + 5 * times + 100 * (1 + times))

    @pytest.mark.parametrize(
        ("pace", "seconds"), [(1.0, 8 + 0.01 * 6400), ({"evaluate_avatar": 2.0}, 16 + 0.02 * 6400)]
    )
    def test_stages_without_a_curve_take_what_jobs_with_so_many_take(self, choice, costs, pace, seconds) -> None:
        costs(evaluate_avatar={"avatars frames cameras": 0.2, "avatars texels": 0.01})
        found = choice(1000, pace)
        assert found.choices[0].setting == "0.3"
        assert found.seconds["evaluate_avatar"] == pytest.approx(seconds)

    def test_what_they_take_counts_for_the_choice(self, choice, costs) -> None:
        """The finest texels take 30 s of tracking, 6 of irradiance, 8 of scoring and 202 of training, 246 s.

        At 0.1 s a texel scoring takes 640 s more, and with the second finest 160.
        """
        assert choice(600 / 60).choices[0].setting == "0.3"
        costs(evaluate_avatar={"avatars frames cameras": 0.2, "avatars texels": 0.1})
        found = choice(600 / 60)
        assert found.choices[0].setting == "0.6"
        assert found.total == pytest.approx(30 + 6 + 8 + 160 + 202)
        assert choice(890 / 60).choices[0].setting == "0.3"

    @pytest.mark.parametrize(
        ("atlas", "lost"),
        [
            ({"texel_pixels": 0.9}, 0.75),  # a side of 1.5 lies between 1 and 2
            ({"texel_pixels": 1.23}, 1.0),  # as many as of 1.2, but for what laying them out makes of it
            ({"texel_pixels": 1.8}, 1.5),  # a side of 3, as it went last
            ({"texel_pixels": 0.2}, 0.0),  # finer than was measured
            ({"texel_pixels": 0.6, "most": 30}, 0.5),  # full at either size
            ({"texel_pixels": 0.3, "most": 30}, 0.5),
            ({"texel_pixels": 1.2, "most": 50}, 0.5 + 0.5 * (math.sqrt(1125 / 400) - 1)),
        ],
    )
    def test_error_is_of_those_that_this_capture_has(self, estimate, atlas, lost) -> None:
        # Texels are whole, and 178 at least: half of one is a sixth of a percent of the side.
        assert estimate(atlas, {"unwrap_atlas": atlas}).choices[0].error == pytest.approx(lost, rel=2e-3)


@pytest.mark.parametrize("slower", [1, 3])
def test_startup_is_as_long_whatever_a_step_takes(tmp_path, costs, slower) -> None:
    """Jobs take 2 s, 8 of frames, and 0.1 a step; where it was measured, startup took 10 s and a step 0.1.

    Without supersampling trainings of 200 steps took 20 s for 30: without startup half of a step. So they do on a
    machine that is slower.
    """
    costs(train_avatar={"": 2.0, "frames": 0.8, "steps": 0.1})
    curves = {
        STEPS: {"100": (1.0, 22.0), "1000": (0.1, 112.0), "2000": (0.0, 212.0)},
        SUPERSAMPLING: {"1": (0.5, 2 + 20.0 * slower, 200), "3": (0.0, 2 + 30.0 * slower, 200)},
    }
    _, estimate = choose(tmp_path, 100, {"train_avatar": {"steps": 1000}}, curves=curves)
    assert estimate.seconds["train_avatar"] == pytest.approx(2 + 8 + 100)
    _, estimate = choose(tmp_path, 100, {"train_avatar": {"steps": 1000, "supersample": 1}}, curves=curves)
    assert estimate.seconds["train_avatar"] == pytest.approx(2 + 8 + 50)


def test_two_small_losses_are_chosen_before_a_large_one(tmp_path) -> None:
    """Few steps with all samples take as long as twice as many without: 13.3 s of 202 at the defaults.

    They lose 2 dB for 1 and 1.05: fewer decibels, but more squared error, 0.58 for 0.26 and 0.27 of what there is.
    """
    curves = {
        STEPS: {"100": (2.0, 12.0), "200": (1.0, 22.0), "400": (0.0, 42.0)},
        SUPERSAMPLING: {"1": (1.05, 12.0), "3": (0.0, 22.0)},
    }
    _, estimate = choose(tmp_path, (30 + 6 + 8 + 2 + 14) / 60, {}, curves=curves)
    assert {choice.option: choice.setting for choice in estimate.choices} == {"steps": "200", "supersample": "1"}


def test_heads_take_longer_with_as_many_texels(tmp_path, costs) -> None:
    costs(train_avatar={"": 2.0, "steps texels": 1e-4, "steps head_texels": 1e-4})
    said = {"train_avatar": {"steps": 100}, "unwrap_atlas": {"size": 100}}
    taken = {}
    for kind in ("body", "head"):
        _, estimate = choose(tmp_path, 1000, said, CaptureSize(4, 10, 1000, 1, kind=kind))
        taken[kind] = estimate.seconds["train_avatar"]
    assert taken == pytest.approx({"body": 2 + 45, "head": 2 + 90})


def test_errors_are_expected_as_on_subjects_of_its_kind(tmp_path) -> None:
    """Their metrics differ by the length of the trainings."""
    lost = {"someones_body": (1.0, "PSNR lost, steps 400"), "someones_head": (0.2, "PSNR lost, steps 200")}
    path = write_subjects(
        tmp_path,
        {
            name: {(*SUPERSAMPLING[:3], metric, 0.1): {"1": (db, 3.0), "3": (0.0, 9.0)}}
            for name, (db, metric) in lost.items()
        },
    )
    content = yaml.safe_load((tmp_path / "subjects.yaml").read_text())
    (tmp_path / "subjects.yaml").write_text(yaml.safe_dump([{**one, "kind": one["subject"][9:]} for one in content]))
    read = read_curves(path), read_measured(tmp_path / "subjects.yaml")
    both = "PSNR lost, steps 400 on someones_body; PSNR lost, steps 200 on someones_head"
    assert read[0][0].metric == both
    for kind in ("body", "head"):
        settings = SubjectSettings(budget_minutes=1000, **merge(SHADOWED, {"train_avatar": {"supersample": 1}}))
        _, estimate = within_budget(
            "other", settings, {"train_avatar": {"supersample": 1}}, CaptureSize(4, 10, 1000, 1, kind=kind), *read
        )
        choice = estimate.choices[0]
        assert (choice.error, choice.metric) == lost[f"someones_{kind}"]


@pytest.mark.parametrize(
    ("kind", "material", "db"),
    [("body", "opaque", 0.1), ("body", "translucent", 0.9), ("head", "opaque", 0.4), ("head", "translucent", 0.4)],
)
def test_errors_are_expected_as_on_subjects_of_its_material(tmp_path, kind, material, db) -> None:
    """Of heads there is but one, and that will do for any."""
    lost = {"body opaque": 0.1, "body translucent": 0.9, "head opaque": 0.4}
    path = write_subjects(
        tmp_path, {name: {SUPERSAMPLING: {"1": (each, 3.0), "3": (0.0, 9.0)}} for name, each in lost.items()}
    )
    content = yaml.safe_load((tmp_path / "subjects.yaml").read_text())
    alike = [{**one, **dict(zip(("kind", "material"), one["subject"].split(), strict=True))} for one in content]
    (tmp_path / "subjects.yaml").write_text(yaml.safe_dump(alike))
    said = {"train_avatar": {"supersample": 1}}
    settings = SubjectSettings(budget_minutes=1000, **merge(SHADOWED, said))
    size = CaptureSize(4, 10, 1000, 1, kind=kind, material=material)
    read = read_curves(path), read_measured(tmp_path / "subjects.yaml")
    assert within_budget("other", settings, said, size, *read)[1].choices[0].error == pytest.approx(db)


def test_settings_are_chosen_by_all_materials_and_promised_by_its_own(tmp_path) -> None:
    """A body of wax loses 0.9 dB to fewer samples, an opaque one gains a little: more of them are bought."""
    curves = {
        "opaque": {SUPERSAMPLING: {"1": (-0.02, 3.0), "3": (0.0, 9.0)}},
        "wax": {SUPERSAMPLING: {"1": (0.9, 3.0), "3": (0.0, 9.0)}},
    }
    path = write_subjects(tmp_path, curves)
    content = yaml.safe_load((tmp_path / "subjects.yaml").read_text())
    content[1]["material"] = "translucent"
    (tmp_path / "subjects.yaml").write_text(yaml.safe_dump(content))
    read = read_curves(path), read_measured(tmp_path / "subjects.yaml")
    promised = {}
    for minutes in (3.5, 1000):
        settings = SubjectSettings(budget_minutes=minutes, **SHADOWED)
        choice = within_budget("other", settings, {}, CaptureSize(4, 10, 1000, 1), *read)[1].choices[0]
        promised[choice.setting] = choice.error
    assert promised == pytest.approx({"1": -0.02, "3": 0.0})


@pytest.mark.parametrize(
    ("said", "material"),
    [
        ({}, "opaque"),
        ({"source": "synthetic", "synthesize_capture": {"material": "translucent"}}, "translucent"),
        ({"plan_effects": {"learned_transport": "on"}}, "translucent"),
        ({"train_avatar": {"shading": "subsurface"}}, "translucent"),
        ({"train_avatar": {"shading": "transfer"}}, "opaque"),
    ],
)
def test_material_is_opaque_unless_settings_say_else(tmp_path, said, material) -> None:
    assert capture_size(SubjectSettings(**said), tmp_path, SAME_SIZE).material == material


def test_size_of_captures(tmp_path) -> None:
    made = SubjectSettings(
        source="synthetic", synthesize_capture={"cameras": 5, "frames": 7, "width": 20, "height": 30, "lights": 9}
    )
    assert capture_size(made, tmp_path, SAME_SIZE) == CaptureSize(5, 7, 600, 1, 9)
    (tmp_path / "capture.yaml").write_text("cameras: cameras.csv\nframes: frames.csv\nlights: lights.csv\n")
    pd.DataFrame({"camera": ["a", "b"], "width": [10, 30], "height": [10, 10]}).to_csv(tmp_path / "cameras.csv")
    pd.DataFrame({"frame": range(3)}).to_csv(tmp_path / "frames.csv", index=False)
    pd.DataFrame({"light": ["L0", "L1", "L2", "L3"]}).to_csv(tmp_path / "lights.csv", index=False)
    recorded = SubjectSettings(variants={"full": {}, "matte": {}})
    assert capture_size(recorded, tmp_path, SAME_SIZE) == CaptureSize(2, 3, 200, 2, 4)
    (tmp_path / "capture.yaml").write_text("kind: head\ncameras: cameras.csv\n")
    assert capture_size(recorded, tmp_path, SAME_SIZE).kind == "head"
    assert capture_size(recorded, tmp_path / "nowhere", SAME_SIZE) == CaptureSize(4, 10, 1000, 2, 1)
