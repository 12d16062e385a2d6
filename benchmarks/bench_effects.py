"""What a plan saves, and what it costs in quality: a table of scenes and avatars.

    python -m benchmarks.bench_effects [--out results/effects_comparison.csv] [--steps 300] [--scenes diffuse ...]

Each scene of `benchmarks.effect_scenes` is photographed and planned. Three avatars are trained on it alike:
`everything` (RFGCA's model with every effect on, whatever the plan says), `full` (that model with the effects of the
scene as planned) and `auto` (the default settings: the plan decides learned transport and deferred shading, too). A row
has the effects that are on, the PSNR of held-out images and what it loses against everything on, CPU seconds of
preparing light and training on one thread, the jobs that the workflow has left after the plan, counted by Snakemake,
and parameters. CPU seconds hardly depend on what else the machine does.

Scenes are drawn twice: cameras, lights, patterns and noise. Settings are chosen on `--draw validation`; the table is of
`report`, which no setting was chosen by.
"""

from __future__ import annotations

import argparse
import json
import logging
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import torch

from benchmarks.effect_jobs import count_jobs
from benchmarks.effect_scenes import SCENES, SMALL, make_scene
from pipeline.base.files import read_json, write_table
from pipeline.config.effects import EFFECTS
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.config.plan_effects import PlanEffects
from pipeline.config.train_avatar import TrainAvatar
from pipeline.stages import evaluate_avatar, pack_shards, plan_effects, trace_irradiance, train_avatar

PAPER = {"shading": "transfer", "deferred": "on", "weight_mask": 0.1, "weight_negative": 0.01, "weight_smooth": 0.0}
EVERYTHING = PAPER | dict.fromkeys(("specular", "shadow", "near_field", "articulation"), "on")
AVATARS = {"everything": EVERYTHING, "full": PAPER, "auto": {}}
ALL_ON = PlanEffects(**dict.fromkeys([name for name in EFFECTS if name != "eyes"], "on"))


DRAWS = {"report": " report", "validation": ""}
"""What is added to a scene's name, which seeds what is drawn."""


def main() -> None:
    """Print the rows as JSON, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/effects_comparison.csv"), help="table to write")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--draw", choices=DRAWS, default="report")
    options = parser.parse_args()
    logging.basicConfig(level=logging.WARNING)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder, rows = Path(name), []
        scenes = {scene: photograph_and_plan(folder / scene, scene, options.draw) for scene in options.scenes}
        jobs = jobs_of(folder, list(scenes))
        for scene, files in scenes.items():
            for row in bench_scene(folder / scene, scene, files, options.steps):
                left = jobs[f"{scene}-{row['avatar']}"]
                row |= {"jobs": sum(left.values()), "tracing_jobs": left.get("trace_irradiance", 0)}
                rows.append({**row, "steps": options.steps, "draw": options.draw})
                print(json.dumps({"bench": "effects", **rows[-1]}), flush=True)
    write_table(options.out, pd.DataFrame(rows))


def photograph_and_plan(folder: Path, name: str, draw: str) -> dict[str, Path]:
    """A scene's files, and beside them its plan and one with everything on."""
    files = make_scene(folder, name, draw=DRAWS[draw])
    plan(files, folder / "planned.json", PlanEffects())
    plan(files, folder / "everything.json", ALL_ON)
    return files


def plan_for(folder: Path, avatar: str) -> Path:
    """The plan that an avatar is built by."""
    return folder / ("everything.json" if avatar == "everything" else "planned.json")


def jobs_of(folder: Path, scenes: list[str]) -> dict[str, dict[str, int]]:
    """SCENE-AVATAR -> rule -> jobs that the workflow has left after the plan."""
    pairs = [(scene, avatar) for scene in scenes for avatar in AVATARS]
    plans = {f"{scene}-{avatar}": read_json(plan_for(folder / scene, avatar)) for scene, avatar in pairs}
    variants = {f"{scene}-{avatar}": AVATARS[avatar] for scene, avatar in pairs}
    return count_jobs(folder / "project", plans, variants, SMALL["frames"])


def bench_scene(folder: Path, name: str, files: dict[str, Path], steps: int) -> Iterator[dict]:
    """Train and score a scene's avatars."""
    reference = None
    for avatar, choices in AVATARS.items():
        settings = TrainAvatar(steps=steps, **choices)
        row = bench_avatar(files, plan_for(folder, avatar), folder / avatar, name, settings)
        reference = row if reference is None else reference
        row["psnr_lost_db"] = round(reference["psnr_db"] - row["psnr_db"], 3)
        row["cpu_ratio"] = round(row["cpu_seconds"] / reference["cpu_seconds"], 3)
        yield {"scene": name, "avatar": avatar, **row}


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
    built = {"shading": trained["spec"]["shading"], "effects": " ".join(name for name in EFFECTS if name in planned)}
    return {
        **built, "psnr_db": round(float(scored.psnr_db), 3), "cpu_seconds": round(seconds, 2),
        "parameters": trained["parameters"],
    }  # fmt: skip


if __name__ == "__main__":
    main()
