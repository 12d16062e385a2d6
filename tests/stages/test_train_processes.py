"""Training as processes of their own, started by the stage or by torchrun, and signals from outside."""

import dataclasses
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import psutil
import pytest

from pipeline.avatar.training.local_processes import variables
from pipeline.base.files import read_arrays
from pipeline.config.flags import flags
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet_subject import sheet_frames, sheet_images, stage_arguments, write_subject

STEPS = 72
SETTINGS = TrainAvatar(
    shading="transfer", deferred="on",
    steps=STEPS, steps_together=2, cameras_per_step=3, checkpoint_every=6, log_every=1, preview_every=0, device="cpu",
    learning_rate_texture=1e-2, learning_rate_shape=3e-3, learning_rate_offset=1e-4,
)  # fmt: skip
"""Two steps together, of three images or one: three processes do the first step in two parts. Rates at which a sheet of
so few texels is learned without jumps."""

FIRST_STEPS = 20
FIRST_LOSSES_RTOL = 2 * FIRST_STEPS * 2**-24
"""Of the losses of the first steps. Sums in another order differ by a rounding, 2^-24. Adam's step is the ratio of two
such sums, so each step moves the parameters by one more rounding of themselves; the loss, a mean of absolute
differences between numbers of about one, follows them, and is rounded itself."""

LATER_LOSSES_RTOL = 5e-3
"""Of all losses. Sooner or later the gradient of some texel is nothing but rounding, of which Adam takes the sign: its
parameter moves a whole learning rate the other way, 1e-2 of an albedo, of one texel of 64. An image that is left out
changes the loss by a third at once."""

PATIENCE_S = 120
"""Until a process that has just been started takes its first steps, on a machine that does much else."""


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheet")
    write_subject(folder, sheet_images(sheet_frames(), (-0.2, -0.1, 0.1, 0.2)), shadow=True)
    return folder


def start(subject, out, processes, torchrun=False, settings=SETTINGS):
    launcher = [sys.executable]
    if torchrun:
        launcher += ["-m", "torch.distributed.run", "--standalone", "--nproc_per_node", str(processes)]
    words = [word for name, value in stage_arguments(subject).items() for word in (f"--{name}", str(value))]
    words += [*flags(settings), "--out", str(out), "--processes", str(processes)]
    return subprocess.Popen(
        [*launcher, "-m", "pipeline.stages.train_avatar", *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    )  # fmt: skip


def finish(process):
    printed, _ = process.communicate(timeout=PATIENCE_S)
    return process.returncode, printed


def train(subject, out, processes=1, torchrun=False):
    code, printed = finish(start(subject, out, processes, torchrun))
    assert code == 0, printed
    return read_arrays(out / "avatar.safetensors"), pd.read_parquet(out / "log.parquet"), printed


@pytest.fixture(scope="module")
def alone(subject):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPROFILEIMPORTTIME", "1")
        return train(subject, subject / "alone")


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


def test_two_processes_give_the_bits_of_one(alone, subject, tmp_path):
    """Each does every other step of the rounds, whole."""
    (expected, log, said), (found, log_together, said_together) = alone, train(subject, tmp_path, 2)
    assert "1 x cpu" in said and "2 x cpu" in said_together
    assert said_together.count("images, ") == 1  # Only the leader speaks.
    assert_same(found, expected)
    pd.testing.assert_frame_equal(log_together.drop(columns="seconds"), log.drop(columns="seconds"))


def test_training_does_without_what_takes_long_to_import(alone):
    imported = set(re.findall(r"\| +([\w.]+)$", alone[2], re.MULTILINE))
    assert {"torch", "pipeline.avatar.model"} <= imported
    assert not {"torch._dynamo", "sympy"} & imported


def test_three_processes_of_torchrun_follow_the_curve_of_one(alone, subject, tmp_path):
    """Two of them share a step, and sum in another order."""
    (_, expected, _), (_, found, said) = alone, train(subject, tmp_path, 3, torchrun=True)
    assert "3 x cpu" in said
    assert len(expected) == STEPS and expected.loss.iloc[-1] < 0.6 * expected.loss.iloc[0]
    first = slice(0, FIRST_STEPS)
    np.testing.assert_allclose(found.loss[first], expected.loss[first], rtol=FIRST_LOSSES_RTOL)
    np.testing.assert_allclose(found.loss, expected.loss, rtol=LATER_LOSSES_RTOL)


def wait_for_checkpoint(process, out):
    started = time.monotonic()
    while not (out / "checkpoint.safetensors").exists():
        assert process.poll() is None and time.monotonic() < started + PATIENCE_S, process.communicate()[0]
        time.sleep(0.01)


def stop_on_the_way(subject, out, processes, number, look=lambda process: None):
    """Send a signal once the first checkpoint lies there; return how the training ended, and what `look` saw before."""
    process = start(subject, out, processes)
    wait_for_checkpoint(process, out)
    seen = look(process)
    process.send_signal(number)
    code, printed = finish(process)
    assert not (out / "avatar.safetensors").exists(), "the training was over before it was stopped"
    return code, printed, seen


def listening(process):
    """Addresses at which a process or its children wait for connections."""
    family = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    found = [open_ for member in family for open_ in member.net_connections() if open_.status == "LISTEN"]
    return [open_.laddr.ip for open_ in found]


@pytest.fixture(scope="module")
def stopped(subject, tmp_path_factory):
    """Training of two processes that was ended by SIGTERM: its folder, how it ended, and where it had listened."""
    out = tmp_path_factory.mktemp("stopped")
    return out, *stop_on_the_way(subject, out, 2, signal.SIGTERM, listening)


def test_what_breaks_in_one_process_stops_both(tmp_path):
    """The leader's image is sound, the other process's is not; the leader tells, and nothing waits for ever."""
    images = sheet_images(sheet_frames(), (-0.1, 0.1))
    image = images[0].image.copy()
    image[12, 12] = np.nan
    images[0] = dataclasses.replace(images[0], image=image)
    write_subject(tmp_path, images, shadow=True)
    settings = SETTINGS.model_copy(update={"steps_together": 1})
    code, printed = finish(start(tmp_path, tmp_path / "out", 2, settings=settings))
    assert code == 1
    pattern = r"step \d+, \S+, \S+: expected finite numbers, found others in loss terms: photometric \(nan\)"
    told = re.findall(pattern, printed)
    assert len(told) == 1, printed
    assert "x-0.1/0" in told[0] and "x0.1/0" in told[0]
    assert f"before it: {tmp_path / 'out/broken.safetensors'}" in printed
    assert np.isfinite(read_arrays(tmp_path / "out/broken.safetensors")["avatar.albedo"]).all()


def test_processes_listen_where_no_other_machine_reaches(stopped):
    addresses = stopped[3]
    assert len(addresses) >= 2
    assert set(addresses) == {"127.0.0.1"}


def test_interface_of_the_processes_is_the_loopback():
    """Where a machine's name leads elsewhere, nothing but this keeps them from listening there."""
    named = variables(1, 2, "file:///store")
    for backend in ("GLOO", "NCCL"):
        addresses = psutil.net_if_addrs()[named[f"{backend}_SOCKET_IFNAME"]]
        assert "127.0.0.1" in [address.address for address in addresses]


def test_the_end_of_the_other_process_is_told(subject, tmp_path):
    """As when the system ends it for want of memory."""
    process = start(subject, tmp_path / "out", 2)
    wait_for_checkpoint(process, tmp_path / "out")
    (other,) = [child for child in psutil.Process(process.pid).children() if "spawn_main" in " ".join(child.cmdline())]
    other.kill()
    code, printed = finish(process)
    assert code == 1 and "a process that trained with others was ended by signal 9" in printed, printed


def test_one_process_goes_on_to_the_same_bits_where_two_were_stopped(subject, stopped, alone):
    out, code, printed, _ = stopped
    assert code == 128 + signal.SIGTERM, printed
    step = int(re.search(rf"^stopped after (\d+) of {STEPS} steps; the same command goes on", printed, re.M)[1])
    again, table, printed = train(subject, out)
    assert f"continuing after {step} steps" in printed
    assert_same(again, alone[0])
    pd.testing.assert_frame_equal(table.drop(columns="seconds"), alone[1].drop(columns="seconds"))
