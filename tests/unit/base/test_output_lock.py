"""One process at a time for one output, and none that outlives its lock."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.output_lock import output_locked

HOLDER = """
import sys, time
from pathlib import Path
from pipeline.base.output_lock import output_locked
with output_locked(Path(sys.argv[1]), "train_avatar"):
    print("held", flush=True)
    time.sleep(600)
"""

PARENT = """
import multiprocessing, time
from pipeline.base.parent_death import end_with_parent

def child():
    end_with_parent()
    print("ready", flush=True)
    time.sleep(600)

if __name__ == "__main__":
    process = multiprocessing.get_context("spawn").Process(target=child)
    process.start()
    print(process.pid, flush=True)
    process.join()
"""


def test_second_process_is_refused_until_the_first_has_gone(tmp_path: Path) -> None:
    out = tmp_path / "avatars/full"
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(out)], stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "held\n"
    said = rf"no other process .* found process {holder.pid} on"
    with pytest.raises(InputError, match=said), output_locked(out, "train_avatar"):
        pytest.fail("reached the work")
    with output_locked(out, "other_job"):
        pass
    holder.kill()
    holder.wait()
    holder.stdout.close()
    with output_locked(out, "train_avatar"):
        write_json(out / "config.json", {})
    assert os.listdir(tmp_path / "avatars") == ["full"]


def test_process_whose_lock_was_deleted_writes_nothing_more(tmp_path: Path) -> None:
    out = tmp_path / "avatars/full"
    with output_locked(out, "train_avatar"):
        (tmp_path / "avatars/.full.train_avatar.lock").unlink()
        with output_locked(out, "train_avatar"):
            pass
        with pytest.raises(InputError, match=f"expected the lock of this process, {os.getpid()}, found none"):
            write_json(out / "config.json", {"newer": False})
    assert not (out / "config.json").exists()


def test_process_whose_lock_is_anothers_now_writes_nothing_more(tmp_path: Path) -> None:
    """A file of that name is there again, but it is not the one that was locked."""
    out = tmp_path / "avatars/full"
    with output_locked(out, "train_avatar"):
        (tmp_path / "avatars/.full.train_avatar.lock").unlink()
        holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(out)], stdout=subprocess.PIPE, text=True)
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(InputError, match="found none or another's"):
            write_json(out / "config.json", {"newer": False})
    holder.kill()
    holder.wait()
    holder.stdout.close()
    assert not (out / "config.json").exists()


def test_folder_that_cannot_be_written_to_keeps_nobody_from_working(tmp_path: Path) -> None:
    """As where the output alone may be written to; here its parent is no folder."""
    (tmp_path / "file").touch()
    done = False
    with output_locked(tmp_path / "file/out", "job"):
        done = True
    assert done


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a service of Linux")
def test_child_ends_when_its_parent_is_killed(tmp_path: Path) -> None:
    """The child holds the pipe that its parent printed to: the pipe ends only with both."""
    (tmp_path / "parent.py").write_text(PARENT)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    parent = subprocess.Popen(
        [sys.executable, tmp_path / "parent.py"], stdout=subprocess.PIPE, text=True, env=environment
    )
    assert {parent.stdout.readline(), parent.stdout.readline()} > {"ready\n"}
    parent.send_signal(signal.SIGKILL)
    assert parent.stdout.read() == ""
    parent.wait()
    parent.stdout.close()
