"""Training as processes of their own: two of them through torchrun, and signals from outside."""

import dataclasses
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pandas as pd
import pytest

from pipeline.base.files import read_arrays
from pipeline.config.flags import flags
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet_subject import sheet_frames, sheet_images, stage_arguments, write_subject

STEPS = 120
SETTINGS = TrainAvatar(
    steps=STEPS, cameras_per_step=3, checkpoint_every=5, log_every=1, preview_every=0, device="cpu",
    learning_rate_texture=1e-2, learning_rate_shape=3e-3, learning_rate_offset=1e-4,
)  # fmt: skip
"""Three images a step, four a frame: two processes render two and one, or one and none. Rates at which a sheet of so
few texels is learned without jumps, which would blow up roundings."""

LOSS_RTOL = 2 * STEPS * 2**-24
"""Of the loss of each step. Sums in another order differ by a rounding, 2^-24. Adam's step is the ratio of two such
sums, so each step moves the parameters by one more rounding of themselves; the loss, a mean of absolute differences
between numbers of about one, follows them, and is rounded itself."""

PATIENCE_S = 120
"""Until a process that has just been started takes its first steps, on a machine that does much else."""


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sheet")
    write_subject(folder, sheet_images(sheet_frames(), (-0.2, -0.1, 0.1, 0.2)), shadow=True)
    return folder


def start(subject, out, processes):
    launcher = [sys.executable]
    if processes > 1:
        launcher += ["-m", "torch.distributed.run", "--standalone", "--nproc_per_node", str(processes)]
    words = [word for name, value in stage_arguments(subject).items() for word in (f"--{name}", str(value))]
    words += [*flags(SETTINGS), "--out", str(out)]
    return subprocess.Popen(
        [*launcher, "-m", "pipeline.stages.train_avatar", *words],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"},
    )  # fmt: skip


def finish(process):
    printed, _ = process.communicate(timeout=PATIENCE_S)
    return process.returncode, printed


def train(subject, out, processes=1):
    code, printed = finish(start(subject, out, processes))
    assert code == 0, printed
    return read_arrays(out / "avatar.safetensors"), pd.read_parquet(out / "log.parquet"), printed


@pytest.fixture(scope="module")
def alone(subject):
    return train(subject, subject / "alone")


@pytest.fixture(scope="module")
def together(subject):
    return train(subject, subject / "together", 2)


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


def test_two_processes_follow_the_curve_of_one(alone, together):
    (_, expected, said), (_, found, said_together) = alone, together
    assert "1 x cpu" in said and "2 x cpu" in said_together
    assert said_together.count("images, ") == 1  # Only the leader speaks.
    assert len(expected) == STEPS and expected.loss.iloc[-1] < 0.6 * expected.loss.iloc[0]
    np.testing.assert_allclose(found.loss, expected.loss, rtol=LOSS_RTOL)


def stop_on_the_way(subject, out, processes, number):
    """Send a signal once the first checkpoint lies there, and return how the training ended."""
    process = start(subject, out, processes)
    started = time.monotonic()
    while not (out / "checkpoint.safetensors").exists():
        assert process.poll() is None and time.monotonic() < started + PATIENCE_S, process.communicate()[0]
        time.sleep(0.01)
    process.send_signal(number)
    code, printed = finish(process)
    assert not (out / "avatar.safetensors").exists(), "the training was over before it was stopped"
    return code, printed


def test_what_breaks_in_one_process_stops_both(tmp_path):
    """The leader's image is sound, the other process's is not; both say the same and nothing waits for ever."""
    images = sheet_images(sheet_frames(), (-0.1, 0.1))
    image = images[0].image.copy()
    image[12, 12] = np.nan
    images[0] = dataclasses.replace(images[0], image=image)
    write_subject(tmp_path, images, shadow=True)
    code, printed = finish(start(tmp_path, tmp_path / "out", 2))
    assert code == 1
    pattern = r"step \d+, \S+, \S+: expected finite numbers, found others in loss terms: photometric \(nan\)"
    told = re.findall(pattern, printed)
    assert len(told) == 2 and told[0] == told[1], printed
    assert "x-0.1/0" in told[0] and "x0.1/0" in told[0]
    assert f"before it: {tmp_path / 'out/broken.safetensors'}" in printed
    assert np.isfinite(read_arrays(tmp_path / "out/broken.safetensors")["avatar.albedo"]).all()


def test_a_killed_training_goes_on_to_the_same_bits(subject, tmp_path, alone):
    code, _ = stop_on_the_way(subject, tmp_path, 1, signal.SIGKILL)
    assert code == -signal.SIGKILL
    again, _, printed = train(subject, tmp_path)
    assert int(re.search(r"continuing after (\d+) steps", printed)[1]) % SETTINGS.checkpoint_every == 0
    assert_same(again, alone[0])


def test_two_processes_that_are_stopped_go_on_to_the_same_bits(subject, tmp_path, together):
    """torchrun hands the signal on and ends with its own message and code 1."""
    code, printed = stop_on_the_way(subject, tmp_path, 2, signal.SIGTERM)
    assert code == 1, printed
    step = int(re.search(rf"^stopped after (\d+) of {STEPS} steps; the same command goes on", printed, re.M)[1])
    again, table, printed = train(subject, tmp_path, 2)
    assert f"continuing after {step} steps" in printed
    assert_same(again, together[0])
    pd.testing.assert_frame_equal(table.drop(columns="seconds"), together[1].drop(columns="seconds"))
