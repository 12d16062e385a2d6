"""What a plan saves, and what it costs in quality: a table of scenes and avatars.

    python -m benchmarks.bench_effects [--out results/effects_comparison.csv] [--steps 300] [--scenes diffuse ...]
        [--draws report ...] [--turned [specular ...]] [--jobs 2]

Each scene of `benchmarks.effect_scenes` is photographed and planned. Avatars are trained on it alike:
`everything` (RFGCA's model with every effect on, whatever the plan says), `full` (that model with the effects of the
scene as planned) and `auto` (the default settings: the plan decides learned transport and deferred shading, too); and
`half`, the default after half the steps: what the same time, or less, buys. With
`--turned`, more are: the default with one decision of the plan turned round, which tells what a wrong one would cost. A
row has the effects that are on, the PSNR of held-out images and what it loses against everything on, CPU seconds of
preparing light and training on one thread, the jobs that the workflow has left after the plan, counted by Snakemake,
and parameters. CPU seconds hardly depend on what else the machine does.

Scenes are drawn several times: cameras, lights, patterns and noise. Settings are chosen on `--draws validation`; the
table is of `report` and more of its kind, which no setting was chosen by.

Rows are added to the table as they come. A run that was ended goes on; what other code has measured is measured anew.
"""

from __future__ import annotations

import argparse
import json
import logging
import multiprocessing
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path
from typing import Any

import pandas as pd
import torch

from benchmarks.effect_jobs import count_jobs
from benchmarks.effect_rows import EffectRows
from benchmarks.effect_scenes import SCENES, SMALL, make_scene
from pipeline.base.files import read_json
from pipeline.base.parent_death import end_with_parent
from pipeline.config.effects import EFFECTS
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.config.plan_effects import PlanEffects
from pipeline.config.train_avatar import TrainAvatar
from pipeline.stages import evaluate_avatar, pack_shards, plan_effects, trace_irradiance, train_avatar

PAPER = {"shading": "transfer", "deferred": "on", "weight_mask": 0.1, "weight_negative": 0.01, "weight_smooth": 0.0}
EVERYTHING = PAPER | dict.fromkeys(("specular", "shadow", "near_field", "articulation"), "on")
AVATARS = {"everything": EVERYTHING, "full": PAPER, "auto": {}, "half": {}}
STEPS_SHARE = {"half": 0.5}
"""Share of the steps that avatars are trained for, where that is not all."""

ALL_ON = PlanEffects(**dict.fromkeys([name for name in EFFECTS if name != "eyes"], "on"))


TURNED: dict[str, tuple[dict, dict]] = {
    "specular": ({"specular": "on"}, {"specular": "off"}),
    "shadow": ({"shadow": "on"}, {"shadow": "off"}),
    "near_field": ({"near_field": "on"}, {"near_field": "off"}),
    "learned_transport": ({"shading": "subsurface"}, {"shading": "microfacet"}),
}
"""Decision -> what the default avatar is told where the plan says off, and where it says on."""

DRAWS = {"report": " report", "report_2": " report 2", "report_3": " report 3", "validation": ""}
"""What is added to a scene's name, which seeds what is drawn."""

LARGE = {"width": 160, "height": 200}
"""Pixels of the pictures."""
LARGE_ATLAS = 112
"""Texels per side of their maps: about one per pixel."""


def main() -> None:
    """Print the rows as JSON, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("results/effects_comparison.csv"), help="table to write")
    parser.add_argument("--steps", type=int, default=300)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument("--draws", nargs="+", choices=DRAWS, default=["report"])
    parser.add_argument("--turned", nargs="*", choices=TURNED, help="decisions turned round, too; without names all")
    parser.add_argument("--jobs", type=int, default=1, help="scenes at a time, each on one thread")
    options = parser.parse_args()
    turned = [] if options.turned is None else options.turned or list(TURNED)
    avatars = [*AVATARS, *turned_names(turned)]
    rows = EffectRows(options.out, options.steps)
    waiting = {
        (draw, scene): missing
        for draw, scene in product(options.draws, options.scenes)
        if (missing := rows.missing(draw, scene, avatars))
    }
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, mp_context=spawn, initializer=end_with_parent) as pool:
        running = [pool.submit(bench_draw, *asked, options.steps, missing) for asked, missing in waiting.items()]
        for done in as_completed(running):
            for row in rows.add(done.result()):
                print(json.dumps({"bench": "effects", **row}), flush=True)


def bench_draw(draw: str, scene: str, steps: int, avatars: Sequence[str]) -> list[dict]:
    """Photograph a scene, plan it, and train and score some avatars."""
    logging.basicConfig(level=logging.WARNING)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = make_scene(folder, scene, LARGE_ATLAS, DRAWS[draw], **LARGE)
        plan(files, folder / "planned.json", PlanEffects())
        plan(files, folder / "everything.json", ALL_ON)
        plans = {avatar: read_json(plan_for(folder, avatar)) for avatar in AVATARS}
        jobs = count_jobs(folder / "project", plans, AVATARS, SMALL["frames"])
        choices = AVATARS | turned_avatars(plans["auto"], list(TURNED))
        rows = []
        for row in bench_scene(folder, scene, files, {avatar: choices[avatar] for avatar in avatars}, steps):
            left = jobs.get(row["avatar"], {})
            counted = {"jobs": sum(left.values()), "tracing_jobs": left.get("trace_irradiance", 0)} if left else {}
            rows.append({**row, **counted, "steps": steps, "draw": draw})
        return rows


def turned_names(turned: Sequence[str]) -> list[str]:
    """Names of default avatars with one of these decisions turned round."""
    return [f"not_{name}" for name in turned]


def turned_avatars(planned: Mapping[str, Mapping], turned: Sequence[str]) -> dict[str, dict]:
    """Settings of default avatars with one decision turned round, by `not_` and its name."""
    choices = [TURNED[name][bool(planned[name]["on"])] for name in turned]
    return dict(zip(turned_names(turned), choices, strict=True))


def plan_for(folder: Path, avatar: str) -> Path:
    """The plan that an avatar is built by."""
    return folder / ("everything.json" if avatar == "everything" else "planned.json")


def bench_scene(
    folder: Path, name: str, files: dict[str, Path], avatars: Mapping[str, dict], steps: int
) -> Iterator[dict]:
    """Train and score a scene's avatars."""
    for avatar, choices in avatars.items():
        settings = TrainAvatar(steps=round(STEPS_SHARE.get(avatar, 1.0) * steps), **choices)
        row = bench_avatar(files, plan_for(folder, avatar), folder / avatar, name, settings)
        yield {"scene": name, "avatar": avatar, **row}


def plan(files: dict[str, Path], out: Path, settings: PlanEffects) -> None:
    """Run plan_effects on a scene."""
    given = {key: path for key, path in files.items() if key not in ("tracking", "frames")}
    plan_effects.run(**given, tracking=(files["tracking"],), booked=files["frames"], out=out, settings=settings)


def bench_avatar(files: dict[str, Path], effects: Path, out: Path, subject: str, settings: TrainAvatar) -> dict:
    """Trace if an avatar needs it, pack, train, score."""
    planned = {name for name, effect in read_json(effects).items() if effect["on"]}
    begun, irradiance = time.process_time(), None
    if settings.reads_irradiance(planned):
        irradiance = out / "irradiance/0000"
        given = {key: files[key] for key in ("atlas", "tracking", "lights", "patterns", "frames")}
        trace_irradiance.run(**given, out=irradiance, subject=subject)
    light_seconds = time.process_time() - begun
    shards = out.parent / f"shards_{effects.stem}{'_traced' if irradiance else ''}"
    if not shards.exists():
        pack_shards.run(**files, effects=effects, out=shards, irradiance=irradiance)
    inputs = {"atlas": files["atlas"], "shards": shards, "effects": effects, "subject": subject}
    warm_up(inputs, out / "warm", settings, planned)
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


WARM: set[str] = set()
"""What this process has trained: settings, and the effects that were planned."""


def warm_up(inputs: Mapping[str, Any], out: Path, settings: TrainAvatar, planned: set[str]) -> None:
    """Have the kernels compiled, or loaded, that training takes, if that was not done before.

    Without refinement: it takes as long as 35 to 75 steps, and compiles none.
    """
    if (kind := f"{settings.model_dump_json()} {sorted(planned)}") not in WARM:
        train_avatar.run(**inputs, out=out, settings=settings.model_copy(update={"steps": 2, "refine_lights": False}))
        WARM.add(kind)


if __name__ == "__main__":
    main()
