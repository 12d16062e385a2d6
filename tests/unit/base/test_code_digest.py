"""The digest of a small project changes exactly with the code that its stage can run."""

from __future__ import annotations

import ast
import os
import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import pytest

from pipeline.base.code_digest import KEPT, SETTLED_NS, code_digest, imported_modules
from pipeline.config.project import SECTIONS

FILES = {
    "pipeline/__init__.py": '"""A project."""\n',
    "pipeline/stage.py": (
        '"""A stage."""\nimport json\nfrom pipeline.deep.direct import work\n\n\ndef run():\n    """Run."""\n'
        "    from pipeline import late  # only when it runs\n    return work(), late, json\n"
    ),
    "pipeline/late.py": "LATE = 1\n",
    "pipeline/unrelated.py": "OTHER = 1\n",
    "pipeline/deep/__init__.py": "",
    "pipeline/deep/direct.py": (
        "from . import sibling\nfrom .more.far import FAR\n\n\ndef work():\n    return FAR, sibling\n"
    ),
    "pipeline/deep/sibling.py": "SIBLING = 1\n",
    "pipeline/deep/more/__init__.py": "",
    "pipeline/deep/more/far.py": "FAR = Field(1, ge=0, description='far away')\n",
    "pipeline/deep/more/weights/net.safetensors": "numbers",
}
IMPORTED = {
    "pipeline",
    "pipeline.stage",
    "pipeline.late",
    "pipeline.deep",
    "pipeline.deep.direct",
    "pipeline.deep.sibling",
    "pipeline.deep.more",
    "pipeline.deep.more.far",
}


@pytest.fixture(autouse=True)
def always_looking(monkeypatch):
    """Edits of a test come faster than anybody's."""
    monkeypatch.setattr("pipeline.base.code_digest.LOOK_AGAIN_S", 0)


@pytest.fixture
def project(tmp_path):
    for name, text in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def edited(project, name, old, new):
    """The digests before and after replacing a text in a file."""
    before = code_digest("pipeline.stage", project)
    path = project / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    return before, code_digest("pipeline.stage", project)


def test_imports_are_followed_into_functions_packages_and_relative_names(project):
    assert set(imported_modules("pipeline.stage", project)) == IMPORTED


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("pipeline/stage.py", "return work()", "return work"),
        ("pipeline/late.py", "LATE = 1", "LATE = 2"),
        ("pipeline/deep/sibling.py", "SIBLING = 1", "SIBLING = 2"),
        ("pipeline/deep/more/far.py", "ge=0", "ge=1"),
        ("pipeline/deep/more/__init__.py", "", "HERE = 1\n"),
        ("pipeline/deep/more/weights/net.safetensors", "numbers", "other numbers"),
    ],
)
def test_code_that_can_run_changes_the_digest(project, name, old, new):
    before, after = edited(project, name, old, new)
    assert before != after


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("pipeline/stage.py", "# only when it runs", "# whenever it runs"),
        ("pipeline/stage.py", '"""A stage."""', '"""Another text,\n\nof several lines."""'),
        ("pipeline/stage.py", '    """Run."""\n', ""),
        ("pipeline/stage.py", "return work(), late, json", "return (work(),   late, json)"),
        ("pipeline/late.py", "LATE = 1", 'LATE = 1\n"""What it means."""'),
        ("pipeline/deep/more/far.py", "far away", "very far away"),
        ("pipeline/unrelated.py", "OTHER = 1", "OTHER = 2"),
    ],
)
def test_prose_layout_and_strangers_leave_the_digest_alone(project, name, old, new):
    before, after = edited(project, name, old, new)
    assert before == after


def test_new_import_changes_the_digest_by_what_it_brings(project):
    before, after = edited(project, "pipeline/late.py", "LATE = 1", "import pipeline.unrelated\nLATE = 1")
    assert before != after
    before, after = edited(project, "pipeline/unrelated.py", "OTHER = 1", "OTHER = 2")
    assert before != after


def test_edit_right_after_a_look_counts_as_a_later_one(project, monkeypatch):
    monkeypatch.setattr("pipeline.base.code_digest.LOOK_AGAIN_S", 3600)
    before, after = edited(project, "pipeline/late.py", "LATE = 1", "LATE = 2")
    assert before == after
    monkeypatch.setattr("pipeline.base.code_digest.LOOK_AGAIN_S", 0)
    assert code_digest("pipeline.stage", project) != before


@pytest.fixture
def keeping(project):
    """The project where Snakemake has run: what files say is kept."""
    (project / KEPT).parent.mkdir()
    code_digest("pipeline.stage", project)
    assert (project / KEPT).is_file()
    return project


def copied(project, folder):
    """The project elsewhere: nothing that this process remembers is of it."""
    return shutil.copytree(project, folder)


def test_kept_parses_give_the_fresh_digest_and_nothing_is_parsed(keeping, tmp_path_factory, monkeypatch):
    other = copied(keeping, tmp_path_factory.mktemp("other") / "project")
    fresh = code_digest("pipeline.stage", keeping)
    monkeypatch.setattr(ast, "parse", None)
    assert code_digest("pipeline.stage", other) == fresh


def test_edit_that_keeps_size_and_time_changes_the_digest(keeping, tmp_path_factory):
    other = copied(keeping, tmp_path_factory.mktemp("other") / "project")
    path = other / "pipeline/late.py"
    before = path.stat()
    path.write_text("LATE = 2\n")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size
    assert code_digest("pipeline.stage", other) != code_digest("pipeline.stage", keeping)


@pytest.mark.parametrize("settled_ns", [SETTLED_NS, -(10**15)])
def test_edits_within_a_process_are_seen_whatever_the_age_of_files(project, monkeypatch, settled_ns):
    """New files are read each time; the second case takes them for old, whose stamps tell versions apart."""
    monkeypatch.setattr("pipeline.base.code_digest.SETTLED_NS", settled_ns)
    digests = [code_digest("pipeline.stage", project)]
    for edit in (
        lambda: (project / "pipeline/late.py").write_text("LATE = 22\n"),
        lambda: (project / "pipeline/deep/direct").mkdir(),
        lambda: (project / "pipeline/deep/direct/__init__.py").write_text("def work():\n    return 3\n"),
        lambda: (project / "pipeline/late.py").unlink(),
    ):
        time.sleep(0.02)  # A tick of the clock that file systems stamp with.
        edit()
        digests.append(code_digest("pipeline.stage", project))
    assert digests[1] == digests[2]  # An empty folder is no module.
    assert len(set(digests)) == 4


def test_unchanged_files_are_read_once_in_a_process(project, monkeypatch):
    monkeypatch.setattr("pipeline.base.code_digest.SETTLED_NS", -(10**15))
    digest = code_digest("pipeline.stage", project)
    monkeypatch.setattr("builtins.open", None)
    assert code_digest("pipeline.stage", project) == digest


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: b"",
        lambda content: content[:-100],
        lambda content: content.replace(b"sibling", b"sibbing", 1),
        lambda content: b"[]",
        lambda content: bytes(range(256)),
    ],
    ids=["empty", "truncated", "altered", "other", "binary"],
)
def test_damaged_kept_parses_are_ignored_and_replaced(keeping, tmp_path_factory, damage):
    other = copied(keeping, tmp_path_factory.mktemp("other") / "project")
    whole = (keeping / KEPT).read_bytes()
    (other / KEPT).write_bytes(damage(whole))
    assert (other / KEPT).read_bytes() != whole
    assert code_digest("pipeline.stage", other) == code_digest("pipeline.stage", keeping)
    assert (other / KEPT).read_bytes() == whole


def test_nothing_is_kept_where_snakemake_has_not_run(project):
    code_digest("pipeline.stage", project)
    assert not (project / KEPT).parent.exists()


def test_unknown_module_is_an_error(project):
    with pytest.raises(FileNotFoundError, match=r"pipeline\.nothing"):
        code_digest("pipeline.nothing", project)


@pytest.mark.parametrize("stage", SECTIONS)
def test_digest_covers_what_a_stage_imports_by_itself(stage, repo_root):
    """Independently of the walk: every `from pipeline... import` that stands in the stage's file is covered."""
    tree = ast.parse((repo_root / f"pipeline/stages/{stage}.py").read_text())
    named = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    expected = {module for module in named if module and module.startswith("pipeline.")}
    assert expected
    assert expected <= set(imported_modules(f"pipeline.stages.{stage}"))


def test_a_thread_that_asks_while_another_lists_the_package_gets_the_same_digest(project, monkeypatch):
    """Listing takes as long as on a slow file system, and what is known counts as current meanwhile."""
    listing, walk = Event(), os.walk

    def slowly(*args, **kwargs):
        listing.set()
        for found in walk(*args, **kwargs):
            time.sleep(0.05)
            yield found

    monkeypatch.setattr("pipeline.base.code_digest.LOOK_AGAIN_S", 60)
    monkeypatch.setattr("pipeline.base.code_digest.os.walk", slowly)
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(code_digest, "pipeline.stage", project)
        assert listing.wait(60)
        assert threads.submit(code_digest, "pipeline.stage", project).result() == first.result()
