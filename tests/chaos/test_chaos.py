"""Some of each kind of attack, and the harness itself: `make chaos` runs all of them on a whole capture."""

from __future__ import annotations

import copy
import random
import subprocess
import sys
from types import SimpleNamespace

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.schema.manifest import read_manifest
from pipeline.config.loading import load_project
from tests.support.captures.builder import MANIFEST
from tests.support.chaos import forked_stage, records, twice
from tests.support.chaos.mutations.mutation import Meaning
from tests.support.chaos.outcome import DEFECTS, Outcome, Result
from tests.support.chaos.settings import VALUES, is_wrong
from tests.support.chaos.sound_run import SoundRun

SEED, SETTINGS = 20, 40


@pytest.fixture(scope="module")
def sampled(repo_root, tmp_path_factory):
    """What came of some attacks; see `tests.chaos.sampled`."""
    folder = tmp_path_factory.mktemp("chaos")
    command = [sys.executable, "-m", "tests.chaos.sampled", str(folder)]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return records.read(folder / "attacks.csv")


def of(found, part):
    return [record for record in found if record.part.startswith(part)]


def test_bad_captures_are_refused_in_words_or_indexed(sampled):
    captures = of(sampled, "captures")
    assert not records.defects(captures)
    refused = [record for record in captures if record.outcome is Outcome.CLEAR]
    assert len(captures) / 3 < len(refused) < len(captures)
    assert all("expected" in record.said for record in refused)
    assert {record.part.partition(", ")[2] for record in captures} == set(Meaning)


def test_stage_killed_at_any_change_of_files_goes_on_to_the_same_bytes(sampled):
    kills = of(sampled, "kills")
    assert len(kills) == 4
    assert [record.outcome for record in kills] == [Outcome.RIGHT] * len(kills), kills


def test_stage_without_room_or_handles_says_so_and_then_works(sampled):
    scarce = of(sampled, "surroundings")
    assert [record.outcome for record in scarce] == [Outcome.CLEAR] * 2, scarce


def test_stage_that_leaves_files_dies_or_stands_still_is_noticed(sampled):
    found = [record.outcome for record in of(sampled, "harness")]
    assert found == [Outcome.DIFFERING, Outcome.TRACEBACK, Outcome.HANG]


CONTENTS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=25)
@given(data=st.data())
def test_any_value_of_any_key_of_the_description_is_taken_or_complained_of(tmp_path_factory, data):
    root = tmp_path_factory.getbasetemp() / "described"
    root.mkdir(exist_ok=True)
    content = copy.deepcopy(MANIFEST)
    section = data.draw(st.sampled_from([content, *(value for value in content.values() if isinstance(value, dict))]))
    section[data.draw(st.sampled_from(sorted(section)) | st.text(max_size=5))] = data.draw(CONTENTS)
    (root / "capture.yaml").write_text(yaml.safe_dump(content, allow_unicode=True))
    complaints = Complaints("described")
    with complaints.collecting():
        read_manifest(root, complaints)
    assert all("expected" in message for message in complaints.messages)


def test_settings_that_the_published_schema_refuses_are_refused(repo_root, tmp_path):
    defaults = yaml.safe_load((repo_root / "config/config.yaml").read_text())
    places = [(section, key) for section, keys in defaults.items() if isinstance(keys, dict) for key in keys]
    rng, wrong = random.Random(SEED), 0
    for section, key in rng.sample([place for place in places if place[0] != "variants"], SETTINGS):
        value = rng.choice(VALUES)
        (tmp_path / "someone.yaml").write_text(yaml.safe_dump({section: {key: value}}, allow_unicode=True))
        try:
            load_project(defaults, {}, tmp_path)
        except InputError as error:
            # A section that is the whole project's has no place in a subject's file.
            assert f"{section}.{key}" in str(error) or f"{section}: expected a known key" in str(error)
        else:
            assert not is_wrong(section, key, value), f"{section}.{key}: {value!r}"
        wrong += is_wrong(section, key, value)
    assert wrong > SETTINGS / 3


@pytest.mark.parametrize(("second", "outcome"), [("a", Outcome.RIGHT), ("b", Outcome.DIFFERING)])
def test_runs_of_another_subject_are_compared_with_its_own_first(tmp_path, monkeypatch, second, outcome):
    contents = {2: "a", 1: second}

    def start(words, folder):
        file = folder / "results/other/metrics.csv"
        assert words == ["--cores", words[1], "--", "results/other/metrics.csv"]
        file.parent.mkdir(parents=True)
        file.write_text(contents[int(words[1])])
        return SimpleNamespace(ended=lambda allowed_s: forked_stage.Ended(0, ""))

    monkeypatch.setattr(forked_stage, "start_snakemake", start)
    (attack,) = twice.attacks(SoundRun(tmp_path / "sound", ()), SEED, 2, subject="other")
    again = tmp_path / "again"
    result = attack.run(again)
    assert (result.outcome, attack.name) == (outcome, "other on 1 cores, from nothing")
    assert (again / "pipeline").readlink() == tmp_path / "sound/pipeline"


def test_table_goes_on_where_it_was_left_and_counts_classes(tmp_path):
    table = tmp_path / "attacks.csv"
    records.append(table, "captures", "a: b\n", Result(Outcome.CLEAR, "index_capture", "error: x\x07"), 30.0)
    records.append(table, "captures", "c", Result(Outcome.HANG), 90.0)
    found = records.read(table)
    assert [record.attack for record in found] == ["a: b?", "c"]
    assert records.counted(found).splitlines()[2] == "| captures | 2 | 1 | 0 | 0 | 0 | 0 | 0 | 1 | 0 | 0 | 0 | 2.0 |"
    assert [record.outcome for record in records.defects(found)] == [Outcome.HANG]
    assert Outcome.NONSENSE in DEFECTS and Outcome.JUDGED not in DEFECTS
    page = tmp_path / "page.md"
    head, row = records.counted(found).split(records.RULE)
    others = ["| captures | 1 | old |\n", "| kills | 2 | kept |\n"]
    marks = "<!-- attacks: begin -->\n", "<!-- attacks: end -->\n"
    page.write_text("before\n" + marks[0] + head + records.RULE + "".join(others) + marks[1] + "after\n")
    records.write_page(page, found)
    assert page.read_text() == "before\n" + marks[0] + head + records.RULE + row + others[1] + marks[1] + "after\n"
