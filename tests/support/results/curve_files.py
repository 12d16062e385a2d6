"""Small curve files made by hand."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import yaml

CURVES = {
    ("training_steps", "train_avatar", "steps", "PSNR lost on test images, all lit, dB (reference 400)", 0.1): {
        "100": (1.0, 12.0), "200": (0.3, 22.0), "400": (0.01, 42.0),
    },
    ("supersampling", "train_avatar", "supersample", "PSNR lost on test images, all lit, dB (reference 2)", 0.1): {
        "1": (0.5, 12.0), "2": (0.01, 22.0),
    },
    ("irradiance_power", "trace_irradiance", "samples", "irradiance, RMS (reference full)", 0.01): {
        "1": (0.5, 3.0), "4": (0.2, 4.0), "full": (0.0, 6.0),
    },
    ("environment_shadows", "relight_avatar", "environment_height", "relit pixel, RMS (reference 16)", 0.01): {
        "8": (0.02, 4.0), "16": (0.0, 5.0),
    },
}  # fmt: skip
"""(dial, stage, option, metric, allowed) -> setting -> (error, seconds)."""

SUBJECT = {
    "subject": "measured",
    "cameras": 4,
    "frames": 10,
    "pixels": 1000,
    "psnr_db": 30.0,
    "settings": {
        "training_steps": 200,
        "supersampling": 2,
        "irradiance_power": "full",
        "environment_shadows": 16,
    },
    "seconds": {"track_mesh": 30.0, "trace_irradiance": 6.0, "train_avatar": 22.0, "evaluate_avatar": 8.0},
}


def write_curves(folder: Path, curves: dict = CURVES, imports: float = 2.0) -> Path:
    """config/curves with these curves and this subject; returns the table's path."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for (dial, stage, option, metric, allowed), settings in curves.items():
        shared = {"dial": dial, "stage": stage, "option": option, "metric": metric, "allowed": allowed}
        rows.append({**shared, "setting": "imports only", "seconds": imports})
        rows += [{**shared, "setting": name, "error": e, "seconds": s} for name, (e, s) in settings.items()]
    pd.DataFrame(rows).to_csv(folder / "accuracy_cost.csv", index=False)
    (folder / "subject.yaml").write_text(yaml.safe_dump(SUBJECT))
    return folder / "accuracy_cost.csv"
