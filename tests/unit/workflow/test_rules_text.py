"""Command lines of the rules, as they are written."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

RULES = sorted((Path(__file__).resolve().parents[3] / "workflow/rules").glob("*.smk"))
CALLS = {
    stage: words
    for path in RULES
    for stage, words in re.findall(r'"python -m pipeline\.stages\.(\w+) ((?:[^"]|"\s*")*?) > \{log', path.read_text())
}


def test_every_stage_has_a_rule():
    stages = {path.stem for path in (RULES[0].parents[2] / "pipeline/stages").glob("[a-z]*.py")}
    assert set(CALLS) == stages


@pytest.mark.parametrize("stage", CALLS)
def test_stages_that_read_the_capture_are_told_where_it_lies(stage):
    """The folder may be moved without a rerun, so it is no argument like the others."""
    takes = "capture" in inspect.signature(importlib.import_module(f"pipeline.stages.{stage}").run).parameters
    assert ("--capture {params.capture:q}" in CALLS[stage]) == takes


def test_rules_of_stages_that_read_the_capture_have_it_as_input_where_it_is_fetched():
    """From object storage, where it is no folder that is there anyway."""
    rules = [rule for path in RULES for rule in re.split(r"(?m)^(?:use rule|rule|checkpoint) ", path.read_text())]
    reading = [rule for rule in rules if "capture=capture_folder" in rule]
    assert len(reading) >= 15
    for rule in reading:
        declared = rule.partition("output:")[0]
        assert "stored=stored_capture" in declared or "capture_files(wildcards.subject)" in declared, rule


@pytest.mark.parametrize("stage", CALLS)
def test_every_stage_asks_for_memory_and_time_by_its_own_size(stage):
    rules = [rule for path in RULES for rule in re.split(r"(?m)^(?:rule|checkpoint) ", path.read_text())]
    (rule,) = [rule for rule in rules if f'"python -m pipeline.stages.{stage} ' in rule]
    for asked in ("mem_mb=memory_for", "runtime=minutes_for"):
        assert f'{asked}("{stage}")' in rule or f'{asked}("{stage}", size_' in rule
    assert f'threads: threads_for("{stage}")' in rule or "threads: all_cores" in rule


@pytest.mark.parametrize("stage", CALLS)
def test_edit_of_a_stages_code_or_of_its_settings_is_a_parameter_of_its_rule(stage):
    """Neither is a file that Snakemake compares: what is no parameter reruns nothing."""
    rules = [rule for path in RULES for rule in re.split(r"(?m)^(?:rule|checkpoint) ", path.read_text())]
    (rule,) = [rule for rule in rules if f'"python -m pipeline.stages.{stage} ' in rule]
    alone, among = f'code=code_for("{stage}")', f'code_for(stage)(wildcards) for stage in ("{stage}", *'
    assert alone in rule or f"code=lambda wildcards: [{among}" in rule
    assert f'settings=settings_for("{stage}")' in rule or f"settings=flags(project.settings.{stage})" in rule
