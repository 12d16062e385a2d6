"""Several processes that train one avatar.

Each works on other steps of a round, or where there are more processes than steps, on other images of a step; all sum
their gradients.

Started by `pipeline.avatar.training.local_processes` on one machine, or by torchrun on several, which
`pipeline.avatar.training.slurm_nodes` starts under Slurm; alone otherwise. The gradients of all
parameters lie in one flat tensor that is summed by one call, rather than in the buckets of `DistributedDataParallel`:
that needs no wrapped module, whose one `forward` would have to be `prepare`, `view` and the losses in one; a parameter
that a process did not use has the gradient zero there, instead of holding up the others; and the same tensor answers,
by one reduction, whether all gradients are finite.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TypeVar

import numba
import torch
import torch.distributed
from jaxtyping import Float
from torch import Tensor, nn

from pipeline.avatar.training.optimizer import learned_parameters
from pipeline.base.errors import InputError
from pipeline.config.trained_model import Device

Item = TypeVar("Item")

PATIENCE = timedelta(minutes=10)
"""How long a process waits for the others: longer than tracing a frame's bounces or reading a large capture takes."""

STORE = "TRAINING_STORE"
"""Variable of the environment that names where processes meet; without it, they meet where torchrun says."""

CPU = torch.device("cpu")


@dataclass(frozen=True)
class Processes:
    """This process among all that train one avatar.

    Attributes:
        rank: number of this process; 0, the main one, alone writes files.
        count: number of processes.
        device: where this process computes.
    """

    rank: int = 0
    count: int = 1
    device: torch.device = CPU

    @property
    def is_main(self) -> bool:
        """This process writes files."""
        return self.rank == 0

    def sharers(self, step: int, steps: int) -> list[int]:
        """Ranks of those who work on one of a round's steps.

        One process, or several where there are more processes than steps.
        """
        if self.count <= steps:
            return [step * self.count // steps]
        return [rank for rank in range(self.count) if rank * steps // self.count == step]

    def share(self, items: Sequence[Item], sharers: Sequence[int]) -> Sequence[Item]:
        """Items that fall to this process: every n-th, if it is one of n sharers."""
        return items[sharers.index(self.rank) :: len(sharers)] if self.rank in sharers else items[:0]

    def sum_in_place(self, tensor: Tensor) -> None:
        """Replace `tensor` by its sum over all processes, the same bits in each of them."""
        if self.count > 1:
            torch.distributed.all_reduce(tensor)

    def gather(self, item: dict) -> list[dict]:
        """Gather the items of all processes, by rank. They are what JSON can say."""
        if self.count == 1:
            return [item]
        text = torch.tensor(bytearray(json.dumps(item).encode()), dtype=torch.uint8, device=self.device)
        lengths = torch.zeros(self.count, dtype=torch.int64, device=self.device)
        lengths[self.rank] = len(text)
        self.sum_in_place(lengths)
        texts = torch.zeros(self.count, int(lengths.max()), dtype=torch.uint8, device=self.device)
        texts[self.rank, : len(text)] = text
        self.sum_in_place(texts)
        rows = zip(texts.cpu(), lengths.tolist(), strict=True)
        return [json.loads(bytes(row[:length].tolist())) for row, length in rows]

    def wait(self) -> None:
        """Return once every process has got here."""
        if self.count > 1:
            torch.distributed.barrier()


@contextmanager
def joined_processes(device: Device) -> Iterator[Processes]:
    """Join the processes that torchrun started, of which its environment variables tell.

    The threads that this process was given are divided among those on the same machine.

    Raises:
        InputError: if `device` is cuda and there is none for this process.
    """
    rank, count, local, neighbours = (
        int(os.environ.get(name, default))
        for name, default in (("RANK", 0), ("WORLD_SIZE", 1), ("LOCAL_RANK", 0), ("LOCAL_WORLD_SIZE", 1))
    )
    processes = Processes(rank, count, choose_device(device, local, neighbours))
    if count == 1:
        yield processes
        return
    if not processes.is_main:
        logging.getLogger().setLevel(logging.WARNING)  # All of them would say the same.
    threads = torch.get_num_threads(), numba.get_num_threads()
    torch.set_num_threads(max(1, threads[0] // neighbours))
    numba.set_num_threads(max(1, threads[1] // neighbours))
    backend = "nccl" if processes.device.type == "cuda" else "gloo"
    torch.distributed.init_process_group(
        backend, init_method=os.environ.get(STORE), timeout=PATIENCE, rank=rank, world_size=count
    )
    try:
        yield processes
    finally:
        torch.distributed.destroy_process_group()
        torch.set_num_threads(threads[0])
        numba.set_num_threads(threads[1])


def choose_device(wanted: Device, local_rank: int = 0, processes: int = 1) -> torch.device:
    """The device of a process; auto: a GPU each if there are enough of them, else the CPU.

    Raises:
        InputError: if `wanted` is cuda and there are fewer GPUs than processes on this machine.
    """
    found = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if wanted == "cpu" or (wanted == "auto" and found < processes):
        return CPU
    if found < processes:
        raise InputError(
            f"device: cuda: expected a GPU for each process on this machine, found {found} for {processes}; "
            "start fewer processes, or ask for auto or cpu"
        )
    torch.cuda.set_device(local_rank)
    return torch.device("cuda", local_rank)


class FlatGradients:
    """The gradients of a module's parameters in each step of a round, as views of one tensor.

    Backward passes add to the row that was pointed to, at first 0; what none reached stays zero, which moves nothing.

    Attributes:
        flat: all gradients, one behind the other; a row per step.
        views: for each step, name -> the gradient of that parameter.
    """

    def __init__(self, module: nn.Module, steps: int = 1) -> None:
        self.parameters = learned_parameters(module)
        sizes = [parameter.numel() for parameter in self.parameters.values()]
        first = next(iter(self.parameters.values()))
        self.flat: Float[Tensor, "steps numbers"] = first.new_zeros(steps, sum(sizes))
        shapes = [(name, parameter.shape) for name, parameter in self.parameters.items()]
        rows = [zip(shapes, row.split(sizes), strict=True) for row in self.flat]
        self.views = [{name: piece.view(shape) for (name, shape), piece in row} for row in rows]
        self.point_to(0)

    def point_to(self, row: int) -> None:
        """Let backward passes add to a row, and the optimiser read it."""
        for name, parameter in self.parameters.items():
            parameter.grad = self.views[row][name]

    def clear(self) -> None:
        """Start a round."""
        self.flat.zero_()

    def not_finite(self, row: int = 0) -> list[str]:
        """Names of the parameters whose gradients are not all finite.

        Looks at each only if their sum is not, which may also overflow.
        """
        if bool(torch.isfinite(self.flat[row].sum())):
            return []
        return [name for name, view in self.views[row].items() if not bool(torch.isfinite(view).all())]
