"""Rows of ablations.csv: scores of a variant, and its gains over the first one."""

from __future__ import annotations

import numpy as np
import pandas as pd

from pipeline.base.splits import VALIDATION
from pipeline.metrics.evaluation import LIT, SPLITS, TABLES, capped
from pipeline.metrics.image_metrics import metrics_in
from pipeline.metrics.significance import Estimate, mean_over_images


def scores_in_a_row(means: pd.DataFrame) -> dict[str, float]:
    """METRIC_LIT of all test images; METRIC_SPLIT of validation and of `TABLES`, all light."""
    rows, metrics = means[means.split == "test"].set_index("lit"), [metric.name for metric in metrics_in(means)]
    scores = {f"{metric}_{lit}": rows.loc[lit, metric] for metric in metrics for lit in LIT}
    rows = means[means.lit == "all"].set_index("split")
    return scores | {
        f"{metric}_{split}": rows.loc[split, metric] for split in (VALIDATION, *TABLES) for metric in metrics
    }


def spread_in_a_row(per_image: pd.DataFrame, first: pd.DataFrame) -> dict[str, float]:
    """METRIC_SPLIT_error of validation and `TABLES`, and gains in PSNR over the first avatar.

    Errors are those over blocks of frames, of images that have the score; NaN where a split has too few.
    """
    found = {}
    for split in (VALIDATION, *TABLES):
        own, base = (capped(table[SPLITS[split](table)]) for table in (per_image, first))
        for metric in metrics_in(per_image):
            found[f"{metric.name}_{split}_error"] = over_frames(own[metric.name], own.frame).error
        gain = over_frames(own.psnr_db.reset_index(drop=True) - base.psnr_db.reset_index(drop=True), own.frame)
        found |= {f"psnr_db_{split}_gain": gain.mean, f"psnr_db_{split}_gain_error": gain.error}
    return found


def over_frames(values: pd.Series, frame: pd.Series) -> Estimate:
    """Mean of what is known, with its standard error."""
    numbers = values.to_numpy(np.float64)
    known = np.isfinite(numbers)
    return mean_over_images(numbers[known], frame.to_numpy()[known])
