"""Faults planted in light logs, many times: how many are found, how many are seen that are not there. JSON lines.

    python -m benchmarks.bench_sync [captures/subjectA results/subjectA ...] [--trials 40] [--stages 4]

Each pair of folders is a capture and its results (index/, calibration/, tracking/). Its images stay as they are: their
brightness, or the log, is edited. What a dead or stuck LED would have changed is traced with shadow rays on the tracked
mesh; the checks themselves know an ellipsoid only. Besides, figures of capsules are lit in every kind of interleaving.
Healthy copies are the same with fewer cameras and frames, none of which may raise an alarm.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh

from pipeline.base.files import read_arrays, read_json, read_table
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.template_file import read_template
from pipeline.stages.book_patterns import build_model, fit_subject, seeing_cameras
from pipeline.sync.brightness import BrightnessModel, PatternLog
from pipeline.sync.image_means import measure_brightness
from pipeline.sync.sync import SyncCheck, check_sync
from tests.support.rigs.light_stage import (
    INTERLEAVINGS,
    Stage,
    brightness_model,
    build_stage,
    photograph,
    traced_transport,
    white,
)

SIGMAS, MAX_OFFSET = 5.0, 5


@dataclass(frozen=True)
class Trial:
    """A model of a log with one fault, and the fault: kind and name or value as `Fault` has them."""

    model: BrightnessModel
    kind: str
    name: str | None = None
    value: float | None = None
    power: float = np.inf


def score(source: str, fault: str, trials: list[Trial]) -> dict:
    """Counts over the trials of one fault on one source."""
    checks = [check_sync(trial.model, MAX_OFFSET, SIGMAS) for trial in trials]
    hits = [hit(trial, check) for trial, check in zip(trials, checks, strict=True)]
    others = [len(check.faults) - (sigmas is not None) for check, sigmas in zip(checks, hits, strict=True)]
    sure = [sigmas for sigmas in hits if sigmas is not None]
    counts = {
        "source": source, "fault": fault, "trials": len(trials),
        "found": len(sure), "others_reported": int(sum(others)), "copies_with_others": int(np.count_nonzero(others)),
        "undetermined": sum(check.verdict in ("undetermined", "unexplained") for check in checks),
        "median_sigma": round(float(np.median(sure)), 1) if sure else None,
    }  # fmt: skip
    if np.isfinite(trials[0].power):
        able = [trial.power >= SIGMAS for trial in trials]
        counts |= {
            "visible": sum(able),
            "visible_found": sum(a and s is not None for a, s in zip(able, hits, strict=True)),
        }
    return counts


def hit(trial: Trial, check: SyncCheck) -> float | None:
    """Confidence with which the planted fault was named, None if it was not."""
    for fault in check.faults:
        right_name = trial.name is None or fault.name == trial.name
        if fault.kind == trial.kind and right_name and (trial.value is None or fault.value == trial.value):
            return fault.sigmas
    return None


def logged(model: BrightnessModel, levels: np.ndarray, numbers: np.ndarray | None = None) -> BrightnessModel:
    """The same images under another log."""
    numbers = model.log.numbers if numbers is None else numbers
    return replace(model, log=PatternLog(numbers, model.log.lights, levels))


def lose(model: BrightnessModel, row: int) -> Trial:
    """One image lost: the following move up."""
    keep = np.delete(np.arange(len(model.frames)), row)
    return Trial(replace(model, frames=model.frames[:-1], seen=model.seen[keep]), "missing_image")


def double(model: BrightnessModel, row: int) -> Trial:
    """One image stored twice: the following move down."""
    keep = np.insert(np.arange(len(model.frames) - 1), row, row)
    return Trial(replace(model, seen=model.seen[keep]), "doubled_image")


def offset(model: BrightnessModel, rng: np.random.Generator) -> Trial:
    """The log's numbers off by up to 5; what moves beyond the capture's frames is cut away."""
    by = int(rng.choice([-5, -4, -3, -2, -1, 1, 2, 3, 4, 5]))
    numbers = model.log.numbers + by
    inside = np.isin(numbers, model.log.numbers)
    return Trial(logged(model, model.log.levels[inside], numbers[inside]), "offset", value=by)


def wrong_pattern(model: BrightnessModel, rng: np.random.Generator) -> Trial | None:
    """The log of one frame says what was logged for another one, of different lights."""
    row, other = rng.choice(len(model.log.numbers), 2, replace=False)
    if np.allclose(model.log.levels[row], model.log.levels[other]):
        return None
    levels = model.log.levels.copy()
    levels[row] = levels[other]
    return Trial(logged(model, levels), "wrong_pattern", name=str(model.log.numbers[row]))


def faults_of_log(source: str, models: Callable[[], BrightnessModel], trials: int, rng: np.random.Generator) -> None:
    """Healthy copies, and the faults that take no light to plant."""
    report(score(source, "none", [Trial(models(), "none") for _ in range(trials)]))
    report(score(source, "offset", [offset(models(), rng) for _ in range(trials)]))
    for fault, plant in (("missing image", lose), ("doubled image", double)):
        rows = [models() for _ in range(trials)]
        report(score(source, fault, [plant(m, int(rng.integers(3, len(m.frames) - 3))) for m in rows]))
    wrong = [wrong_pattern(models(), rng) for _ in range(trials)]
    if any(wrong):
        report(score(source, "wrong pattern", [trial for trial in wrong if trial]))


def broken_light(model: BrightnessModel, shares: Callable[[int, float], np.ndarray], light: int, level: float) -> Trial:
    """A light dead (level 0) or stuck; `shares` is by how much that changes each image's brightness, relatively."""
    powers = check_sync(model, MAX_OFFSET, SIGMAS).powers
    seen = model.seen * (1 + shares(light, level))[..., None]
    kind = "stuck_light" if level else "dead_light"
    power = (powers.stuck if level else powers.dead)[light]
    return Trial(replace(model, seen=seen), kind, name=model.log.lights[light], power=float(power))


def real_models(capture: Path, results: Path) -> tuple[BrightnessModel, np.ndarray]:
    """The healthy capture, and what each LED adds to each image of the tracked mesh, [frames, cameras, lights]."""
    tables = {name: read_table(results / f"index/{name}.parquet") for name in ("frames", "patterns", "images")}
    content = read_json(results / "index/capture.json")
    lights = read_table(results / "calibration/lights.parquet")
    factor = float(content["images"]["downsample_from_sensor"])
    rig = {name: c.downsampled(factor) for name, c in read_cameras(results / "calibration/cameras.json").items()}
    names = sorted(tables["images"].camera.unique())
    means = measure_brightness(capture, tables["images"], names, content["images"])
    model = build_model(tables, lights, rig, fit_subject(rig, means), means, seeing_cameras(means))
    template = content["template"]
    faces = read_template(capture / template["mesh"], template["scale_to_m"]).faces
    tracked = [read_arrays(path) for path in sorted((results / "tracking").glob("*.safetensors"))]
    vertices = dict(zip(np.concatenate([t["frames"] for t in tracked]).tolist(),
                        np.concatenate([t["vertices"] for t in tracked]), strict=True))  # fmt: skip
    places, centers = lights[["x", "y", "z"]].to_numpy(), np.stack([rig[name].center for name in names])
    transport = np.stack(
        [traced_transport(trimesh.Trimesh(vertices[f], faces, process=False), places, centers) for f in model.frames]
    )
    return model, transport


def thinned(model: BrightnessModel, rng: np.random.Generator) -> BrightnessModel:
    """At least half of the cameras and two thirds of the frames, in one piece."""
    cameras = np.sort(
        rng.permutation(model.seen.shape[1])[: rng.integers((model.seen.shape[1] + 1) // 2, model.seen.shape[1] + 1)]
    )
    count = int(rng.integers(2 * len(model.frames) // 3, len(model.frames) + 1))
    first = int(rng.integers(0, len(model.frames) - count + 1))
    frames = slice(first, first + count)
    return replace(
        model, frames=model.frames[frames], seen=model.seen[frames][:, cameras], response=model.response[cameras],
        camera_directions=model.camera_directions[cameras],
        log=PatternLog(model.log.numbers[frames], model.log.lights, model.log.levels[frames]),
    )  # fmt: skip


def bench_capture(capture: Path, results: Path, trials: int) -> None:
    """All faults on one real capture."""
    model, transport = real_models(capture, results)
    rng = np.random.default_rng(0)
    faults_of_log(capture.name, lambda: thinned(model, rng), trials, rng)
    levels = model.levels
    total = np.einsum("fcl,fl->fc", transport, levels)

    def shares(light: int, level: float) -> np.ndarray:
        return transport[:, :, light] * (level - levels[:, light])[:, None] / total

    usual = [levels[levels[:, light] > 0, light].mean() for light in range(levels.shape[1])]
    chosen = rng.permutation(levels.shape[1])[:trials]
    report(score(capture.name, "dead light", [broken_light(model, shares, int(i), 0.0) for i in chosen]))
    report(score(capture.name, "stuck light", [broken_light(model, shares, int(i), usual[i]) for i in chosen]))


def simulated(
    stages: list[Stage], kind: str, trials: int, rng: np.random.Generator
) -> Iterator[tuple[Stage, np.ndarray]]:
    for trial in range(trials):
        stage = stages[trial % len(stages)]
        yield stage, INTERLEAVINGS[kind](stage, rng)


def bench_interleaving(stages: list[Stage], kind: str, trials: int) -> None:
    """All faults on simulated stages under one interleaving of patterns."""
    rng = np.random.default_rng(1)

    def healthy() -> BrightnessModel:
        stage, log = next(simulated([stages[int(rng.integers(len(stages)))]], kind, 1, rng))
        return brightness_model(stage, log, photograph(stage, log, rng))

    faults_of_log(kind, healthy, trials, rng)
    for fault, name in (("dead_light", "dead light"), ("stuck_light", "stuck light")):
        planted = []
        for stage, log in simulated(stages, kind, trials, rng):
            light = int(rng.integers(len(stage.lights)))
            shown = log.copy()
            shown[:, light] = 0.0 if fault == "dead_light" else log[log.any(2)].mean()
            powers = check_sync(brightness_model(stage, log, photograph(stage, log, rng)), MAX_OFFSET, SIGMAS).powers
            power = (powers.dead if fault == "dead_light" else powers.stuck)[light]
            model = brightness_model(stage, log, photograph(stage, shown, rng))
            planted.append(Trial(model, fault, name=stage.names[light], power=float(power)))
        report(score(kind, name, planted))
    darkened = []
    for stage, log in simulated(stages, kind, trials, rng):
        row, shown = int(rng.integers(stage.frames)), log.copy()
        if log[row].any():
            shown[row] = white(np.zeros(len(stage.lights)))
            darkened.append(
                Trial(brightness_model(stage, log, photograph(stage, shown, rng)), "wrong_pattern", name=str(row))
            )
    report(score(kind, "dark though logged lit", darkened))


def report(counts: dict) -> None:
    print(json.dumps(counts), flush=True)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="*", type=Path, help="capture, results, capture, results ...")
    parser.add_argument("--trials", type=int, default=40, help="copies per fault")
    parser.add_argument("--stages", type=int, default=4, help="simulated figures")
    arguments = parser.parse_args()
    for capture, results in zip(arguments.folders[::2], arguments.folders[1::2], strict=True):
        bench_capture(capture, results, arguments.trials)
    stages = [build_stage(seed) for seed in range(arguments.stages)]
    for kind in INTERLEAVINGS if stages else ():
        bench_interleaving(stages, kind, arguments.trials)


if __name__ == "__main__":
    main()
