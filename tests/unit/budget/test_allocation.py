"""What a budget chooses, what it leaves alone, and what it refuses, on curves made by hand."""

from __future__ import annotations

import math

import pytest
import yaml
from pydantic import ValidationError

from pipeline.base.errors import InputError
from pipeline.budget.allocation import within_budget
from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curves import read_curves, read_measured
from pipeline.budget.resolved_project import resolve_budgets
from pipeline.budget.run_seconds import stages_on_the_way
from pipeline.config.loading import load_project
from pipeline.config.project import ProjectSettings, SubjectSettings
from pipeline.config.sections import merge
from tests.support.results.chosen_budgets import SAME_SIZE, SHADOWED, choose
from tests.support.results.curve_files import CURVES, write_curves, write_subjects

pytestmark = pytest.mark.usefixtures("costs")


def test_plenty_of_time_buys_the_smallest_error(tmp_path) -> None:
    settings, estimate = choose(tmp_path, 1.5)
    assert (settings.train_avatar.steps, settings.train_avatar.supersample) == (400, 3)
    assert settings.trace_irradiance.samples == "full"
    # 2 s of imports each; 20 s of work of training at 200 steps are 40 at 400.
    expected = {"track_mesh": 30.0, "trace_irradiance": 6.0, "train_avatar": 42.0, "evaluate_avatar": 8.0}
    assert {stage: seconds for stage, seconds in estimate.seconds.items() if seconds} == pytest.approx(expected)
    assert estimate.total == pytest.approx(86)


def test_default_beyond_what_was_measured_is_best(tmp_path) -> None:
    settings, estimate = choose(tmp_path, 1000)
    assert settings.train_avatar.steps == 2000
    assert estimate.seconds["train_avatar"] == pytest.approx(202)
    (error,) = [choice.error for choice in estimate.choices if choice.dial == "training_steps"]
    assert math.isnan(error)
    assert choose(tmp_path, 4)[0].train_avatar.steps == 400  # 30 + 6 + 202 + 8 s are more


def test_little_time_is_spent_where_it_saves_most(tmp_path) -> None:
    # 66 s: 20 less. 200 steps lose 2.9 tolerances for 20 s; one sample per texel would lose 50 for 3 s.
    settings, estimate = choose(tmp_path, 66.001 / 60)
    assert (settings.train_avatar.steps, settings.train_avatar.supersample) == (200, 3)
    assert settings.trace_irradiance.samples == "full"
    assert estimate.total == pytest.approx(66)
    assert estimate.total <= estimate.budget_s


def test_whatever_is_chosen_fits_and_the_last_millisecond_counts(tmp_path) -> None:
    """A budget of exactly what is estimated is kept to; a millisecond less buys less, imports and all."""
    budget_s, chosen = 90.0, []
    while True:
        try:
            _, estimate = choose(tmp_path, budget_s / 60)
        except InputError:
            break
        assert estimate.total <= estimate.budget_s + 1e-9
        _, again = choose(tmp_path, (estimate.total + 1e-6) / 60)
        assert again.total == pytest.approx(estimate.total)
        chosen.append(estimate.total)
        budget_s = estimate.total - 0.001
    assert len(chosen) > 3 and chosen == sorted(set(chosen), reverse=True)
    # The cheapest of everything: 30 + 3 + (2 + 5) + 8, of 100 steps without supersampling and one ray.
    assert chosen[-1] == pytest.approx(48)


def test_stages_take_what_jobs_of_their_size_took(tmp_path, costs) -> None:
    """By the table of costs, and with the texels that pixels ask for."""
    costs(pack_shards={"": 1.0, "frames cameras pixels": 1e-4}, plan_effects={"texels": 0.01})
    _, estimate = choose(tmp_path, 1000)
    assert estimate.seconds["pack_shards"] == pytest.approx(1 + 4)
    assert estimate.seconds["plan_effects"] == pytest.approx(16)  # 1.6 texels a pixel
    _, larger = choose(tmp_path, 1000, {"chunk_frames": 3}, CaptureSize(8, 10, 2000, 1, kind="head"))
    assert larger.seconds["pack_shards"] == pytest.approx(4 * 1 + 16)  # four jobs start
    assert larger.seconds["plan_effects"] == pytest.approx(92)  # 4.6 of a head


def test_slow_machine_needs_more_of_everything(tmp_path) -> None:
    path = write_curves(tmp_path / "curves")
    read = read_curves(path), read_measured(path.parent / "subjects.yaml")
    settings = SubjectSettings(budget_minutes=2.2, **SHADOWED)
    _, estimate = within_budget("someone", settings, {}, SAME_SIZE, *read, 1.5)
    assert estimate.total == pytest.approx(1.5 * 86)
    assert set(estimate.paces.values()) == {1.5}
    _, by_stage = within_budget("someone", settings, {}, SAME_SIZE, *read, {"track_mesh": 2.0})
    assert by_stage.seconds["track_mesh"] == pytest.approx(2 * 30)
    assert by_stage.total == pytest.approx(86 + 30)


def test_stages_that_a_capture_needs() -> None:
    shadowed, head = SubjectSettings(**SHADOWED), CaptureSize(4, 10, 1000, 1, kind="head")
    assert "trace_irradiance" in stages_on_the_way(shadowed, SAME_SIZE)
    assert not {"fit_eyes", "bake_textures"} & set(stages_on_the_way(shadowed, SAME_SIZE))
    assert {"fit_eyes", "bake_textures"} < set(stages_on_the_way(SubjectSettings(), head))
    assert "trace_irradiance" not in stages_on_the_way(SubjectSettings(), head)


class TestSeveralSubjects:
    """Of two subjects, the second of which loses more and is slower."""

    KEY = ("training_steps", "train_avatar", "steps", "PSNR lost, dB", 0.1)

    @pytest.fixture
    def curve(self, tmp_path):
        first = {self.KEY: {"1000": (0.3, 12.0), "2000": (0.0, 22.0), "50": (3.0, 2.5)}}
        second = {self.KEY: {"1000": (0.9, 42.0), "2000": (0.05, 162.0)}}
        (curve,) = read_curves(write_subjects(tmp_path / "two", {"quick": first, "slow": second}))
        return curve

    def test_settings_of_all_subjects_count(self, curve) -> None:
        assert curve.settings == ("1000", "2000")

    def test_errors_are_means_and_losses_are_of_each(self, curve) -> None:
        assert curve.error(1000) == pytest.approx(0.6)
        assert curve.losses(1000) == pytest.approx([3.0, 9.0])

    def test_factors_are_geometric_means_over_the_default(self, curve) -> None:
        assert curve.factor(2000) == pytest.approx(1)
        assert curve.factor(1000) == pytest.approx(math.sqrt(0.5 * 0.25))

    def test_the_worst_subject_decides_what_is_good_enough(self, curve) -> None:
        assert curve.cheapest(8.9) == "2000"
        assert curve.cheapest(9.1) == "1000"

    def test_budget_loses_the_mean_and_says_whose(self, tmp_path, curve) -> None:
        settings = SubjectSettings(budget_minutes=1000, **SHADOWED)
        chosen, estimate = within_budget(
            "someone", settings, {}, SAME_SIZE, [curve], read_measured(tmp_path / "two/subjects.yaml")
        )
        assert chosen.train_avatar.steps == 2000
        assert (estimate.choices[0].error, estimate.measured_on) == (pytest.approx(0.025), "quick, slow")
        assert estimate.seconds["train_avatar"] == pytest.approx(202)


def test_texels_that_the_user_lays_out_are_not_chosen(tmp_path, costs) -> None:
    costs(train_avatar={"": 2.0, "steps texels": 0.1 / 1600})
    key = ("texel_size", "unwrap_atlas", "texel_pixels", "PSNR lost, dB", 0.1)
    finer = {key: {"1.2": (0.5, 7.0), "0.6": (0.1, 22.0), "0.45": (0.0, 42.0)}}
    settings, estimate = choose(tmp_path, 1000, curves=finer)
    assert settings.unwrap_atlas.texel_pixels == 0.45
    assert estimate.seconds["train_avatar"] == pytest.approx(2 + 200 * (0.6 / 0.45) ** 2, rel=1e-3)  # they are whole
    settings, estimate = choose(tmp_path, 1000, {"unwrap_atlas": {"size": 64}}, curves=finer)
    assert settings.unwrap_atlas.texel_pixels == 0.6
    assert [choice.by for choice in estimate.choices] == ["user"]


def test_work_beyond_what_was_measured_goes_on_as_it_went_last(tmp_path) -> None:
    key = ("training_steps", "train_avatar", "steps", "PSNR lost", 0.1)
    bent = {key: {"100": (1.0, 12.0), "200": (0.5, 17.0), "400": (0.0, 37.0)}}
    ((curve,),) = (curve.parts for curve in read_curves(write_curves(tmp_path / "curves", bent)))
    # Without 2 s of imports: 10, 15 and 35 s; 5 s per 100 steps before the first, 10 after the last.
    assert curve.work(800) == pytest.approx(75)
    assert curve.work(50) == pytest.approx(7.5)


def test_what_takes_no_part_in_metrics_is_not_chosen(tmp_path) -> None:
    settings, estimate = choose(tmp_path, 2)
    assert settings.relight_avatar == SubjectSettings().relight_avatar
    assert "environment_shadows" not in {choice.dial for choice in estimate.choices}


def test_what_the_user_says_stays_and_is_counted(tmp_path) -> None:
    settings, estimate = choose(tmp_path, 1000, {"train_avatar": {"steps": 300, "supersample": 1}})
    assert (settings.train_avatar.steps, settings.train_avatar.supersample) == (300, 1)
    by = {choice.dial: (choice.by, choice.setting) for choice in estimate.choices}
    assert by == {
        "training_steps": ("user", "300"),
        "supersampling": ("user", "1"),
        "irradiance_power": ("budget", "full"),
    }
    # 300 steps take 30 s, and supersampling of 1 half of that.
    assert estimate.seconds["train_avatar"] == pytest.approx(17)
    error = {choice.dial: choice.error for choice in estimate.choices}
    assert error["training_steps"] == pytest.approx((0.3 + 0.01) / 2)


def test_setting_far_from_what_was_measured_has_a_time_and_no_error(tmp_path) -> None:
    _, estimate = choose(tmp_path, 1000, {"train_avatar": {"steps": 4000}})
    assert estimate.seconds["train_avatar"] == pytest.approx(2 + 400)
    (error,) = [choice.error for choice in estimate.choices if choice.dial == "training_steps"]
    assert math.isnan(error)
    assert "unknown" in "\n".join(estimate.lines())


def test_a_larger_capture_takes_longer(tmp_path) -> None:
    _, small = choose(tmp_path, 1.5)
    _, large = choose(tmp_path, 7, size=CaptureSize(8, 30, 1000, 2), said={"variants": {"a": {}, "b": {}}})
    assert large.seconds["track_mesh"] == pytest.approx(6 * 30)
    assert large.seconds["trace_irradiance"] == pytest.approx(2 + 3 * 4)
    assert large.seconds["train_avatar"] == pytest.approx(2 * (2 + 40))
    assert large.seconds["evaluate_avatar"] == pytest.approx(8 * 6 * 2)
    assert large.total > small.total


def test_budget_that_cannot_be_met_says_how_much_is_needed_and_what_is_held(tmp_path) -> None:
    with pytest.raises(InputError) as caught:
        choose(tmp_path, 0.5, {"train_avatar": {"steps": 400}})
    text = str(caught.value)
    # 30 + 3 + (2 + 40 / 2) + 8
    assert "expected at least 1.05 minutes of one processor, found 0.5" in text
    assert "train_avatar.steps 400" in text and "track_mesh 0.5" in text


@pytest.mark.parametrize("minutes", [0, -3, "soon"])
def test_budget_that_is_no_time_is_refused(minutes) -> None:
    with pytest.raises(ValidationError, match="budget_minutes"):
        SubjectSettings(budget_minutes=minutes)


def test_dial_without_a_curve_stays_as_it_is(tmp_path) -> None:
    some = {key: value for key, value in CURVES.items() if key[0] == "irradiance_power"}
    settings, estimate = choose(tmp_path, 5, curves=some)
    assert settings.train_avatar == SubjectSettings(**SHADOWED).train_avatar
    assert [choice.dial for choice in estimate.choices] == ["irradiance_power"]


def test_quality_of_pictures_is_estimated_for_the_measured_subject_alone(tmp_path) -> None:
    assert math.isnan(choose(tmp_path, 1000)[1].psnr_db)
    # 200 steps lost 0.3 dB, 400 lose 0.01, beside 0.01 of the supersampling: of each, what is beyond the best adds.
    expected = 30 + 10 * math.log10((10**0.03 + 10**0.001 - 1) / (2 * 10**0.001 - 1))
    assert choose(tmp_path, 1.5, subject="measured")[1].psnr_db == pytest.approx(expected)
    assert choose(tmp_path, 1000, subject="measured")[1].psnr_db == pytest.approx(expected)  # beyond: as good


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("seconds", "minutes", "expected the column seconds, found"),
        (",steps,", ",setps,", "training_steps: expected a setting of a stage, found train_avatar.setps"),
        ("imports only", "imports", "expected settings with errors and seconds, and imports only"),
    ],
)
def test_curves_that_make_no_sense(tmp_path, old, new, complaint) -> None:
    path = write_curves(tmp_path / "curves")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(InputError, match=complaint):
        read_curves(path)


def test_no_curves_at_all(tmp_path) -> None:
    with pytest.raises(InputError, match="run `make curves`"):
        read_curves(tmp_path / "accuracy_cost.csv")
    with pytest.raises(InputError, match="run `make curves`"):
        read_measured(tmp_path / "subjects.yaml")


class TestProject:
    @pytest.fixture
    def project(self, tmp_path, monkeypatch):
        """A project in tmp_path with a subject's file; a function of the command line."""
        monkeypatch.chdir(tmp_path)
        write_curves(tmp_path / "config/curves")
        (tmp_path / "subjects").mkdir()
        own = {"train_avatar": {"steps": 100}}
        (tmp_path / "subjects/someone.yaml").write_text(yaml.safe_dump(own))

        said = []

        def load(command_line):
            defaults = merge(ProjectSettings().model_dump(mode="json"), command_line)
            return resolve_budgets(load_project(defaults, command_line, tmp_path / "subjects"), said.append)

        load.said = said
        return load

    def test_without_a_budget_nothing_changes(self, project) -> None:
        assert project({}).subject("other").train_avatar == SubjectSettings().train_avatar
        assert project({}).estimate("other") is None

    def test_defaults_give_way_and_files_and_command_line_do_not(self, project) -> None:
        loaded = project({"budget_minutes": 1000, "trace_irradiance": {"samples": "2"}, **SHADOWED})
        assert loaded.subject("someone").train_avatar.steps == 100
        assert loaded.subject("someone").trace_irradiance.samples == "2"
        assert loaded.subject("other").train_avatar.steps == 2000
        assert sum("budget 1e+03 minutes" in line for line in project.said) == 2  # once for each subject
        assert {choice.dial for choice in loaded.estimate("other").choices if choice.by == "user"} == {
            "irradiance_power"
        }

    def test_pace_of_the_machine_counts(self, project) -> None:
        usual, slow = (
            project({"budget_minutes": 1000, **more}).estimate("other") for more in ({}, {"machine_pace": 2})
        )
        assert slow.total == pytest.approx(2 * usual.total)

    def test_budget_of_one_subject_is_not_asked_of_others(self, project) -> None:
        loaded = project({"budget_minutes": 0.001})
        assert loaded.settings.budget_minutes == 0.001
        with pytest.raises(InputError, match="someone: budget_minutes"):
            loaded.subject("someone")
