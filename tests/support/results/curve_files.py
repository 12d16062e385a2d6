"""Small curve files made by hand."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
import yaml

CURVES = {
    ("training_steps", "train_avatar", "steps", "PSNR lost on validation images, dB (reference 400)", 0.1): {
        "100": (1.0, 12.0), "200": (0.3, 22.0), "400": (0.01, 42.0),
    },
    ("supersampling", "train_avatar", "supersample", "PSNR lost on validation images, dB (reference 3)", 0.1): {
        "1": (0.5, 12.0), "3": (0.01, 22.0),
    },
    ("irradiance_power", "trace_irradiance", "samples", "irradiance, RMS (reference full)", 0.01): {
        "1": (0.5, 3.0), "4": (0.2, 4.0), "full": (0.0, 6.0),
    },
    ("environment_shadows", "relight_avatar", "environment_height", "relit pixel, RMS (reference 16)", 0.01): {
        "8": (0.02, 4.0), "16": (0.0, 5.0),
    },
}  # fmt: skip
"""(dial, stage, option, metric, allowed) -> setting -> (error, seconds), and what the stage counts, if it is known."""

SUBJECT = {
    "subject": "measured",
    "kind": "body",
    "cameras": 4,
    "frames": 10,
    "pixels": 1000,
    "texels": 1600,
    "psnr_db": 30.0,
    "settings": {
        "training_steps": 200,
        "supersampling": 3,
        "irradiance_power": "full",
        "environment_shadows": 16,
    },
}

STAGE_SECONDS = {
    "track_mesh": {"frames cameras": 0.75},
    "trace_irradiance": {"": 2.0, "frames": 0.4},
    "train_avatar": {"": 2.0, "steps": 0.1},
    "evaluate_avatar": {"avatars frames cameras": 0.2},
}
"""Stage -> product of sizes -> seconds; of ten frames and four cameras 30, 6, 202 at 2,000 steps, and 8."""

OTHER_STAGES = (
    "index_capture", "calibrate_cameras", "calibrate_color", "calibrate_lights", "book_patterns", "unwrap_atlas",
    "plan_effects", "fit_eyes", "bake_textures", "pack_shards",
)  # fmt: skip


def write_curves(folder: Path, curves: dict = CURVES, imports: float = 2.0) -> Path:
    """config/curves with these curves of one subject; returns the table's path."""
    return write_subjects(folder, {"measured": curves}, imports)


def write_subjects(folder: Path, curves: dict[str, dict], imports: float = 2.0) -> Path:
    """The same with curves of several subjects, by their names."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for subject, own in curves.items():
        for (dial, stage, option, metric, allowed), settings in own.items():
            shared = {"subject": subject, "dial": dial, "stage": stage, "option": option, "metric": metric}
            shared |= {"allowed": allowed, "standard_error": 0.02}
            rows.append({**shared, "setting": "imports only", "seconds": imports, "work": math.nan})
            names = ("error", "seconds", "work")
            rows += [
                {**shared, "setting": name, **dict(zip(names, found, strict=False))} for name, found in settings.items()
            ]
    pd.DataFrame(rows).to_csv(folder / "accuracy_cost.csv", index=False)
    (folder / "subjects.yaml").write_text(yaml.safe_dump([{**SUBJECT, "subject": name} for name in curves]))
    return folder / "accuracy_cost.csv"


def write_job_costs(path: Path, stages: dict[str, dict[str, float]] = STAGE_SECONDS) -> Path:
    """A table of what jobs take; stages that are not named take no time. Memory of a table that is there stays."""
    terms = {**{stage: {"": 0.0} for stage in OTHER_STAGES}, **stages}
    rows = [
        {"stage": stage, "cost": "seconds", "sizes": sizes, "coefficient": factor, "jobs": 1, "worst": 1.0}
        for stage, own in terms.items()
        for sizes, factor in own.items()
    ]
    table = pd.DataFrame(rows)
    if path.exists():
        before = pd.read_csv(path, keep_default_na=False)
        table = pd.concat([before[(before.cost == "mb") | ~before.stage.isin(table.stage)], table])
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False)
    return path
