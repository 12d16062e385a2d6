"""config/config.yaml, the JSON schema and the page about captures say what the models say."""

from __future__ import annotations

import json

import pytest
import yaml
from pydantic import BaseModel

from pipeline.capture.schema.format_page import format_page
from pipeline.config.datasets import WITHOUT_PROTOCOL
from pipeline.config.loading import load_project
from pipeline.config.project import SECTIONS, ProjectSettings
from pipeline.config.schema import config_schema, config_yaml


def test_generated_files_are_in_step_with_the_models(repo_root):
    hint = "run `make schema`"
    assert (repo_root / "config/config.yaml").read_text() == config_yaml(), hint
    assert (repo_root / "workflow/schemas/config.schema.json").read_text() == config_schema(), hint
    assert (repo_root / "config/capture_format.md").read_text() == format_page(), hint


def test_defaults_file_reads_back_to_the_defaults():
    assert ProjectSettings(**yaml.safe_load(config_yaml())) == ProjectSettings()


def test_defaults_file_names_every_setting_once():
    content = yaml.safe_load(config_yaml())
    assert content.keys() == ProjectSettings.model_fields.keys()
    assert all(content[stage].keys() == model.model_fields.keys() for stage, model in SECTIONS.items())


def test_every_section_is_named_after_its_stage(repo_root):
    stages = {path.stem for path in (repo_root / "pipeline/stages").glob("*.py")}
    assert set(SECTIONS) <= stages
    assert all(model.__name__ == stage.title().replace("_", "") for stage, model in SECTIONS.items())


@pytest.mark.parametrize("model", [ProjectSettings, *SECTIONS.values()])
def test_every_setting_is_described(model):
    undescribed = [
        name
        for name, field in model.model_fields.items()
        if not field.description
        and not (isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel))
    ]
    assert not undescribed


def test_schema_refuses_unknown_keys():
    schema = json.loads(config_schema())
    assert schema["additionalProperties"] is False
    assert all(definition["additionalProperties"] is False for definition in schema["$defs"].values())


def test_presets_are_valid_and_change_something(repo_root):
    refused = {f"set_{dataset}" for dataset in WITHOUT_PROTOCOL}
    presets = [path for path in sorted((repo_root / "config/presets").glob("*.yaml")) if path.stem not in refused]
    assert presets
    for path in presets:
        changes = yaml.safe_load(path.read_text())
        project = load_project(yaml.safe_load(config_yaml()) | {}, changes, repo_root / "config/subjects")
        assert changes
        assert project.subject("subjectA").variants == changes.pop("variants", {"full": {}}), path
        for section, values in changes.items():
            assert values.keys() <= SECTIONS[section].model_fields.keys(), path
            found = getattr(project.subject("subjectA"), section).model_dump(mode="json")
            assert found.items() >= values.items(), path
