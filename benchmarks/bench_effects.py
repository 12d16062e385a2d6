"""What a plan saves, and what it costs in quality: one JSON line per scene and avatar.

    python -m benchmarks.bench_effects [--steps 300] [--scenes diffuse glossy bust body near]

Each scene of `benchmarks.effect_scenes` is photographed and planned. Three avatars are trained on it alike:
`everything` (the papers' model with every effect on, whatever the plan says), `full` (the default settings under the
plan) and `auto` (the plan decides learned transport and deferred shading, too). A line has the effects that are on, the
PSNR of held-out images and what it loses against everything on, CPU seconds of preparing light and training on one
thread, jobs that trace shadows, and parameters. CPU seconds hardly depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import pandas as pd
import torch

from benchmarks.effect_scenes import SCENES, make_scene
from pipeline import evaluate_avatar, pack_shards, plan_effects, trace_irradiance, train_avatar
from pipeline.base.files import read_json
from pipeline.config.effects import EFFECTS
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.config.plan_effects import PlanEffects
from pipeline.config.train_avatar import TrainAvatar

EVERYTHING = {"specular": "on", "shadow": "on", "near_field": "on", "articulation": "on", "deferred": "on"}
AVATARS = {"everything": EVERYTHING, "full": {}, "auto": {"shading": "auto", "deferred": "auto"}}
ALL_ON = PlanEffects(**dict.fromkeys([name for name in EFFECTS if name != "eyes"], "on"))


def main() -> None:
    """Print the lines."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    options = parser.parse_args()
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.scenes:
            bench_scene(Path(folder) / name, name, options.steps)


def bench_scene(folder: Path, name: str, steps: int) -> None:
    """Photograph and plan a scene, then train and score its avatars."""
    files = make_scene(folder, name)
    plan(files, folder / "planned.json", PlanEffects())
    plan(files, folder / "everything.json", ALL_ON)
    reference = None
    for avatar, choices in AVATARS.items():
        effects = folder / ("everything.json" if avatar == "everything" else "planned.json")
        row = bench_avatar(files, effects, folder / avatar, name, TrainAvatar(steps=steps, **choices))
        reference = row if reference is None else reference
        row["psnr_lost_db"] = round(reference["psnr_db"] - row["psnr_db"], 3)
        row["cpu_ratio"] = round(row["cpu_seconds"] / reference["cpu_seconds"], 3)
        print(json.dumps({"bench": "effects", "scene": name, "avatar": avatar, **row}), flush=True)


def plan(files: dict[str, Path], out: Path, settings: PlanEffects) -> None:
    """Run plan_effects on a scene."""
    given = {key: path for key, path in files.items() if key not in ("tracking", "frames")}
    plan_effects.run(**given, tracking=(files["tracking"],), booked=files["frames"], out=out, settings=settings)


def bench_avatar(files: dict[str, Path], effects: Path, out: Path, subject: str, settings: TrainAvatar) -> dict:
    """Trace if an avatar needs it, pack, train, score."""
    planned = {name for name, effect in read_json(effects).items() if effect["on"]}
    traced = settings.reads_irradiance(planned)
    given = {key: files[key] for key in ("atlas", "tracking", "lights", "patterns", "frames")}
    begun = time.process_time()
    if traced:
        trace_irradiance.run(**given, out=out / "irradiance/0000", subject=subject)
    light_seconds = time.process_time() - begun
    pack_shards.run(
        **files, effects=effects, out=out / "shards", irradiance=out / "irradiance/0000" if traced else None
    )  # fmt: skip
    inputs = {"atlas": files["atlas"], "shards": out / "shards", "effects": effects, "subject": subject}
    train_avatar.run(**inputs, out=out / "warm", settings=settings.model_copy(update={"steps": 2}))  # compiles kernels
    begun = time.process_time()
    train_avatar.run(**inputs, out=out / "avatar", settings=settings)
    seconds = light_seconds + time.process_time() - begun
    evaluate_avatar.run(**inputs, avatars=(out / "avatar",), out=out, settings=EvaluateAvatar(pictures=False))
    table, trained = pd.read_csv(out / "metrics.csv"), read_json(out / "avatar/config.json")
    scored = table[(table.split == "test") & (table.lit == "all")].iloc[0]
    built = {"shading": trained["spec"]["shading"], "effects": [name for name in EFFECTS if name in planned]}
    return {
        **built, "psnr_db": round(float(scored.psnr_db), 3), "cpu_seconds": round(seconds, 2),
        "parameters": trained["parameters"], "irradiance_jobs": int(traced),
    }  # fmt: skip


if __name__ == "__main__":
    main()
