"""Nothing leaves the machine, and nothing listens: the guard around all tests, and strace for compiled code."""

from __future__ import annotations

import os
import socket
import subprocess
import sys

import pytest

from pipeline import STAGES
from pipeline.config.flags import flags
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet_subject import sheet_frames, sheet_images, stage_arguments, write_subject
from tests.support.network import system_calls
from tests.support.network.guard import stays_here

NOWHERE = ("192.0.2.1", 9)
"""An address for documentation, which no machine has (RFC 5737)."""


def test_guard_knows_this_machine_from_others():
    here = [("127.0.0.1", 5), ("127.4.0.1", 0), ("::1", 5, 0, 0), ("localhost", 80), "/run/some.socket", (0, 0)]
    beyond = [NOWHERE, ("", 80), ("0.0.0.0", 0), ("::", 80, 0, 0), ("example.org", 443), ("10.0.0.1", 1)]
    assert all(map(stays_here, here))
    assert not any(map(stays_here, beyond))


@pytest.mark.parametrize("call", ["connect", "bind"])
def test_connection_from_a_test_ends_it(call):
    with socket.socket() as opened, pytest.raises(PermissionError, match=rf"socket\.{call}: expected addresses"):
        getattr(opened, call)(NOWHERE)


def test_connection_from_what_a_test_starts_ends_that(tmp_path):
    script = f"import socket; socket.socket(type=socket.SOCK_DGRAM).sendto(b'x', {NOWHERE})"
    grandchild = f"import subprocess, sys; sys.exit(subprocess.run([sys.executable, '-c', {script!r}]).returncode)"
    for words in (script, grandchild):
        done = subprocess.run([sys.executable, "-c", words], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 1 and "BeyondThisMachine" in done.stderr


def test_every_stage_is_run_under_the_guard_by_a_test_of_its_own(repo_root):
    """The guard is around all tests: whatever stage they call, or start, cannot talk."""
    texts = [
        path.read_text() for folder in ("stages", "workflow") for path in (repo_root / "tests" / folder).glob("*.py")
    ]
    untested = [stage for stage in STAGES if not any(f"stages.{stage}" in text or stage in text for text in texts)]
    assert not untested


def test_trace_tells_the_loopback_from_other_addresses(tmp_path):
    lines = [
        '7 connect(3, {sa_family=AF_UNIX, sun_path="/run/x"}, 110) = 0',
        '7 connect(3, {sa_family=AF_INET, sin_port=htons(53), sin_addr=inet_addr("127.0.0.1")}, 16) = 0',
        '7 bind(3, {sa_family=AF_INET6, sin6_port=htons(0), inet_pton(AF_INET6, "::1", &sin6_addr)}, 28) = 0',
        "7 sendto(3, NULL, 0, 0, NULL, 0) = 0",
        '8 connect(3, {sa_family=AF_INET, sin_port=htons(9), sin_addr=inet_addr("192.0.2.1")}, 16) = 0',
        '8 bind(3, {sa_family=AF_INET, sin_port=htons(80), sin_addr=inet_addr("0.0.0.0")}, 16) = 0',
    ]
    assert system_calls.beyond_this_machine("\n".join(lines)) == lines[4:]


@pytest.fixture
def strace():
    if reason := system_calls.why_not():
        pytest.skip(reason)


@pytest.mark.usefixtures("strace")
def test_trace_sees_a_connection_of_a_grandchild(tmp_path):
    script = f"import socket; socket.socket(type=socket.SOCK_DGRAM).connect({NOWHERE})"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {script!r}])"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}  # Without the guard.
    command = system_calls.traced([sys.executable, "-c", child], tmp_path / "trace")
    subprocess.run(command, env=environment, check=True)
    (line,) = system_calls.beyond_this_machine((tmp_path / "trace").read_text())
    assert NOWHERE[0] in line


@pytest.mark.usefixtures("strace")
def test_training_together_talks_over_the_loopback_alone(tmp_path):
    write_subject(tmp_path, sheet_images(sheet_frames(), (-0.2, 0.2)), shadow=True)
    settings = TrainAvatar(
        shading="transfer", deferred="on", steps=4, steps_together=2, cameras_per_step=2, device="cpu", preview_every=0
    )
    words = [word for name, value in stage_arguments(tmp_path).items() for word in (f"--{name}", str(value))]
    words += [*flags(settings), "--out", str(tmp_path / "out"), "--processes", "2"]
    command = [sys.executable, "-m", "pipeline.stages.train_avatar", *words]
    done = subprocess.run(
        system_calls.traced(command, tmp_path / "trace"), capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0 and "2 x cpu" in done.stdout + done.stderr, done.stdout + done.stderr
    trace = (tmp_path / "trace").read_text()
    assert "127.0.0.1" in trace  # They do talk, and the trace has it.
    assert not system_calls.beyond_this_machine(trace)
