"""The simulated schedule of a run, against runs whose time is counted by hand."""

import pytest

from benchmarks.schedule import Cluster, Job, read_graph, simulate

ONE = Cluster(1, cores=2, mem_mb=100, overhead_s=0)


def row(count, threads=1, seconds=10.0, mem_mb=10):
    return {number: Job("a", threads, mem_mb, seconds) for number in range(count)}


def test_jobs_share_the_cores_of_a_node():
    assert simulate(row(6), ONE).wall_s == 30
    assert simulate(row(6), ONE).busy == 1
    assert simulate(row(6, threads=2), ONE).wall_s == 60
    assert simulate(row(6), Cluster(3, cores=2, mem_mb=100, overhead_s=0)).wall_s == 10


def test_memory_and_the_queue_hold_jobs_back():
    assert simulate(row(4, mem_mb=60), ONE).wall_s == 40
    assert simulate(row(4, mem_mb=600), ONE).wall_s == 40  # more than a node has: all of it
    assert simulate(row(4), Cluster(9, overhead_s=0, queue=1)).wall_s == 40


def test_a_job_waits_for_those_before_it_and_the_longest_way_goes_first():
    """Two cores: the chain of 5 + 20 runs beside the two of 12, if it begins at once; else it takes 37."""
    jobs = {0: Job("short", 1, 1, 12), 1: Job("short", 1, 1, 12), 2: Job("first", 1, 1, 5)}
    jobs[3] = Job("last", 1, 1, 20, frozenset({2}))
    found = simulate(jobs, ONE)
    assert found.wall_s == 25
    assert found.ends == {"short": 24, "first": 5, "last": 25}
    with_overhead = simulate(jobs, Cluster(1, cores=2, mem_mb=100, overhead_s=1))
    assert with_overhead.wall_s == 27


def test_a_circle_is_refused():
    jobs = {0: Job("a", 1, 1, 1, frozenset({1})), 1: Job("b", 1, 1, 1, frozenset({0}))}
    with pytest.raises(ValueError, match="circle"):
        simulate(jobs, ONE)


def test_graph_is_read_from_what_snakemake_prints():
    dot = """digraph snakemake_dag {
    node[shape=box];
\t0[label = "index_capture\\nsubject: paper", color = "0.34 0.6 0.85", style="rounded,dashed"];
\t1[label = "track_mesh\\nchunk: 0000", color = "0.1 0.6 0.85", style="rounded"];
\t2[label = "train_avatar", color = "0.1 0.6 0.85", style="rounded"];
\t0 -> 1
\t0 -> 2
\t1 -> 2
}"""
    rules, before = read_graph(dot)
    assert rules == {0: "index_capture", 1: "track_mesh", 2: "train_avatar"}
    assert before == {0: frozenset(), 1: frozenset({0}), 2: frozenset({0, 1})}
