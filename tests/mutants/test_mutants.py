"""The list of planted bugs, which has to stay true, and what judges them; `make mutants` plants all of them."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import pytest
import yaml

from tests.support.mutants import records
from tests.support.mutants.mutant import Mutant, read_mutants
from tests.support.mutants.records import Verdict

LEAST_MUTANTS, LEAST_OF_A_LAYER = 150, 4

LAYERS = {
    "avatar", "base", "budget", "calibration", "capture", "config", "datasets", "dials", "effects", "export", "eyes",
    "geometry", "lighting", "metrics", "rendering", "report", "stages", "sync", "tracking", "workflow",
}  # fmt: skip
"""Packages that calculate. Pictures and pages are judged by who looks at them, synthetic captures are what others are
compared with."""


@pytest.fixture(scope="module")
def mutants(repo_root):
    return read_mutants(repo_root / "tests/mutants/listed")


def test_every_bug_is_one_change_of_code_and_its_tests_are_there(mutants, repo_root):
    for mutant in mutants:
        mutant.require_change(repo_root)


def test_bugs_of_every_layer_are_listed_in_the_list_of_their_layer(mutants):
    assert len(mutants) >= LEAST_MUTANTS
    counts = dict.fromkeys(LAYERS, 0)
    for mutant in mutants:
        package = mutant.file.split("/")[1] if mutant.file.startswith("pipeline/") else "workflow"
        assert package == mutant.layer
        counts[mutant.layer] += 1
    assert min(counts.values()) >= LEAST_OF_A_LAYER


CODE = """import time


def half(number):
    return number / 2


def waited(number):
    while number > 10:
        number -= 1
        time.sleep(1e-4)
    return number
"""
TESTS = """from pipeline.base.halves import half, waited


def test_half_of_four_is_two():
    assert half(4) == 2


def test_nothing_is_waited_for():
    assert waited(3) == 3
    assert waited(30) == 10
"""
ENTRY = {"file": "pipeline/base/halves.py", "meaning": "", "tests": ["tests/test_halves.py"]}


@pytest.fixture
def project(tmp_path):
    """A project of two functions, with a test."""
    root = tmp_path / "project"
    for name in ("pipeline/base", "tests", "listed"):
        (root / name).mkdir(parents=True)
    (root / "pipeline/base/halves.py").write_text(CODE)
    (root / "tests/test_halves.py").write_text(TESTS)
    (root / "base").symlink_to("pipeline/base")
    return root


def out_of(project):
    return project.parent / "out"


def run(project, repo_root, *changes, options=(), code=0):
    """Plant bugs in the project; what was printed, and the judgements by meaning."""
    (project / "listed/base.yaml").write_text(yaml.safe_dump([ENTRY | change for change in changes]))
    command = [sys.executable, "-m", "tests.mutants", "--root", str(project), "--listed", str(project / "listed")]
    command += ["--out", str(out_of(project)), "--patience", "3", "--few-imports", *options]
    done = subprocess.run(command, cwd=repo_root, capture_output=True, text=True, timeout=300)
    assert done.returncode == code, done.stdout + done.stderr
    found = records.read(out_of(project) / "mutants.csv")
    return done.stdout, {row.mutant.partition(": ")[2]: row for row in found if row.layer}


TWICE = {"was": "number / 2", "becomes": "number * 2", "meaning": "doubled"}
WHOLE = {"was": "number / 2", "becomes": "number // 2", "meaning": "rounded down"}
ENDLESS = {"was": "number -= 1", "becomes": "number -= 0", "meaning": "endless"}
BROKEN = {"was": "def half(number)", "becomes": "def halves(number)", "meaning": "another name"}


def test_bugs_are_killed_survive_or_run_out_of_time_and_the_project_stays(project, repo_root):
    printed, found = run(project, repo_root, TWICE, WHOLE, ENDLESS, BROKEN, code=1)
    verdicts = {meaning: row.verdict for meaning, row in found.items()}
    assert verdicts == {
        "doubled": Verdict.KILLED, "rounded down": Verdict.SURVIVED, "endless": Verdict.STOPPED,
        "another name": Verdict.UNJUDGED,
    }  # fmt: skip
    assert found["doubled"].by == "tests/test_halves.py::test_half_of_four_is_two"
    assert "rounded down: no test sees it" in printed and "another name: its tests did not run" in printed
    assert (project / "pipeline/base/halves.py").read_text() == CODE
    assert (out_of(project) / "tree/pipeline/base/halves.py").read_text() == CODE


def test_what_is_judged_is_not_judged_again_until_a_test_changes(project, repo_root):
    run(project, repo_root, TWICE, WHOLE, code=1)
    before = (out_of(project) / "mutants.csv").read_text()
    run(project, repo_root, TWICE, WHOLE, code=1)
    assert (out_of(project) / "mutants.csv").read_text() == before
    printed, _ = run(project, repo_root, TWICE, WHOLE, ENDLESS, options=["--kept"], code=1)
    assert "2 of 3 judged" in printed and (out_of(project) / "mutants.csv").read_text() == before
    with open(project / "tests/test_halves.py", "a") as file:
        file.write("\n\ndef test_half_of_five_is_no_whole_number():\n    assert half(5) == 2.5\n")
    _, found = run(project, repo_root, TWICE, WHOLE)
    assert found["rounded down"].verdict is Verdict.KILLED


def test_argued_survivor_that_is_seen_is_an_error(project, repo_root):
    printed, _ = run(project, repo_root, TWICE | {"survives": "nobody needs halves"}, code=1)
    assert "delete `survives`" in printed


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (TWICE | {"was": "number / 3"}, "found it 0 times"),
        (TWICE | {"was": "number"}, "found it"),
        (TWICE | {"becomes": "(number / 2)"}, "nothing but spelling"),
        (TWICE | {"becomes": "number /"}, "no Python"),
        (TWICE | {"tests": ["tests/test_halves.py::test_thirds"]}, "no test"),
        (TWICE | {"file": "pipeline/base/thirds.py"}, "no such file"),
    ],
)
def test_list_that_is_not_true_is_refused(project, change, message):
    (project / "listed/base.yaml").write_text(yaml.safe_dump([ENTRY | change]))
    (mutant,) = read_mutants(project / "listed")
    with pytest.raises(ValueError, match=message):
        mutant.require_change(project)


def test_table_has_each_listed_bug_in_one_column(tmp_path):
    """A test that passes without a change is no bug's row; one that did not run judged nothing."""
    listed = [Mutant(layer, str(number), "", "", "", ()) for number, layer in enumerate(["base", *["sync"] * 5])]
    listed[3] = dataclasses.replace(listed[3], survives="equal")
    judged = [Verdict.KILLED, Verdict.SURVIVED, Verdict.STOPPED, Verdict.SURVIVED, Verdict.UNJUDGED]
    for mutant, verdict, seconds in zip(listed, judged, (2.0, 4.0, 60.0, 8.0, 1.0), strict=False):
        records.append(
            tmp_path / "mutants.csv", records.Judgement(mutant.layer, "x", mutant.file, verdict, seconds, "")
        )
    found = list(zip(listed, records.read(tmp_path / "mutants.csv"), strict=False))
    assert records.counted(listed, found).splitlines()[2:] == [
        "| base | 1 | 1 | 0 | 0 | 0 | 0 | 2.0 | 0.0 |",
        "| sync | 5 | 0 | 1 | 1 | 1 | 2 | 6.0 | 1.2 |",
        "| all | 6 | 1 | 1 | 1 | 1 | 2 | 4.0 | 1.2 |",
    ]
