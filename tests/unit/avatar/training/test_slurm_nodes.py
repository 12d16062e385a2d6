"""How nodes of a Slurm cluster meet, by the variables that srun gives; `tests/workflow/test_slurm_nodes.py` trains."""

import sys

import pytest

from pipeline.avatar.training.slurm_nodes import shares_a_step, torchrun_command
from pipeline.base.errors import InputError

STEP = {
    "SLURM_JOB_ID": "30071", "SLURM_STEP_ID": "2", "SLURM_STEP_NUM_TASKS": "2", "SLURM_STEP_NUM_NODES": "2",
    "SLURM_STEP_NODELIST": "gpu[07,12]", "SLURM_NODEID": "1", "SLURM_PROCID": "1",
}  # fmt: skip


def ask(*words):
    """What `scontrol` of Slurm 22.05 prints."""
    if words == ("scontrol", "show", "hostnames", "gpu[07,12]"):
        return "gpu07\ngpu12\n"
    node = words[-1]
    assert words == ("scontrol", "show", "node", "--oneliner", node)
    return f"NodeName={node} Arch=x86_64 CPUTot=2 NodeAddr=10.0.0.{node[3:]} NodeHostName={node} Port=6818\n"


def options(variables):
    command = torchrun_command(variables, 4, ["--out", "x"], ask)
    assert command[:3] == [sys.executable, "-m", "torch.distributed.run"]
    assert command[-4:] == ["-m", "pipeline.stages.train_avatar", "--out", "x"]
    return dict(word.removeprefix("--").split("=", 1) for word in command[3:-4])


def test_all_nodes_meet_on_the_first_of_them():
    first, second = (options({**STEP, "SLURM_NODEID": place}) for place in "01")
    same = {"nnodes": "2", "nproc-per-node": "4", "rdzv-id": "30071.2", "rdzv-endpoint": "10.0.0.07:20071"}
    assert same.items() <= first.items() and same.items() <= second.items()
    assert (first["rdzv-conf"], first["local-addr"]) == ("is_host=1", "10.0.0.07")
    assert (second["rdzv-conf"], second["local-addr"]) == ("is_host=0", "10.0.0.12")


def test_port_is_one_that_systems_do_not_give_out():
    for job in (1, 9_999, 10_000, 67_043_327):
        port = int(options({**STEP, "SLURM_JOB_ID": str(job)})["rdzv-endpoint"].rpartition(":")[2])
        assert 1024 < port < 32_768


@pytest.mark.parametrize(
    ("variables", "shared"),
    [
        ({}, False),
        (STEP, True),
        ({**STEP, "SLURM_STEP_NUM_TASKS": "1"}, False),
        ({**STEP, "WORLD_SIZE": "2"}, False),
    ],
)
def test_only_one_of_several_tasks_of_srun_becomes_torchrun(variables, shared):
    assert shares_a_step(variables) == shared


def test_several_tasks_on_a_node_are_refused():
    with pytest.raises(InputError, match="expected one task on each node, found 4 on 2; say --ntasks-per-node=1"):
        torchrun_command({**STEP, "SLURM_STEP_NUM_TASKS": "4"}, 1, [], ask)


def test_slurm_that_does_not_answer_is_named():
    with pytest.raises(InputError, match=r"expected names of nodes gpu\[07,12\], found none"):
        torchrun_command(STEP, 1, [], lambda *words: "")
    with pytest.raises(InputError, match="expected the address of node gpu07, found none"):
        torchrun_command(STEP, 1, [], lambda *words: "gpu07 gpu12" if "hostnames" in words else "")
