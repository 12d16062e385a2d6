"""What a table of `benchmarks.driven_glints` comes to."""

from __future__ import annotations

import numpy as np
import pandas as pd

from benchmarks.true_eyes import CUT, MEASURED, NOT_SEEN

WITHIN_PX = 1.0
"""How far a glint may be off: what is asked of gaze in, gaze out."""


def summarize(table: pd.DataFrame) -> pd.DataFrame:
    """A row for all glints that nothing cuts, one per sphere and one per segment; one for those that are cut: how many,
    and distances in pixels. Glints of a cornea turn with the gaze, those of an eyeball stay where they are.

    The first row says how many are left out, and why.
    """
    measured, cut = table[table.status == MEASURED], table[table.status.isin(CUT)]
    groups = {"all": measured} | dict(iter(measured.groupby("sphere")))
    groups |= {f"segment {name}": rows for name, rows in measured.groupby("segment")} | {"cut (not in all)": cut}
    left_out = {status: int((table.status == status).sum()) for status in (*CUT, *NOT_SEEN)}
    rows = [
        {"glints_of": name, **numbers_of(rows), **(left_out if name == "all" else {})} for name, rows in groups.items()
    ]
    return pd.DataFrame(rows)


def numbers_of(glints: pd.DataFrame) -> dict[str, float]:
    """Numbers of one group of glints that are seen; what turning does, of those on corneas."""
    if glints.empty:
        return {"glints": 0}
    error, turning = glints.error_px, glints[glints.sphere == "cornea"]
    numbers = {
        "glints": len(glints), "median_px": error.median(), "p95_px": error.quantile(0.95), "largest_px": error.max(),
        "within_1_px": (error <= WITHIN_PX).mean(),
    }  # fmt: skip
    if turning.empty:
        return numbers
    still = turning.still_px.dropna()
    turned = {"still_median_px": still.median(), "still_within_1_px": (still <= WITHIN_PX).mean()}
    return {**numbers, "follows": slope_of(turning), **turned}


def slope_of(measured: pd.DataFrame) -> float:
    """Least squares of found against expected places, each about its mean over the gazes of a frame, light, camera and
    eye."""
    shown = measured[np.isfinite(measured.error_px)]
    columns = ["expected_x", "expected_y", "found_x", "found_y"]
    places = shown[columns] - shown.groupby(["frame", "light", "camera", "eye"])[columns].transform("mean")
    expected, found = places[columns[:2]].to_numpy(), places[columns[2:]].to_numpy()
    return float((expected * found).sum() / (expected**2).sum())
