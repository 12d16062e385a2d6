"""Table of several subjects' avatars: mean scores and differences from a baseline.

A test says which differences are more than chance.

Only images that both avatars were scored on count, image by image: what makes an image hard is the same for both and
cancels. `pipeline.metrics.significance` says what is tested.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.metrics.evaluation import LIT, PSNR_CEILING_DB, SPLITS
from pipeline.metrics.image_metrics import metrics_in
from pipeline.metrics.significance import (
    NOTHING,
    Estimate,
    holm,
    mean_over_images,
    over_new_subjects,
    over_these_subjects,
)

ALL = "all"
"""In place of a subject's name: the mean over all subjects that have the variant."""

IMAGE = ["subject", "camera", "frame"]

COLUMNS = [
    "subject", "variant", "baseline", "lit", "metric", "subjects", "images", "mean", "mean_error", "difference",
    "difference_error", "degrees", "p_value", "p_holm", "new_mean_error", "new_difference_error", "new_p_value",
    "new_p_holm",
]  # fmt: skip
"""See `compare`."""


def compare(scores: pd.DataFrame, baseline: str) -> pd.DataFrame:
    """Compare variants with a baseline, over all test images.

    One row per subject (and `ALL`, if there are several), variant, lighting and metric.

    mean is over images, `ALL`'s over subjects' means. difference is variant minus baseline, NaN for the baseline.
    *_error are standard errors for new frames of the same subjects, new_*_error for new subjects (`ALL` only); so with
    p_value and new_p_value. *_holm are corrected for all tests of the same column on the rows of the same subject, that
    is for all ablations, lightings and metrics of the table.

    Args:
        scores: metrics_per_image of all subjects, one below the other.
        baseline: the variant that the others are compared with.

    Raises:
        InputError: if a subject has no such variant, or a variant was not scored on the images of the baseline.
    """
    scores = scores[SPLITS["test"](scores)]
    scores = scores.assign(psnr_db=scores.psnr_db.clip(upper=PSNR_CEILING_DB))
    subjects = list(dict.fromkeys(scores.subject))
    rows, metrics = [], [metric.name for metric in metrics_in(scores)]
    for variant in dict.fromkeys(scores.variant):
        pairs = {name: _pair(scores, name, variant, baseline) for name in subjects}
        rows += _rows({name: pair for name, pair in pairs.items() if pair is not None}, variant, baseline, metrics)
    table = pd.DataFrame(rows, columns=COLUMNS)
    for _, group in table.groupby("subject"):
        for tested, corrected in (("p_value", "p_holm"), ("new_p_value", "new_p_holm")):
            table.loc[group.index, corrected] = holm(group[tested].to_numpy(np.float64))
    order = {name: position for position, name in enumerate([ALL, *subjects])}
    return table.sort_values("subject", key=lambda column: column.map(order), kind="stable", ignore_index=True)


def _pair(scores: pd.DataFrame, subject: str, variant: str, baseline: str) -> pd.DataFrame | None:
    """The subject's images with the scores of both, the baseline's as METRIC_base; None if it has no such variant."""
    own = scores[scores.subject == subject]
    mine, base = own[own.variant == variant], own[own.variant == baseline]
    if base.empty:
        raise InputError(
            f"subject {subject}: expected a variant {baseline!r} to compare with, found "
            f"{', '.join(own.variant.unique())}; name one that all subjects have, or leave out this subject"
        )
    if mine.empty:
        return None
    both = mine.merge(base, on=IMAGE, suffixes=("", "_base"), validate="one_to_one")
    if not len(both) == len(mine) == len(base):
        raise InputError(
            f"subject {subject}: expected {variant} and {baseline} scored on the same images, found {len(mine)} and "
            f"{len(base)} images, {len(both)} of them the same; evaluate both anew"
        )
    return both


def _rows(
    pairs: Mapping[str, pd.DataFrame], variant: str, baseline: str, metrics: Sequence[str]
) -> list[dict]:  # fmt: skip
    rows = []
    for lit, chosen in LIT.items():
        under = {subject: pair[chosen(pair)] for subject, pair in pairs.items()}
        for metric in metrics:
            names = {"variant": variant, "baseline": baseline, "lit": lit, "metric": metric}
            means, differences, counts = [], [], []
            for subject, pair in under.items():
                mean, difference, images = _estimates(pair, metric, variant != baseline)
                own = names | {"subject": subject, "subjects": 1, "images": images}
                rows.append(own | _numbers(mean, difference))
                if images:
                    means, differences, counts = [*means, mean], [*differences, difference], [*counts, images]
            if len(pairs) > 1:
                over = names | {"subject": ALL, "subjects": len(means), "images": sum(counts)}
                rows.append(over | (_joint_numbers(means, differences) if means else _numbers(NOTHING, NOTHING)))
    return rows


def _estimates(pair: pd.DataFrame, metric: str, differs: bool) -> tuple[Estimate, Estimate, int]:
    """Of the metric, of its difference from the baseline's, and the number of images that have both."""
    mine, base = (pair[name].to_numpy(np.float64) for name in (metric, f"{metric}_base"))
    known = np.isfinite(mine) & np.isfinite(base)
    mine, base, frame = mine[known], base[known], pair.frame.to_numpy()[known]
    difference = mean_over_images(mine - base, frame) if differs else NOTHING
    return mean_over_images(mine, frame), difference, len(frame)


def _numbers(mean: Estimate, difference: Estimate) -> dict[str, float]:
    return {
        "mean": mean.mean, "mean_error": mean.error, "difference": difference.mean,
        "difference_error": difference.error, "degrees": difference.degrees, "p_value": difference.p_value,
    }  # fmt: skip


def _joint_numbers(means: list[Estimate], differences: list[Estimate]) -> dict[str, float]:
    new = over_new_subjects(differences)
    return _numbers(over_these_subjects(means), over_these_subjects(differences)) | {
        "new_mean_error": over_new_subjects(means).error, "new_difference_error": new.error, "new_p_value": new.p_value,
    }  # fmt: skip
