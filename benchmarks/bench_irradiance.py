"""Irradiance maps against the rays alone, against trimesh, and against visibility bits: one JSON line per result.

    python -m benchmarks.bench_irradiance [--repeats 5] [--threads 2] [--frames 64] [--page docs/irradiance.md]

Sides are timed alternately in one process, wall clock, frames spread over `--threads` threads. `raw embreex` answers
the very rays of the job, made beforehand, in trees built beforehand; `whole` makes them, traces them and adds up. The
jobs of the next lines begin with posed vertices, texels and trees included; `trimesh` is the plain loop of
`intersects_any` over frames. `bits` lines give the cost of tracing and of visibility bits, and what the cost model of
pipeline.lighting.visibility_bits chose. `packets` asks the same rays of Embree eight at a time, `not robust` of a tree
that may let rays slip between two faces, on one thread. The last lines are the memory of the largest map, and a
projection to 5,000 frames of 1024 x 1024 texels.
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import statistics
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.irradiance_page import bits_lines, throughput_lines
from benchmarks.irradiance_poses import Pose, ReadyRays, dome, make_pose, ready_rays, trace_map
from benchmarks.marked_page import write_between
from benchmarks.packet_rays import packet_answers
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.texel_surface import texel_surface
from pipeline.lighting.embree import EmbreeMesh
from pipeline.lighting.frame_irradiance import FrameTracer, StageLights
from pipeline.lighting.irradiance import Samples
from pipeline.lighting.irradiance import trace_irradiance as trace
from pipeline.lighting.light_scene import Lights
from pipeline.lighting.standard_error import TexelBlocks
from pipeline.lighting.visibility import Occluders
from pipeline.lighting.visibility_bits import bits_are_cheaper, irradiance_from_bits, trace_bits

PAPER_FRAMES, PAPER_SIDE = 5000, 1024


def spread_over(pool: ThreadPoolExecutor, function: Callable, *arguments: Iterable) -> list:
    """Results of a function over lists of arguments, on the pool's threads."""
    return list(pool.map(function, *arguments))


def trimesh_loop(poses: list[Pose], lights: Lights) -> None:
    """1 sample per texel the plain way: draw, subtract, normalise, ask."""
    for frame, pose in enumerate(poses):
        mesh = trimesh.Trimesh(pose.vertices, pose.faces, process=False)
        points, normals = mesh.triangles_center[pose.atlas.face], mesh.face_normals[pose.atlas.face]
        chosen = np.random.default_rng(frame).integers(len(lights.places), size=len(points))
        way = lights.places[chosen] - points
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        hit = mesh.ray.intersects_any(points + 1e-4 * normals, way)
        np.where(hit, 0.0, 1.0)


def interleaved(sides: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Seconds of each side, run in turn; a first round, which compiles, does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in sides}
    for k in range(repeats + 1):
        for name, run in sides.items():
            start = time.perf_counter()
            run()
            if k:
                seconds[name].append(time.perf_counter() - start)
    return seconds


TOLD: list[dict[str, object]] = []
"""All that was told, for the page."""


def tell(result: str, **facts: object) -> None:
    """Print a result, and keep it."""
    TOLD.append({"result": result, **facts})
    rounded = {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in facts.items()}
    print(json.dumps({"result": result, **rounded}), flush=True)


def against_raw_rays(pool: ThreadPoolExecutor, threads: int, repeats: int) -> dict[str, float]:
    """End to end over the rays alone, for one sample and for all of 24 lights; returns nanoseconds per ray."""
    lights, cost = dome(24), {}
    for name, samples, side in (("1 sample", 1, 512), ("all lights", None, 256)):
        poses = [make_pose(side, phase) for phase in range(2 * threads)]
        ready = [ready_rays(pose, lights, samples) for pose in poses]
        count = sum(one.count for one in ready)

        one = functools.partial(trace_map, lights=lights, samples=samples)
        sides = {
            "raw": functools.partial(spread_over, pool, ReadyRays.answers, ready),
            "whole": functools.partial(spread_over, pool, one, poses, [each.occluders for each in ready]),
        }
        seconds = interleaved(sides, repeats)
        ratio = statistics.median(r / w for r, w in zip(seconds["raw"], seconds["whole"], strict=True))
        millions = {f"{k}_Mray_s": count / statistics.median(s) / 1e6 for k, s in seconds.items()}
        tell(f"end to end / raw embreex, {name}", value=ratio, rays=count, threads=threads, **millions)
        cost[name] = statistics.median(seconds["whole"]) * threads / count * 1e9
    return cost


def against_packets(repeats: int) -> None:
    """Ways to ask the same rays that could be faster than embreex's, ray after ray, robustly; on one thread."""
    lights = dome(24)
    for name, samples, side in (("1 sample", 1, 512), ("all lights", None, 256)):
        pose = make_pose(side)
        ready, careless = (ready_rays(pose, lights, samples, robust) for robust in (True, False))
        mesh = EmbreeMesh(ready.occluders.scaled(pose.vertices).astype(np.float32), pose.faces)
        ways = {
            "packets": functools.partial(packet_answers, mesh, ready.rays, False),
            "coherent packets": functools.partial(packet_answers, mesh, ready.rays, True),
            "not robust": careless.answers,
        }
        seconds = interleaved({"embreex": ready.answers, **ways}, repeats)
        answers = ready.answers()
        for way, run in ways.items():
            differ = sum(int((a != b).sum()) for a, b in zip(answers, run(), strict=True))
            ratio = statistics.median(e / w for e, w in zip(seconds["embreex"], seconds[way], strict=True))
            millions = {f"{k}_Mray_s": ready.count / statistics.median(seconds[k]) / 1e6 for k in ("embreex", way)}
            tell(f"{way} / embreex, {name}", value=ratio, rays=ready.count, differ=differ, **millions)


def against_trimesh(pool: ThreadPoolExecutor, frames: int, repeats: int) -> None:
    lights, poses = dome(24), [make_pose(512, 0.1 * frame) for frame in range(frames)]
    stage = StageLights(lights.places, dict.fromkeys(range(frames), lights.luminances))

    def ours() -> None:
        tracer = FrameTracer(poses[0].atlas, stage, TraceIrradiance(samples="1", visibility="traced", share_rays=False))

        def trace_and_drop(frame: int) -> None:
            tracer.trace(frame, poses[frame].vertices, np.random.default_rng(frame))

        spread_over(pool, trace_and_drop, range(frames))

    seconds = interleaved({"ours": ours, "trimesh": lambda: trimesh_loop(poses, lights)}, repeats)
    ratio = statistics.median(t / o for t, o in zip(seconds["trimesh"], seconds["ours"], strict=True))
    medians = {f"{k}_s": statistics.median(s) for k, s in seconds.items()}
    tell("trimesh intersects_any loop / ours, 1 sample", value=ratio, frames=frames, map="512 x 512", **medians)
    pose = poses[0]
    parts = {
        "tree": pose.occluders,
        "texels": functools.partial(texel_surface, pose.atlas, pose.vertices),
        "map": functools.partial(trace_map, pose, pose.occluders(), lights, 1),
        "rays alone": ready_rays(pose, lights, 1).answers,
    }
    milliseconds = {f"{k}_ms": 1e3 * statistics.median(s) for k, s in interleaved(parts, repeats).items()}
    tell("parts of a frame, one thread", **milliseconds)


def shared_against_all(repeats: int) -> None:
    """One ray per texel, alone and shared with its neighbours, against all rays: time, and error of the map."""
    pose = make_pose(256)
    for count in (8, 24, 96):
        stage = StageLights(dome(count).places, {0: dome(count).luminances})
        ways = {
            "alone": TraceIrradiance(samples="1", visibility="traced", share_rays=False),
            "shared": TraceIrradiance(samples="1", visibility="traced"),
            "all": TraceIrradiance(samples="full", visibility="traced"),
        }
        tracers = {name: FrameTracer(pose.atlas, stage, settings) for name, settings in ways.items()}

        def one(tracer: FrameTracer) -> np.ndarray:
            return tracer.trace(0, pose.vertices, np.random.default_rng(0)).cosine_visibility

        seconds = interleaved({name: functools.partial(one, tracer) for name, tracer in tracers.items()}, repeats)
        exact = one(tracers["all"])
        facts = {f"{k}_ms": 1e3 * statistics.median(s) for k, s in seconds.items()}
        facts |= {f"{k}_rms": float(np.sqrt(np.mean((one(tracers[k]) - exact) ** 2))) for k in ("alone", "shared")}
        ratio = statistics.median(a / s for a, s in zip(seconds["all"], seconds["shared"], strict=True))
        tell("all lights / one shared ray", value=ratio, lights=count, map="256 x 256", **facts)


def bits_against_rays(repeats: int) -> None:
    """For several numbers of patterns per pose: is the side that the cost model chose the faster one?"""
    lights, pose = dome(96), make_pose(128)
    rng = np.random.default_rng(0)
    for lit, samples in ((96, None), (16, None), (16, 1)):
        for patterns in (1, 2, 4, 16, 64):
            brightness = np.zeros((patterns, 96))
            for row in brightness:
                row[rng.permutation(96)[:lit]] = 1
            occluders = pose.occluders()

            def by_rays(
                occluders: Occluders = occluders, rows: np.ndarray = brightness, n: int | None = samples
            ) -> None:
                for row in rows:
                    drawn = n and Samples(n, "power", "random", TexelBlocks(pose.atlas.texel), np.random.default_rng(0))
                    trace(occluders, pose.points, pose.face_normals, Lights(lights.places, row), samples=drawn)

            def by_bits(occluders: Occluders = occluders, rows: np.ndarray = brightness) -> None:
                known = trace_bits(occluders, pose.points, pose.face_normals, lights.places)
                for row in rows:
                    all_lights = Lights(lights.places, row)
                    irradiance_from_bits(known, occluders, pose.points, pose.face_normals, all_lights)

            seconds = interleaved({"traced": by_rays, "bits": by_bits}, repeats)
            medians = {k: statistics.median(s) for k, s in seconds.items()}
            choice = "bits" if bits_are_cheaper(96, [lit] * patterns, samples) else "traced"
            facts = {f"{k}_ms": 1e3 * s for k, s in medians.items()}
            loss = medians[choice] / min(medians.values())
            tell(
                "visibility bits or rays", lights=96, lit=lit, samples=samples or "full", patterns=patterns,
                chosen=choice, chosen_over_better=loss, **facts,
            )  # fmt: skip


def memory_of_the_largest() -> None:
    """Peak of the process, all of it, after one sample at 1024 x 1024 texels and 1,024 lights."""
    pose, lights = make_pose(PAPER_SIDE), dome(1024)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    start = time.perf_counter()
    trace_map(pose, pose.occluders(), lights, 1)
    seconds = time.perf_counter() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    tell("memory, 1024 x 1024 texels, 1,024 lights, 1 sample", peak_MB=peak, before_MB=before, seconds=seconds)


def projection(cost_ns: dict[str, float]) -> None:
    """Hours for 5,000 frames of 1024 x 1024 texels under 1,024 lights, from the cost per ray measured here.

    Half the pairs are below the horizon; other cores are taken to be as fast as these two, and frames to be spread
    over them.
    """
    pairs = PAPER_FRAMES * PAPER_SIDE**2 / 2
    for samples, each in ((1, cost_ns["1 sample"]), (16, cost_ns["1 sample"]), (1024, cost_ns["all lights"])):
        core_hours = pairs * samples * each * 1e-9 / 3600
        hours = {f"hours_on_{cores}_cores": core_hours / cores for cores in (2, 16, 64)}
        tell("projection, 5,000 frames x 1024 x 1024 texels", samples=samples, **hours)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed runs of each side")
    parser.add_argument("--threads", type=int, default=2, help="threads of each side")
    parser.add_argument("--frames", type=int, default=64, help="frames of the job that trimesh is compared on")
    parser.add_argument("--page", type=Path, help="page with the marks throughput and bits")
    arguments = parser.parse_args()
    memory_of_the_largest()
    with ThreadPoolExecutor(arguments.threads) as pool:
        cost = against_raw_rays(pool, arguments.threads, arguments.repeats)
        against_trimesh(pool, arguments.frames, max(1, arguments.repeats // 2))
    against_packets(arguments.repeats)
    shared_against_all(arguments.repeats)
    bits_against_rays(arguments.repeats)
    projection(cost)
    if arguments.page:
        write_between(arguments.page, "throughput", throughput_lines(TOLD))
        write_between(arguments.page, "bits", bits_lines(TOLD))


if __name__ == "__main__":
    main()
