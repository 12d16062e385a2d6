"""Results of a subject planted by hand, small and complete, as the report reads them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.verdicts import Verdict, verdict_table
from pipeline.capture.images import write_png
from pipeline.metrics.comparison import side_by_side
from pipeline.metrics.evaluation import summarize

SIZE = (40, 24)
"""Height and width of the images."""

CAPTURED, RENDERED = (0.9, 0.1, 0.1), (0.1, 0.8, 0.1)
"""sRGB of the two: red and green, so that a screenshot tells which is shown."""

PROTOCOL = {"color_space": "sRGB", "region": "psnr: <planted>", "lpips_net": "alex", "lpips_weights": "none"}
OPTIONAL = ("accuracy_cost.csv", "accuracy_cost.png", "error_budget", "calibration/review", "tracking/review", "relit")
OF_THE_PROJECT = ("hard_cases.csv", "effects_comparison.csv", "scaling")


def plot(path: Path, seed: int = 0) -> None:
    """A white picture with some noise, as wide as plots are."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.full((150, 650, 3), 255, np.uint8)
    image[10:140, 10:300] = np.random.default_rng(seed).integers(0, 256, (130, 290, 3))
    write_png(path, image)


def scores(variants: dict[str, float], subject: str = "someone", frames: int = 16) -> pd.DataFrame:
    """Scores per image of two test cameras: a PSNR per frame, each variant's effect, some noise."""
    rng = np.random.default_rng(len(subject))
    rows = []
    base = 25 + rng.standard_normal(frames)
    for variant, effect in variants.items():
        for index in range(2 * frames):
            frame = index // 2
            flags = {"test_camera": True, "test_frame": frame == 3, "test_segment": False, "test_pattern": False}
            flags["validation"] = False
            score = {"psnr_db": base[frame] + effect + 0.01 * rng.standard_normal(), "ssim": 0.9, "flip": 0.1}
            names = {"subject": subject, "variant": variant, "index": index, "camera": f"cam{index % 2}"}
            light = {"fully_lit": frame % 3 == 0, "lpips": np.nan, "foreground_pixels": 100}
            rows.append(names | {"frame": frame} | flags | light | score)
    return pd.DataFrame(rows)


def write_results(folder: Path, variants: dict[str, float] | None = None) -> Path:
    """Fill results/SUBJECT, and results, with all that a report may show; returns results."""
    variants = variants or {"full": 0.0, "matte": -1.0}
    _write_scores(folder, scores(variants), variants)
    _write_recording(folder)
    for picture in ("calibration/review/rig.png", "calibration/review/corners.png", "calibration/review/balls.png"):
        plot(folder / picture)
    for picture in ("errors", "worst", "camera_a", "camera_b"):
        plot(folder / f"tracking/review/{picture}.png")
    plot(folder / "relit/full/sky/stills/000.png")
    plot(folder / "accuracy_cost.png")
    cost = {"dial": "samples", "metric": "RMS", "unit": "rays", "allowed": 0.1, "pareto": True, "peak_mb": 300.0}
    times = {"seconds_spread": 0.2, "seconds_low": 1.0, "seconds_high": 1.2, "cpu_seconds": 1.0, "work": 1e6}
    rows = [{"setting": str(n), "error": 1 / n, "seconds": 1.0 * n, "chosen": n == 16} for n in (4, 16, 64)]
    pd.DataFrame([cost | times | row for row in rows]).to_csv(folder / "accuracy_cost.csv", index=False)
    plot(folder / "error_budget/error_budget.png")
    steps = pd.DataFrame({"step": ["all true", "our tracking"], "true": ["tracking", ""]})
    steps["validation_db"] = [31.0, 29.0]
    for lit in ("all", "full", "partial"):
        steps[f"test_{lit}_db"] = [30.5, 28.5]
    steps.to_csv(folder / "error_budget/error_budget.csv", index=False)
    cases = {"case": ["q = -p", "a < b"], "group": "lobes", "value_error": [1e-9, 2e-3], "value_bound": 1e-6}
    more = {"gradient_error": 1e-8, "gradient_bound": 1e-5, "verdict": ["PASS", "FAIL"], "naive_error": [np.inf, 1]}
    pd.DataFrame(cases | more).to_csv(folder.parent / "hard_cases.csv", index=False)
    _write_scaling(folder.parent / "scaling")
    _write_effects(folder.parent / "effects_comparison.csv")
    return folder.parent


def _write_scaling(folder: Path) -> None:
    plot(folder / "scaling.png")
    sizes = {"stage": "pack_shards", "varied": "images", "smallest": 4, "largest": 256, "held": "9216 pixels"}
    costs = {"cost": ["CPU seconds", "peak MB"], "predicted": [1.0, 0.0], "exponent": [0.98, 0.31], "low": [0.9, 0.2]}
    more = {"high": [1.1, 0.4], "verdict": ["as predicted", "more than predicted"], "reason": "one <b> by one"}
    pd.DataFrame(sizes | costs | more).to_csv(folder / "exponents.csv", index=False)
    job = {"capture": "RFGCA", "stage": "pack_shards", "sizes": "32768 images, 1.5e+06 pixels", "beyond": 1000.0}
    cost = {"cpu_hours": 123.0, "cpu_hours_low": 100.0, "cpu_hours_high": 150.0, "peak_gb": 1.5}
    pd.DataFrame([job | cost]).to_csv(folder / "projection.csv", index=False)


def _write_effects(path: Path) -> None:
    rows = [
        {"scene": "diffuse", "avatar": avatar, "effects": effects, "shading": "transfer", "psnr_db": 40.0 - lost,
         "psnr_lost_db": lost, "cpu_seconds": seconds, "cpu_ratio": seconds / 40, "parameters": 1234, "jobs": jobs,
         "steps": 300}
        for avatar, effects, lost, seconds, jobs in (
            ("everything", "shadow near_field", 0.0, 40.0, 9), ("auto", "", 0.07, 10.0, 6),
            ("not_shadow", "", 0.5, 11.0, None),
        )
    ]  # fmt: skip
    pd.DataFrame(rows).to_csv(path, index=False)


def _write_scores(folder: Path, per_image: pd.DataFrame, variants: dict[str, float]) -> None:
    folder.mkdir(parents=True)
    per_image.to_parquet(folder / "metrics_per_image.parquet")
    means = [summarize(rows).assign(subject="someone", variant=name, **PROTOCOL)
             for name, rows in per_image.groupby("variant", sort=False)]  # fmt: skip
    pd.concat(means).to_csv(folder / "metrics.csv", index=False)
    names = {"subject": "someone", "variant": list(variants)}
    pd.DataFrame(names | {"parameters": 12345}).to_csv(folder / "ablations.csv", index=False)
    times = {"training_seconds": 60.0, "render_milliseconds": 12.5}
    pd.DataFrame(names | times).to_csv(folder / "avatar_times.csv", index=False)
    captured, rendered = (np.broadcast_to(np.array(color, np.float32), (*SIZE, 3)) for color in (CAPTURED, RENDERED))
    for variant in variants:
        for name in ("worst", "median", "best"):
            path = folder / f"images/{variant}_{name}.png"
            path.parent.mkdir(exist_ok=True)
            write_png(path, side_by_side(captured, rendered, "label"))


def _write_recording(folder: Path) -> None:
    for name in ("index", "calibration", "tracking", "benchmarks"):
        (folder / name).mkdir(exist_ok=True)
    template = {"mesh": "t.glb", "mesh_digest": "ab" * 16}
    (folder / "index/capture.json").write_text(json.dumps({"subject": "someone", "template": template}))
    cameras = pd.DataFrame({"camera": ["cam0", "cam1"], "width": SIZE[1], "height": SIZE[0]})
    cameras.to_parquet(folder / "index/cameras.parquet")
    pd.DataFrame({"frame": range(16)}).to_parquet(folder / "index/frames.parquet")
    pd.DataFrame({"light": ["L0", "L1", "L2"]}).to_parquet(folder / "index/lights.parquet")
    images = pd.DataFrame({"camera": "cam0", "digest": ["d0", "d1"], "mask_digest": ["m0", "m1"]})
    images.to_parquet(folder / "index/images.parquet")
    for part, kind in (("cameras", "camera"), ("lights", "light"), ("color", "color")):
        verdicts = [Verdict(kind, "a", "good", "fits"), Verdict(kind, "b", "weak", f"{kind} <b> is uncertain")]
        verdict_table(verdicts).to_csv(folder / f"calibration/verdicts_{part}.csv", index=False)
    judged = [Verdict("light", "L0", "good", "as logged"), Verdict("exposure", "cam0", "weak", "over<exposed>")]
    verdict_table(judged).to_csv(folder / "verdicts_patterns.csv", index=False)
    gaze = verdict_table([Verdict("gaze", "left", "failed", "turns the other way")])
    gaze.to_csv(folder / "verdicts_eyes.csv", index=False)
    masks = verdict_table([Verdict("masks", "cam1", "good", "silhouettes overlap by 0.970")])
    masks.to_csv(folder / "tracking/verdicts_0000.csv", index=False)
    sync = {"verdict": "in_sync", "why": "as declared"}
    (folder / "sync.json").write_text(json.dumps(sync))
    lit = {"fully_lit": [k % 3 == 0 for k in range(16)], "pattern": range(16), "lights_on": [3, 1, 1, 2] * 4}
    pd.DataFrame({"frame": range(16)} | lit).to_parquet(folder / "frames.parquet")
    tracked = pd.DataFrame({"frame": range(16), "rms_px": np.linspace(0.5, 2.0, 16)})
    tracked.to_parquet(folder / "tracking/0000.parquet")
    plot(folder / "sync.png")
    plot(folder / "atlas.png")
    effect = {"on": True, "mode": "auto", "evidence": 12.34, "threshold": 1.0, "why": "12.34 % & more", "saved": "9 s"}
    (folder / "effects.json").write_text(json.dumps({"shadow": effect, "eyes": {"on": False, "mode": "off"}}))
    head = "s\th:m:s\tmax_rss\tmax_vms\tmax_uss\tmax_pss\tio_in\tio_out\tmean_load\tcpu_time\n"
    for job, seconds, memory in (
        ("track_mesh.0000", 3.0, "100"),
        ("track_mesh.0001", 4.0, "250"),
        ("index_capture", 1, "NA"),
    ):
        (folder / f"benchmarks/{job}.tsv").write_text(f"{head}{seconds}\t0:00:01\t{memory}\t1\t1\t1\t0\t0\t50\t2.5\n")
