"""The digest of a small project changes exactly with the code that its stage can run."""

from __future__ import annotations

import ast
import os
import shutil

import pytest

from pipeline.base.code_digest import code_digest, imported_modules
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


def test_kept_parts_of_the_digest_hold_for_a_content_and_not_a_time(project, tmp_path_factory):
    digest = code_digest("pipeline.stage", project)
    kept = {path.relative_to(project) for path in project.rglob("*.code_digest")}
    assert len(kept) == len(IMPORTED)

    def copied():
        return shutil.copytree(project, tmp_path_factory.mktemp("copy") / "project")

    copy = copied()
    for name in kept:
        (copy / name).write_text("cut off")
    assert code_digest("pipeline.stage", copy) == code_digest("pipeline.stage", copied()) == digest
    late = copied() / "pipeline/late.py"
    state = late.stat()
    late.write_text("LATE = 2\n")
    os.utime(late, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert late.stat().st_size == state.st_size
    assert code_digest("pipeline.stage", late.parents[1]) != digest


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
