"""What is written whole, what is replaced, and what a killed writer leaves."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from pipeline.base import whole_files
from pipeline.base.errors import InputError
from pipeline.base.whole_files import WRITTEN_BY, written_folder, written_whole

KILLED_WITHIN = """
import os, signal, sys
from pathlib import Path
from pipeline.base.whole_files import written_whole
with written_whole(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_writer_leaves_matches_no_pattern_of_files_and_is_swept(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED_WITHIN, str(tmp_path / "0000.arrow")])
    assert done.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert (left / "0000.arrow").read_text() == "half"
    assert not list(tmp_path.glob("*.arrow"))
    with written_whole(tmp_path / "0001.arrow") as temporary:
        temporary.write_text("whole")
    assert os.listdir(tmp_path) == ["0001.arrow"]


def test_no_other_folder_takes_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One on another file system would have to be copied from, and a copy that is killed is half a file."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    with written_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
    assert os.listdir(tmp_path) == ["a.txt"]


def test_content_is_on_the_disk_before_its_name_is_and_then_the_name(tmp_path: Path, monkeypatch) -> None:
    """After a power cut a name without content would pass for a finished file."""
    done: list[object] = []
    renames = {name: getattr(os, name) for name in ("replace", "rename")}
    for name, call in renames.items():

        def renamed(source: Path, target: Path, call=call) -> None:
            if not Path(target).name.startswith("."):  # that of the hidden workplace
                done.append(Path(target).name)
            call(source, target)

        monkeypatch.setattr(os, name, renamed)
    monkeypatch.setattr(os, "fsync", lambda descriptor: done.append(os.fstat(descriptor).st_ino))
    monkeypatch.setattr(whole_files, "_flush_all", lambda folder: done.append(sorted(os.listdir(folder))))
    with written_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
    file, folder = (path.stat().st_ino for path in (tmp_path / "a.txt", tmp_path))
    assert done == [file, "a.txt", folder]
    done.clear()
    with written_folder(tmp_path / "maps", "stage") as temporary:
        (temporary / "one.exr").write_text("light")
    assert done == [[".written_by", "one.exr"], "maps", folder]


def test_without_syncfs_each_file_of_a_folder_is_flushed(tmp_path: Path, monkeypatch) -> None:
    done: set[int] = set()
    monkeypatch.setattr(os, "fsync", lambda descriptor: done.add(os.fstat(descriptor).st_ino))
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    with written_folder(tmp_path / "maps", "stage") as temporary:
        (temporary / "of").mkdir()
        (temporary / "of/one.exr").write_text("light")
    within = {path.stat().st_ino for path in [tmp_path / "maps", *(tmp_path / "maps").rglob("*")]}
    assert len(within) == 4 and within <= done


CHANGES = {"open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "shutil.rmtree"}


def killed_at(place: int, folder: Path) -> bool:
    """True if a child that writes a file was killed just before its n-th call that may change the folder."""
    child = os.fork()
    if not child:
        seen = 0

        def count(event: str, arguments: tuple) -> None:
            nonlocal seen
            seen += event in CHANGES
            if event in CHANGES and seen == place:
                os.kill(os.getpid(), signal.SIGKILL)

        try:
            whole_files._sweep.cache_clear()
            sys.addaudithook(count)
            with written_whole(folder / "a.txt") as temporary:
                temporary.write_text("whole")
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


def test_killed_at_any_call_leaves_nothing_that_the_next_writer_does_not_sweep(tmp_path: Path) -> None:
    place = 0
    while killed_at(place := place + 1, tmp_path):
        whole_files._sweep.cache_clear()
        with written_whole(tmp_path / "b.txt") as temporary:
            temporary.write_text("whole")
        assert set(os.listdir(tmp_path)) <= {"a.txt", "b.txt"}, place
    assert place > 7


def test_writer_at_work_is_not_swept(tmp_path: Path) -> None:
    write = "import sys; from pipeline.base.files import write_json, Path; write_json(Path(sys.argv[1]), 1)"
    with written_whole(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
        subprocess.run([sys.executable, "-c", write, str(tmp_path / "b.json")], check=True)
        assert temporary.exists()
    assert sorted(os.listdir(tmp_path)) == ["a.txt", "b.json"]


def test_folder_replaces_the_one_that_the_same_stage_wrote(tmp_path: Path) -> None:
    path = tmp_path / "avatar"
    for name in ("first", "second"):
        with written_folder(path, "stage") as temporary:
            (temporary / name).touch()
    assert sorted(os.listdir(path)) == [WRITTEN_BY, "second"]
    assert os.listdir(tmp_path) == ["avatar"]


def test_failure_keeps_the_old_folder(tmp_path: Path) -> None:
    with written_folder(tmp_path / "maps", "stage") as temporary:
        (temporary / "old").touch()
    with pytest.raises(RuntimeError, match="killed"), written_folder(tmp_path / "maps", "stage"):
        raise RuntimeError("killed")
    assert sorted(os.listdir(tmp_path / "maps")) == [WRITTEN_BY, "old"]
    assert os.listdir(tmp_path) == ["maps"]


def test_empty_folder_may_be_replaced(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    with written_folder(tmp_path / "maps", "stage") as temporary:
        (temporary / "new").touch()
    assert (tmp_path / "maps/new").exists()


@pytest.mark.parametrize("writer", ["other_stage", None])
def test_folder_of_somebody_else_is_refused_and_kept(tmp_path: Path, writer: str | None) -> None:
    path = tmp_path / "mydata"
    if writer is None:
        path.mkdir()
    else:
        with written_folder(path, writer):
            pass
    (path / "recording.exr").write_text("precious")
    expected = "mydata: expected no folder, an empty one, or one that stage wrote, found"
    with pytest.raises(InputError, match=expected), written_folder(path, "stage"):
        pytest.fail("reached the work")
    assert (path / "recording.exr").read_text() == "precious"


def test_link_to_a_folder_is_followed(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "capture").symlink_to(tmp_path / "disk")
    with written_folder(tmp_path / "capture", "stage") as temporary:
        (temporary / "new").touch()
    assert (tmp_path / "capture").is_symlink()
    assert (tmp_path / "disk/new").exists()
