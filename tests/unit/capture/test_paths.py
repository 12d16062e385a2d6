from __future__ import annotations

from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.capture.paths import check_pattern, check_relative, fill, find_files, locate


@pytest.mark.parametrize(
    ("path", "shortest"), [("a/b.csv", "a/b.csv"), ("./a//b/./c", "a/b/c"), ("a b/ö.csv", "a b/ö.csv")]
)
def test_relative_paths_in_their_shortest_form(path: str, shortest: str) -> None:
    assert check_relative(path) == shortest


@pytest.mark.parametrize("path", ["", " ", "/a", "~/a", "C:/a", "C:a", "a\\b", "..", "a/../../b", "a/../b"])
def test_paths_that_could_leave(path: str) -> None:
    with pytest.raises(ValueError, match="path"):
        check_relative(path)


@pytest.mark.parametrize(
    "pattern",
    [
        "{camera}.png", "{camera}/{frame}/{view}.png", "{camera}/{}.png", "{camera}/{frame", "{camera}/{frame!r}",
        "{camera}/{frame:.2f}", "{camera:5}/{frame}", "{camera}/{frame:x}", "{camera[0]}/{frame}",
    ],
)  # fmt: skip
def test_patterns_with_other_placeholders(pattern: str) -> None:
    with pytest.raises(ValueError, match="placeholders"):
        check_pattern(pattern, ("camera", "frame"))


@pytest.mark.parametrize("pattern", ["{camera}/{frame:06d}.exr", "{frame}{camera}", "{camera}/{camera}_{frame:3}.png"])
def test_patterns_that_pass(pattern: str) -> None:
    assert check_pattern(pattern, ("camera", "frame")) == pattern


def test_find_files_inverts_fill(tmp_path: Path) -> None:
    pattern = "v[1]/{camera}/{camera}-{view:03d}.png"
    planted = {fill(pattern, camera=c, view=v): {"camera": c, "view": v} for c in ("a", "b.1") for v in (0, 12, 1234)}
    others = ["v[1]/a/b-001.png", "v[1]/a/a-1.png", "v[1]/a/a-0001.png", "v[1]/a/a-001.jpg", "v1/a/a-001.png"]
    for path in [*planted, *others]:
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).touch()
    assert find_files(tmp_path, pattern) == planted
    assert list(find_files(tmp_path, pattern)) == sorted(planted)


def test_find_files_in_no_folder_finds_none(tmp_path: Path) -> None:
    assert find_files(tmp_path / "none", "{camera}.png") == {}


def test_locate(tmp_path: Path) -> None:
    root, outside = tmp_path / "capture", tmp_path / "outside.txt"
    (root / "folder").mkdir(parents=True)
    outside.touch()
    (root / "inside.txt").touch()
    (root / "link").symlink_to(root / "inside.txt")
    (root / "leaves").symlink_to(outside)
    (tmp_path / "alias").symlink_to(root)
    assert locate(root, "link").is_file()
    assert locate(tmp_path / "alias", "inside.txt").is_file()
    with pytest.raises(
        InputError, match=r"leaves: expected a file inside the capture folder, found a link to .*outside"
    ):
        locate(root, "leaves")
    with pytest.raises(InputError, match="folder: expected a file, found a folder"):
        locate(root, "folder")
    with pytest.raises(InputError, match="gone: expected a file, found none"):
        locate(root, "gone")
    (root / "loop").symlink_to("loop")
    with pytest.raises(InputError, match="loop: expected a file, found"):
        locate(root, "loop")
    with pytest.raises(InputError, match="aaa: expected a file, found"):
        locate(root, 300 * "a")
