"""A Slurm cluster on this machine: munge, the controller, and a daemon for each of its nodes, in one folder.

The nodes share the machine's processors, files and address, and differ in their names and ports alone. It needs neither
root nor systemd nor cgroups.
"""

from __future__ import annotations

import getpass
import os
import re
import shlex
import shutil
import socket
import subprocess
import sysconfig
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import psutil

PROGRAMS = ("munged", "munge", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "scancel", "scontrol", "sinfo")
PACKAGES = "apt-get install --no-install-recommends munge slurmctld slurmd slurm-client"
PLUGIN = "snakemake_executor_plugin_slurm"
SBIN = "/usr/sbin"
"""Where daemons are, which is not on everyone's PATH."""

PATIENCE_S = 60.0
"""Far more than a daemon needs to answer: a second."""

CONFIGURATION = """\
ClusterName=tests
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller_port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/%n
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.%n.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.%n.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/linux
JobAcctGatherFrequency=1
JobAcctGatherParams=UsePss,OverMemoryKill
AccountingStorageType=accounting_storage/none
MpiDefault=none
SwitchType=switch/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SlurmdParameters=config_overrides
ReturnToService=1
SchedulerParameters=sched_min_interval=0,sched_interval=1,bf_interval=1
MinJobAge=3600
MailProg=/bin/true
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""
"""Memory is enforced by sampling, in place of cgroups; jobs start at once; finished ones are known for an hour."""


@dataclass(frozen=True)
class ClusterJob:
    """A job as squeue tells of it.

    Attributes:
        number: Slurm's.
        rule: Snakemake's rule and wildcards, as the plugin notes them.
        state: such as RUNNING, COMPLETED or CANCELLED.
        node: where it runs or ran.
        started, ended: such as 2025-01-01T12:00:00.
    """

    number: str
    rule: str
    state: str
    node: str
    started: str
    ended: str


def lacking() -> str | None:
    """What is not installed here, and how to mend it; None if nothing is."""
    path = os.pathsep.join([os.environ.get("PATH", ""), SBIN])
    absent = [program for program in PROGRAMS if shutil.which(program, path=path) is None]
    if absent:
        return f"no {', '.join(absent)}: {PACKAGES}"
    return None if find_spec(PLUGIN) else f"no {PLUGIN}: pip install --editable '.[slurm]'"


class SlurmCluster:
    """Nodes n1, n2, ... of so many processors and megabytes; a context manager."""

    def __init__(self, folder: Path, nodes: int = 2, cpus: int = 2, mem_mb: int = 8000) -> None:
        self.folder, self.nodes = folder, [f"n{number}" for number in range(1, nodes + 1)]
        self._cpus, self._mem_mb = cpus, mem_mb
        self._daemons: dict[str, subprocess.Popen] = {}
        self._ending = ExitStack()
        path = os.pathsep.join([str(folder / "bin"), sysconfig.get_path("scripts"), os.environ["PATH"], SBIN])
        self.environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf"), "PATH": path}

    def __enter__(self) -> SlurmCluster:
        self._write_files()
        with ExitStack() as started:
            started.callback(self._end)
            key, socket_path = self.folder / "munge.key", self.folder / "munge.socket"
            words = [f"--key-file={key}", f"--socket={socket_path}", f"--pid-file={self.folder}/munge.pid"]
            words += [f"--log-file={self.folder}/munge.log", f"--seed-file={self.folder}/munge.seed"]
            self._start("munged", "--foreground", "--force", *words)
            self._wait(lambda: self.run("munge", f"--socket={socket_path}", "--no-input"), "munged")
            self._start("slurmctld", "-D")
            self._wait(lambda: "UP" in self.run("scontrol", "ping"), "slurmctld")
            for node in self.nodes:
                (self.folder / node).mkdir(exist_ok=True)
                self._start("slurmd", "-D", "-N", node)
            self._wait(self._all_idle, "slurmd")
            self._ending = started.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.close()

    def run(self, *words: str) -> str:
        """What one of Slurm's commands prints; nothing if it fails."""
        done = subprocess.run(words, env=self.environment, capture_output=True, text=True)
        return done.stdout if done.returncode == 0 else ""

    def jobs(self) -> list[ClusterJob]:
        """All jobs so far, in the order of their numbers."""
        lines = self.run("squeue", "--noheader", "--states=all", "--sort=i", "--format=%i|%k|%T|%N|%S|%e").splitlines()
        return [ClusterJob(*line.split("|")) for line in lines]

    def lose_node(self, node: str) -> None:
        """Let a node go as in a power cut: its daemon and all that it runs, which the controller is told."""
        lost = {job.number for job in self.jobs() if job.node == node and job.state == "RUNNING"}
        self._daemons.pop(_daemon_of(node)).kill()
        for process in psutil.process_iter():
            if self._belongs(process, lost):
                process.kill()
        self.run("scontrol", "update", f"nodename={node}", "state=down", "reason=lost")

    def _belongs(self, process: psutil.Process, numbers: set[str]) -> bool:
        """Whether a process is one of these jobs' own, or that by which Slurm watches over it."""
        try:
            variables, words = process.environ(), process.cmdline()
        except (psutil.NoSuchProcess, psutil.AccessDenied):
            return False
        if variables.get("SLURM_CONF") != self.environment["SLURM_CONF"]:
            return False
        watches = re.match(r"slurmstepd: \[(\d+)\.", words[0]) if words else None
        return (watches[1] if watches else variables.get("SLURM_JOB_ID")) in numbers

    def _all_idle(self) -> bool:
        return self.run("sinfo", "--noheader", "--Node", "--format=%T").split() == ["idle"] * len(self.nodes)

    def _write_files(self) -> None:
        for name in ("bin", "state"):
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        self.folder.chmod(0o755)
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(1024))
        key.chmod(0o600)
        host, ports = socket.gethostname().partition(".")[0], _free_ports(1 + len(self.nodes))
        text = CONFIGURATION.format(host=host, controller_port=ports[0], user=getpass.getuser(), folder=self.folder)
        for node, port in zip(self.nodes, ports[1:], strict=True):
            text += f"NodeName={node} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} "
            text += f"CPUs={self._cpus} RealMemory={self._mem_mb}\n"
        (self.folder / "slurm.conf").write_text(text)
        # The plugin's job steps take SLURM_CONF out of their environment before they call srun.
        conf, srun = shlex.quote(self.environment["SLURM_CONF"]), shlex.quote(shutil.which("srun") or "srun")
        wrapper = self.folder / "bin/srun"
        wrapper.write_text(f'#!/bin/sh\nSLURM_CONF={conf} exec {srun} "$@"\n')
        wrapper.chmod(0o755)

    def _start(self, *words: str) -> None:
        """Start a daemon that stays in the foreground."""
        name = _daemon_of(words[-1]) if words[0] == "slurmd" else words[0]
        with open(self.folder / f"{name}.out", "w") as out:
            self._daemons[name] = subprocess.Popen(
                words, env=self.environment, stdin=subprocess.DEVNULL, stdout=out, stderr=out, start_new_session=True
            )

    def _wait(self, ready: Callable[[], object], what: str) -> None:
        last = time.monotonic() + PATIENCE_S
        while not ready():
            if time.monotonic() > last:
                logs = "\n".join(path.read_text()[-1000:] for path in sorted(self.folder.glob("*.out")))
                raise TimeoutError(f"{what} does not answer:\n{logs}")
            time.sleep(0.1)

    def _end(self) -> None:
        """Cancel what runs, then end the daemons, the last to start first."""
        self.run("scancel", "--quiet", "--full", "--signal=KILL", f"--user={getpass.getuser()}")
        self.run("scancel", "--quiet", f"--user={getpass.getuser()}")
        for daemon in reversed(self._daemons.values()):
            daemon.terminate()
            try:
                daemon.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                daemon.kill()


def _daemon_of(node: str) -> str:
    return f"slurmd.{node}"


def _free_ports(count: int) -> list[int]:
    """Ports that nothing listens on, all different."""
    with ExitStack() as held:
        sockets = [held.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]
