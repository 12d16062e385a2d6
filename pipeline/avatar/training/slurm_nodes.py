"""Training on several nodes of a Slurm cluster: each of srun's tasks becomes torchrun.

`srun --ntasks-per-node=1 python -m pipeline.stages.train_avatar ...` is all it takes. The tasks meet on the first node,
at an address that follows from the variables that Slurm gives to each. If a process is lost, torchrun starts all of
them again, and they go on from the checkpoint; if a node is, the job fails, and its next attempt goes on from there.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence

from pipeline.base.errors import InputError

RESTARTS = 3
"""Times that lost processes are started again before the job fails. What the training itself refuses fails as often,
in a few seconds."""

FIRST_PORT, PORTS = 10_000, 20_000
"""Ports on which nodes meet, by the job's number: below those that systems give out on their own, from 32,768 on."""

STORE_OF_EACH_START = {"TORCH_DISABLE_SHARE_RDZV_TCP_STORE": "1"}
"""Variables of torchrun: processes meet at a store of their own each time that they are started. Kept over several
starts, it would hold addresses of those that are gone: a node whose own process was not lost counts no restart, by
which torch 2.13 tells the starts apart."""

STAGE = "pipeline.stages.train_avatar"

Ask = Callable[..., str]
"""A command's words -> what it prints."""


def shares_a_step(variables: Mapping[str, str] = os.environ) -> bool:
    """Tell whether srun has started this process as one of several, and torchrun has not."""
    return "WORLD_SIZE" not in variables and int(variables.get("SLURM_STEP_NUM_TASKS", "1")) > 1


def become_torchrun(processes: int) -> None:
    """Replace this process, a task of srun's, by torchrun with so many processes here.

    Raises:
        InputError: if a node has several tasks, or Slurm does not say where nodes are.
    """
    command = torchrun_command(os.environ, processes, sys.argv[1:], _ask)
    sys.stdout.flush()
    os.execve(command[0], command, {**os.environ, **STORE_OF_EACH_START})


def torchrun_command(variables: Mapping[str, str], processes: int, arguments: Sequence[str], ask: Ask) -> list[str]:
    """Words that start torchrun on a node.

    Args:
        variables: of the environment that srun gives to a task.
        processes: number on each node.
        arguments: of the stage.
        ask: runs one of Slurm's commands.

    Raises:
        InputError: if a node has several tasks, or Slurm does not say where nodes are.
    """
    nodes, tasks = (int(variables[f"SLURM_STEP_NUM_{what}"]) for what in ("NODES", "TASKS"))
    if nodes != tasks:
        raise InputError(
            f"srun: expected one task on each node, found {tasks} on {nodes}; "
            "say --ntasks-per-node=1, and how many processes each starts by --processes"
        )
    names = ask("scontrol", "show", "hostnames", variables["SLURM_STEP_NODELIST"]).split()
    if not names:
        raise InputError(f"scontrol: expected names of nodes {variables['SLURM_STEP_NODELIST']}, found none")
    place, job = int(variables["SLURM_NODEID"]), int(variables["SLURM_JOB_ID"])
    options = {
        "nnodes": nodes,
        "nproc-per-node": processes,
        "node-rank": place,
        "max-restarts": RESTARTS,
        "rdzv-backend": "c10d",
        "rdzv-endpoint": f"{address_of(names[0], ask)}:{FIRST_PORT + job % PORTS}",
        "rdzv-id": f"{job}.{variables['SLURM_STEP_ID']}",
        "rdzv-conf": f"is_host={int(place == 0)}",
        "local-addr": address_of(names[place], ask),
    }
    words = [f"--{name}={value}" for name, value in options.items()]
    return [sys.executable, "-m", "torch.distributed.run", *words, "-m", STAGE, *arguments]


def address_of(node: str, ask: Ask) -> str:
    """Address of a node, or its name where that is one.

    Raises:
        InputError: if Slurm does not know it.
    """
    found = re.search(r"\bNodeAddr=(\S+)", ask("scontrol", "show", "node", "--oneliner", node))
    if found is None:
        raise InputError(f"scontrol: expected the address of node {node}, found none")
    return found[1]


def _ask(*words: str) -> str:
    try:
        return subprocess.run(words, capture_output=True, text=True, check=False).stdout
    except OSError as error:
        raise InputError(f"{words[0]}: expected Slurm's command, found {error.strerror}") from error
