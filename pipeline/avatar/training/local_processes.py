"""Processes on this machine that train one avatar together, started by the first of them."""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.context import SpawnProcess
from unittest import mock

import psutil
import torch

from pipeline.avatar.training.distributed import STORE
from pipeline.base.errors import InputError
from pipeline.base.parent_death import end_with_parent
from pipeline.config.train_avatar import TrainAvatar

FAREWELL_S = 10.0
"""How long the others get to end once this process has: what ends it, if it does not come from outside, ends them too.
Then they are killed: a process that waits for one that is gone does not hear SIGTERM."""

FREE_SHARE = 0.5
"""Share of the free memory that frames may be kept in: what a step makes of them needs as much again, and so may other
jobs."""

LOOPBACK = "127.0.0.1"


def suggested_processes(settings: TrainAvatar) -> int:
    """The number that can work side by side: one on a GPU, else one per thread.

    At most one for each step of a round.

    One thread each is best: most of a step's operations are too short to be split.
    """
    if settings.device == "cuda" or (settings.device == "auto" and torch.cuda.is_available()):
        return 1
    return min(settings.steps_together, torch.get_num_threads())


def cache_bytes(cache_mb: int, device: torch.device) -> float:
    """Bytes that this process may keep frames in.

    Its part of `cache_mb`, which all processes of this machine share, and of half of the memory that is free now, in
    which the tensors lie.
    """
    if device.type == "cuda":
        return min(1e6 * cache_mb, FREE_SHARE * torch.cuda.mem_get_info(device)[0])
    neighbours = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    return min(1e6 * cache_mb, FREE_SHARE * psutil.virtual_memory().available) / neighbours


@contextmanager
def partners(count: int, run: Callable[..., None], arguments: Mapping[str, object]) -> Iterator[None]:
    """Start the others of `count` processes, which call `run` too, and end them with this one.

    Within, `joined_processes` finds them. Nothing is started in a process that has been started so, or by torchrun.

    Args:
        count: of processes, with this one.
        run: function of a module; it gets `arguments` by name.
        arguments: as for this process.

    Raises:
        InputError: if one of the others was ended from outside, as by the system when memory is short.
    """
    if count == 1 or "WORLD_SIZE" in os.environ:
        yield
        return
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory(prefix="training_") as folder:
        store = f"file://{folder}/store"
        others = [
            spawn.Process(target=_join, args=(variables(rank, count, store), run, arguments), daemon=True)
            for rank in range(1, count)
        ]
        for other in others:
            other.start()
        try:
            with mock.patch.dict(os.environ, variables(0, count, store)):
                yield
        except RuntimeError as error:  # So a collective call says that another has gone.
            _require_not_killed(others, error)
            raise
        finally:
            for other in others:
                other.join(FAREWELL_S)
                other.kill()


def _require_not_killed(others: Sequence[SpawnProcess], error: RuntimeError) -> None:
    for other in others:
        other.join(FAREWELL_S)
        if (other.exitcode or 0) < 0:
            raise InputError(
                f"a process that trained with others was ended by signal {-other.exitcode}; if memory is short, start "
                "fewer (--processes 1); the same command goes on from the last checkpoint"
            ) from error


def variables(rank: int, count: int, store: str) -> dict[str, str]:
    """Environment of one of `count` processes, in the words of torchrun, and where they meet.

    They talk over the loopback alone: left to itself, gloo listens at the address of the machine's name.
    """
    numbers = {"RANK": rank, "LOCAL_RANK": rank, "WORLD_SIZE": count, "LOCAL_WORLD_SIZE": count}
    talk = dict.fromkeys(("GLOO_SOCKET_IFNAME", "NCCL_SOCKET_IFNAME"), loopback_interface())
    return {name: str(number) for name, number in numbers.items()} | talk | {STORE: store}


def loopback_interface() -> str:
    """Name of the network interface that no other machine reaches."""
    found = psutil.net_if_addrs().items()
    return next(name for name, addresses in found if any(address.address == LOOPBACK for address in addresses))


def _join(environment: Mapping[str, str], run: Callable[..., None], arguments: Mapping[str, object]) -> None:
    """Be one of the processes; the first tells what went wrong."""
    end_with_parent()
    os.environ.update(environment)
    try:
        run(**arguments)
    except InputError:
        raise SystemExit(1) from None
