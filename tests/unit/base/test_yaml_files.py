"""YAML that people write, and what is wrong with it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.base.yaml_files import MOST_LEVELS, read_yaml


def test_values_lists_and_merged_keys_are_read(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("base: &base {x: 1.5, on_time: true}\nmade: {<<: *base, x: [2, a]}\n")
    expected = {"base": {"x": 1.5, "on_time": True}, "made": {"x": [2, "a"], "on_time": True}}
    assert read_yaml(tmp_path / "a.yaml") == expected
    (tmp_path / "a.yaml").write_text("# Nothing but a comment.\n")
    assert read_yaml(tmp_path / "a.yaml") is None


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "valid YAML"),
        ("a: 2020-13-01", "month must be in 1..12"),
        ("a: !!int x", "invalid literal"),
        ("a: " + "9" * 5000, "valid YAML"),
        ("a: !!python/object:os.system b", "could not determine a constructor"),
        ("a: 1\nb: {c: 1, c: 2}", "the key 'c' is there twice"),
        ("1: a", "expected text as a key, found 1; put it in quotes"),
        ("on: a", "expected text as a key, found True"),
        ("[1]: a", "expected text as a key"),
        ("a: " + "[" * (MOST_LEVELS + 1), f"more than {MOST_LEVELS} levels of nesting, in line 1"),
        # With libyaml's composer, this many end the process.
        ("a: " + "[" * 100_000, f"more than {MOST_LEVELS} levels of nesting"),
    ],
)
def test_what_is_wrong_is_one_line_with_the_file(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_yaml(tmp_path / "a.yaml")
    assert str(caught.value).startswith(f"{tmp_path}/a.yaml: expected valid YAML, found: ")
    assert said in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.timeout(300)
def test_many_keys_are_read(tmp_path: Path) -> None:
    """In time that grows with their number: in time that grows with its square, 100,000 would take ten minutes."""
    (tmp_path / "a.yaml").write_text("".join(f"key_{number}: {number}\n" for number in range(100_000)))
    assert len(read_yaml(tmp_path / "a.yaml")) == 100_000


@pytest.mark.parametrize("target", ["/dev/zero", "nothing", "a.yaml"])
def test_devices_and_broken_links_are_no_files(tmp_path: Path, target: str) -> None:
    (tmp_path / "a.yaml").symlink_to(target)
    with pytest.raises(InputError, match="expected a file"):
        read_yaml(tmp_path / "a.yaml")


def test_comment_in_utf_8_is_read_under_any_locale(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_bytes("# Größe\na: 1\n".encode())
    read = "import sys; from pipeline.base.yaml_files import Path, read_yaml; print(read_yaml(Path(sys.argv[1])))"
    done = subprocess.run(
        [sys.executable, "-c", read, tmp_path / "a.yaml"], capture_output=True, text=True,
        env={**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    )  # fmt: skip
    assert done.stdout == "{'a': 1}\n", done.stderr


def test_aliases_that_stand_for_too_much_are_refused_before_anything_is_built(tmp_path: Path) -> None:
    levels = ["l0: &l0 [a, a, a, a, a, a, a, a, a, a]"]
    levels += [f"l{level}: &l{level} [{', '.join([f'*l{level - 1}'] * 10)}]" for level in range(1, 9)]
    (tmp_path / "a.yaml").write_text("\n".join(levels) + "\n")
    with pytest.raises(InputError, match="more than 1000000 values, with those that aliases stand for, in line 6"):
        read_yaml(tmp_path / "a.yaml")


def test_alias_of_itself_or_of_nothing_is_refused(tmp_path: Path) -> None:
    for text in ("a: &a [*a]\n", "a: *b\n"):
        (tmp_path / "a.yaml").write_text(text)
        with pytest.raises(InputError, match="alias"):
            read_yaml(tmp_path / "a.yaml")


def test_alias_of_what_is_there_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("a: &a {x: 1}\nb: *a\nc:\n  <<: *a\n  y: 2\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": {"x": 1}, "b": {"x": 1}, "c": {"x": 1, "y": 2}}
