"""Some of each kind of attack, and the harness itself: `make chaos` runs all of them on a whole capture."""

from __future__ import annotations

import os
import random
from functools import partial

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.base.errors import Complaints, InputError
from pipeline.capture.index.validation import index_folder
from pipeline.capture.schema.manifest import read_manifest
from pipeline.config.loading import load_project
from tests.chaos import captures, forked_stage, records
from tests.chaos.kills import kill_stage, reference
from tests.chaos.mutations.mutation import Meaning
from tests.chaos.outcome import DEFECTS, Outcome, Result
from tests.chaos.settings import VALUES, is_wrong
from tests.chaos.sound_run import CAPTURE, RESULTS, SoundRun, Step, copy_linked
from tests.chaos.surroundings import _limit, scarce
from tests.support.captures.builder import build_capture

SEED = 20
MUTATIONS, SETTINGS = 90, 60

INDEX = Step("index_capture", ("--capture", CAPTURE, "--out", f"{RESULTS}/index"), (), ())


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """A run of two cameras and three frames of 8 x 6 pixels up to the index."""
    folder = tmp_path_factory.mktemp("chaos") / "sound"
    build_capture(folder / CAPTURE, measured=True)
    return SoundRun(folder, (INDEX,))


def test_bad_captures_are_refused_in_words_or_indexed(sound, tmp_path):
    kinds = list(captures._kinds(sound.folder / CAPTURE, SEED))
    drawn = random.Random(SEED).sample([mutation for kind in kinds for mutation in kind], MUTATIONS)
    refused = 0
    for number, mutation in enumerate(drawn):
        root = tmp_path / str(number)
        copy_linked(sound.folder / CAPTURE, root)
        mutation.apply(root)
        try:
            index_folder(root, threads=1)
        except InputError as error:
            refused += 1
            assert len(str(error)) > 20 and "expected" in str(error), mutation.name
        except Exception as error:
            raise AssertionError(f"{mutation.name}: {type(error).__name__}: {error}") from error
    assert MUTATIONS / 3 < refused < MUTATIONS
    assert {mutation.meaning for mutation in drawn} == set(Meaning)


CONTENTS = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=40)
@given(data=st.data())
def test_any_value_of_any_key_of_the_description_is_taken_or_complained_of(sound, tmp_path_factory, data):
    root = tmp_path_factory.getbasetemp() / "described"
    root.mkdir(exist_ok=True)
    content = yaml.safe_load((sound.folder / CAPTURE / "capture.yaml").read_text())
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
            assert f"{section}.{key}" in str(error)
        else:
            assert not is_wrong(section, key, value), f"{section}.{key}: {value!r}"
        wrong += is_wrong(section, key, value)
    assert wrong > SETTINGS / 3


def test_stage_killed_at_any_change_of_files_goes_on_to_the_same_bytes(sound, tmp_path):
    places = random.Random(SEED).sample(range(1, reference(sound, "index_capture").changes + 1), 4)
    for place in places:
        folder = tmp_path / str(place)
        folder.mkdir()
        found = kill_stage(sound, "index_capture", place, place == places[0], folder)
        assert found == Result(Outcome.RIGHT, "index_capture"), place


def test_stage_without_room_or_handles_says_so_and_then_works(sound, tmp_path):
    for name, value in (("FSIZE", 4500), ("NOFILE", 12)):
        folder = tmp_path / name
        folder.mkdir()
        found = scarce("index_capture", partial(_limit, name, value), sound, folder)
        assert found.outcome is Outcome.CLEAR, found


def test_stage_that_leaves_files_or_other_bytes_is_noticed(sound, tmp_path):
    def spoil() -> None:
        (tmp_path / "left_over").mkdir()

    sound.before("index_capture", tmp_path)
    ended = forked_stage.run("index_capture", INDEX.words, tmp_path, spoil)
    assert ended.code == 0, ended.printed
    assert (tmp_path / "left_over").is_dir()


def test_stage_that_stands_still_or_dies_is_a_defect(sound, tmp_path):
    hung = forked_stage.run("index_capture", ["--help"], tmp_path, partial(__import__("time").sleep, 60), allowed_s=0.2)
    assert hung.hung
    died = forked_stage.run("index_capture", ["--help"], tmp_path, partial(os.abort))
    assert died.defect and not died.hung


def test_table_goes_on_where_it_was_left_and_counts_classes(tmp_path):
    table = tmp_path / "attacks.csv"
    records.append(table, "captures", "a: b\n", Result(Outcome.CLEAR, "index_capture", "error: x\x07"), 30.0)
    records.append(table, "captures", "c", Result(Outcome.HANG), 90.0)
    found = records.read(table)
    assert [record.attack for record in found] == ["a: b?", "c"]
    assert records.counted(found).splitlines()[2] == "| captures | 2 | 1 | 0 | 0 | 0 | 0 | 1 | 0 | 0 | 0 | 2.0 |"
    assert [record.outcome for record in records.defects(found)] == [Outcome.HANG]
    assert Outcome.NONSENSE in DEFECTS and Outcome.JUDGED not in DEFECTS
    page = tmp_path / "page.md"
    page.write_text(f"before\n{records.BEGIN}\nold\n{records.END}\nafter\n")
    records.write_page(page, found)
    assert page.read_text() == f"before\n{records.BEGIN}\n{records.counted(found)}{records.END}\nafter\n"
