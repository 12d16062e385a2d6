"""Simulation of a run's jobs on the nodes of a cluster: list scheduling, the longest way to the end first."""

from __future__ import annotations

import heapq
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

NODE = re.compile(r'^\s*(\d+)\[label = "(\w+)(?:\\n([^"]*))?"', re.MULTILINE)
EDGE = re.compile(r"^\s*(\d+) -> (\d+)", re.MULTILINE)


OVERHEAD_S = 29.0
"""Seconds between a job and the next, with which the first run that was held against the simulation comes out right:
submission, two starts of Snakemake, and looks at the queue. It was a cluster on one busy host."""


@dataclass(frozen=True)
class Job:
    """One job of a run.

    Attributes:
        rule: of the workflow.
        threads, mem_mb: that it asks for.
        seconds: wall time with these threads.
        after: numbers of the jobs that have to end before.
    """

    rule: str
    threads: int
    mem_mb: int
    seconds: float
    after: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Cluster:
    """Nodes that are alike.

    Attributes:
        nodes, cores, mem_mb: number of them, and what each has; a job that asks for more gets all of a node.
        overhead_s: between a job's end and the start of what waits for it, and of a node between two jobs.
        queue: jobs that are submitted at a time.
    """

    nodes: int
    cores: int = 16
    mem_mb: int = 64_000
    overhead_s: float = OVERHEAD_S
    queue: int = 100


@dataclass
class Schedule:
    """What a simulated run took.

    Attributes:
        wall_s: from its start to its end.
        busy: share of the nodes' cores that worked.
        ends: when the last job of each rule ended.
    """

    wall_s: float = 0.0
    busy: float = 0.0
    ends: dict[str, float] = field(default_factory=dict)


def read_graph(dot: str) -> tuple[dict[int, str], dict[int, frozenset[int]]]:
    """Rules of jobs, and the jobs that each waits for, of what `snakemake --dag dot` prints."""
    rules = {int(number): rule for number, rule, _ in NODE.findall(dot)}
    before = defaultdict(set)
    for first, then in EDGE.findall(dot):
        before[int(then)].add(int(first))
    return rules, {number: frozenset(before[number]) for number in rules}


def longest_ways(jobs: Mapping[int, Job], overhead_s: float) -> dict[int, float]:
    """Seconds from the start of each job to the end of the run, if nothing else waited."""
    followers, ways = defaultdict(list), {}
    for number, job in jobs.items():
        for first in job.after:
            followers[first].append(number)
    for number in reversed(in_order(jobs)):
        ways[number] = jobs[number].seconds + overhead_s + max((ways[n] for n in followers[number]), default=0.0)
    return ways


def in_order(jobs: Mapping[int, Job]) -> list[int]:
    """Numbers of the jobs, each after those that it waits for."""
    left, done = {number: set(job.after) for number, job in jobs.items()}, []
    while left:
        free = [number for number, before in left.items() if not before]
        if not free:
            raise ValueError(f"expected jobs that wait for others, found a circle among {sorted(left)}")
        for number in free:
            del left[number]
        done += free
        for before in left.values():
            before.difference_update(free)
    return done


def simulate(jobs: Mapping[int, Job], cluster: Cluster) -> Schedule:
    """Run of these jobs on a cluster."""
    ways, left = longest_ways(jobs, cluster.overhead_s), {n: set(job.after) for n, job in jobs.items()}
    free = [[cluster.cores, cluster.mem_mb] for _ in range(cluster.nodes)]
    ready = sorted((n for n in jobs if not left[n]), key=lambda n: -ways[n])
    running: list[tuple[float, int, int, int, int]] = []  # end, job, node, cores, memory
    found, now, worked = Schedule(), 0.0, 0.0
    while ready or running:
        waiting: list[int] = []
        for number in ready:
            job = jobs[number]
            cores, memory = min(job.threads, cluster.cores), min(job.mem_mb, cluster.mem_mb)
            node = _first_fit(free, cores, memory) if len(running) < cluster.queue else None
            if node is None:
                waiting.append(number)
                continue
            free[node][0] -= cores
            free[node][1] -= memory
            heapq.heappush(running, (now + job.seconds + cluster.overhead_s, number, node, cores, memory))
            worked += cores * job.seconds
        ready = waiting
        now, number, node, cores, memory = heapq.heappop(running)
        free[node][0] += cores
        free[node][1] += memory
        found.ends[jobs[number].rule] = now
        for other, before in left.items():
            if number in before:
                before.remove(number)
                if not before:
                    ready.append(other)
        ready.sort(key=lambda n: -ways[n])
    found.wall_s, found.busy = now, worked / (now * cluster.nodes * cluster.cores) if now else 0.0
    return found


def _first_fit(free: Sequence[Sequence[int]], cores: int, memory: int) -> int | None:
    """First node with so many cores and so much memory."""
    return next((place for place, (c, m) in enumerate(free) if c >= cores and m >= memory), None)
