"""Who wins, and what is said when the configuration is wrong."""

from __future__ import annotations

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.config.loading import load_project
from pipeline.config.project import ProjectSettings
from pipeline.config.sections import has_own_light, merge, section_for

DEFAULTS = ProjectSettings().model_dump(mode="json")


def load(tmp_path, subjects=None, command_line=None, config=None):
    """A project of subject files (name -> content or raw text)."""
    for name, content in (subjects or {}).items():
        text = content if isinstance(content, str) else yaml.safe_dump(content, sort_keys=False)
        (tmp_path / f"{name}.yaml").write_text(text)
    changes = command_line or {}
    return load_project(merge(merge(DEFAULTS, config or {}), changes), changes, tmp_path)


def complaints(tmp_path, **arguments):
    with pytest.raises(InputError) as caught:
        load(tmp_path, **arguments)
    return str(caught.value).replace(f"{tmp_path}/", "").splitlines()


def test_subject_without_a_file_has_the_defaults(tmp_path):
    settings = load(tmp_path, config={"train_avatar": {"steps": 7}}).subject("anyone")
    assert settings.train_avatar.steps == 7
    assert settings.source == "native"


def test_subject_file_wins_over_defaults_and_keeps_the_rest(tmp_path):
    project = load(tmp_path, {"demo": {"train_avatar": {"steps": 9}}}, config={"train_avatar": {"log_every": 3}})
    assert (project.subject("demo").train_avatar.steps, project.subject("demo").train_avatar.log_every) == (9, 3)
    assert project.subject("other").train_avatar.steps == DEFAULTS["train_avatar"]["steps"]


def test_command_line_wins_over_subject_file(tmp_path):
    project = load(tmp_path, {"demo": {"train_avatar": {"steps": 9}}}, {"train_avatar": {"steps": 11}, "captures": "x"})
    assert project.subject("demo").train_avatar.steps == 11
    assert project.settings.captures == "x"


def test_a_public_set_needs_a_path_and_nothing_else_has_one(tmp_path):
    project = load(tmp_path, {"a": {"source": "goliath", "path": "/data/a"}, "b": {"source": "synthetic"}})
    assert (project.imported_subjects, project.synthetic_subjects) == (["a"], ["b"])
    with pytest.raises(InputError, match=r"a\.yaml: path: expected the folder of a goliath capture, found none"):
        load(tmp_path, {"a": {"source": "goliath"}})
    with pytest.raises(InputError, match=r"a\.yaml: source: expected one of goliath, .*, found 'native'"):
        load(tmp_path, {"a": {"path": "/data/a"}})


def test_synthetic_subjects_are_those_that_say_so(tmp_path):
    project = load(tmp_path, {"b": {"source": "synthetic"}, "a": {"source": "synthetic"}, "c": {}, "d": ""})
    assert project.synthetic_subjects == ["a", "b"]


def test_variants_of_a_subject_replace_those_of_the_project(tmp_path):
    project = load(tmp_path, {"demo": {"variants": {"quick": {"steps": 5}, "plain": {"specular": False}}}})
    settings = project.subject("demo")
    assert list(settings.variants) == ["quick", "plain"]
    assert section_for(settings, "train_avatar", "quick").steps == 5
    assert section_for(settings, "train_avatar", "plain").steps == settings.train_avatar.steps
    assert section_for(settings, "train_avatar", "plain").specular == "off"


@pytest.mark.parametrize(("text", "mode"), [("on", "on"), ("off", "off"), ("auto", "auto"), ("'on'", "on")])
def test_on_and_off_need_no_quotes(tmp_path, text, mode):
    project = load(tmp_path, {"demo": f"plan_effects: {{shadow: {text}}}\n"})
    assert project.subject("demo").plan_effects.shadow == mode


def test_everything_wrong_is_said_at_once_with_file_key_expected_and_found(tmp_path):
    lines = complaints(
        tmp_path,
        subjects={
            "one": {"train_avatar": {"steps": 0, "setps": 3}, "captures": "elsewhere"},
            "two": {"unwrap_atlas": {"size": "large"}, "variants": {"v": {"log_every": 0}}},
            "three": "train_avatar: [",
            "four": "- a list",
            "not a name": {},
        },
        command_line={"chunk_frames": 0},
    )
    text = "\n".join(lines)
    assert lines[0] == f"configuration: {len(lines) - 1} problems"
    assert len(set(lines)) == len(lines)
    for expected in (
        "one.yaml: train_avatar.steps: expected greater than or equal to 1, found 0",
        "one.yaml: train_avatar.setps: expected a known key, found an unknown one; did you mean steps?",
        "one.yaml: captures: expected a known key, found an unknown one",
        "two.yaml: unwrap_atlas.size: expected a valid integer, unable to parse string as an integer, found 'large'",
        "three.yaml: expected valid YAML, found",
        "four.yaml: file: expected keys with values, found list",
        "not a name.yaml: file name: expected a subject's name",
        "command line (--config, --configfile): chunk_frames: expected greater than or equal to 1, found 0",
    ):
        assert expected in text


def test_wrong_variant_names_the_variant(tmp_path):
    lines = complaints(tmp_path, subjects={"two": {"variants": {"v": {"log_every": 0, "nothing": 1}, "bad name": {}}}})
    assert any("two.yaml: variants.bad name: expected" in line for line in lines)
    lines = complaints(tmp_path, subjects={"two": {"variants": {"v": {"log_every": 0, "nothing": 1}}}})
    assert "  two.yaml: variants.v.log_every: expected greater than or equal to 1, found 0" in lines
    assert any("two.yaml: variants.v.nothing: expected a known key" in line for line in lines)


@pytest.mark.parametrize("pace", [0, -1.0, {"train_avatar": 0}])
def test_pace_is_more_than_nothing(tmp_path, pace):
    lines = complaints(tmp_path, command_line={"machine_pace": pace})
    assert len(lines) > 1 and all("machine_pace" in line for line in lines[1:])


def test_pace_of_what_is_no_stage(tmp_path):
    lines = complaints(tmp_path, command_line={"machine_pace": {"train_avatr": 2.0}})
    assert "machine_pace: expected paces of stages, such as train_avatar, found {'train_avatr': 2.0}" in lines[1]


def test_geometry_comes_from_another_variant_and_never_in_a_circle(tmp_path):
    def lines(**variants):
        return complaints(tmp_path, subjects={"two": {"variants": variants}})[1:]

    load(tmp_path, {"two": {"variants": {"full": {}, "pbr": {"geometry_from": "full"}}}})
    (line,) = lines(full={}, pbr={"geometry_from": "ful"})
    assert line.endswith("two.yaml: variants.pbr.geometry_from: expected another variant, which does not come back to "
                         "this one, found 'ful', of full, pbr")  # fmt: skip
    (line,) = lines(full={"geometry_from": "full"})
    assert "found full -> full" in line
    whole = complaints(tmp_path, subjects={"two": {"train_avatar": {"geometry_from": "none"}}})
    assert "two.yaml: train_avatar.geometry_from: expected another variant" in whole[1]
    both = lines(a={"geometry_from": "b"}, b={"geometry_from": "a"})
    assert ["found a -> b -> a" in both[0], "found b -> a -> b" in both[1]] == [True, True]
    (line,) = lines(a={"geometry_from": "b"}, b={"steps": 0})
    assert "variants.b.steps" in line


def test_section_of_training_inside_a_variant_is_refused(tmp_path):
    """It was left out without a word, and the variant was the one without it."""
    variants = {"matte": {"train_avatar": {"specular": False, "nonsense": 3}}}
    (line,) = complaints(tmp_path, subjects={"two": {"variants": variants}})[1:]
    assert line.startswith(
        "  two.yaml: variants.matte.train_avatar: expected settings of train_avatar beside each other"
    )
    lines = complaints(tmp_path, command_line={"variants": variants})
    assert any(
        line.startswith("  command line (--config, --configfile): variants.matte.train_avatar") for line in lines
    )


@pytest.mark.parametrize("text", [".nan", ".inf", "true", "yes"])
def test_number_is_finite_and_not_a_truth_value(tmp_path, text):
    (line,) = complaints(tmp_path, subjects={"one": f"train_avatar: {{weight_mask: {text}}}\n"})[1:]
    assert line.startswith("  one.yaml: train_avatar.weight_mask: expected a ")
    (line,) = complaints(tmp_path, subjects={"one": f"relight_avatar: {{gaze_direction: [0, 0, {text}]}}\n"})[1:]
    assert "one.yaml: relight_avatar.gaze_direction" in line


def test_key_that_is_there_twice_is_refused(tmp_path):
    (line,) = complaints(tmp_path, subjects={"one": "train_avatar: {steps: 5, steps: 7}\n"})[1:]
    assert "one.yaml: expected valid YAML, found: the key 'steps' is there twice" in line


@pytest.mark.parametrize("name", ["-rf", "--help", "-"])
def test_variant_is_not_called_like_an_option(tmp_path, name):
    assert any("variants" in line for line in complaints(tmp_path, subjects={"two": {"variants": {name: {}}}}))


def test_variants_may_ask_for_other_irradiance_maps(tmp_path):
    variants = {"full": {}, "few": {"steps": 7, "trace_irradiance": {"samples": "1"}}, "same": {"trace_irradiance": {}}}
    settings = load(tmp_path, {"demo": {"variants": variants}}).subject("demo")
    assert [name for name in variants if has_own_light(settings, name)] == ["few"]
    traced, trained = (section_for(settings, stage, "few") for stage in ("trace_irradiance", "train_avatar"))
    assert (traced.samples, trained.steps) == ("1", 7)
    assert section_for(settings, "relight_avatar", "few") == settings.relight_avatar


def test_wrong_irradiance_of_a_variant_names_the_variant(tmp_path):
    variants = {"v": {"trace_irradiance": {"samples": "none", "rays": 3}}, "w": {"trace_irradiance": 4}}
    lines = complaints(tmp_path, subjects={"two": {"variants": variants}})
    assert any("two.yaml: variants.v.trace_irradiance.samples: expected" in line for line in lines)
    assert any("two.yaml: variants.v.trace_irradiance.rays: expected a known key" in line for line in lines)
    assert "  two.yaml: variants.w.trace_irradiance: expected keys of trace_irradiance, found 4" in lines


def test_wrong_default_is_said_once_and_names_the_defaults_file(tmp_path):
    lines = complaints(tmp_path, subjects={"one": {}, "two": {}}, config={"train_avatar": {"steps": -1}})
    assert lines[1:] == [
        "  config/config.yaml: train_avatar.steps: expected greater than or equal to 1, found -1",
    ]


def test_section_that_is_no_mapping_is_refused(tmp_path):
    assert any(
        "one.yaml: train_avatar: expected" in line
        for line in complaints(tmp_path, subjects={"one": {"train_avatar": 3}})
    )


def test_section_under_its_old_name_is_read_from_files_and_from_the_command_line(tmp_path):
    written = load(tmp_path, {"demo": {"unwrap_textures": {"cosine_power": 3.0}}})
    assert written.subject("demo").bake_textures.cosine_power == 3.0
    assert written.subject("other").bake_textures.cosine_power == DEFAULTS["bake_textures"]["cosine_power"]
    given = load(tmp_path, command_line={"unwrap_textures": {"cosine_power": 2.0}})
    assert given.subject("demo").bake_textures.cosine_power == 2.0
