"""Tables of what calibrate_color found: a row per patch, and a row per camera."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from pipeline.calibration.color.color_response import Response
from pipeline.calibration.color.sensor_linearity import Linearity

RESIDUAL_COLUMNS = ["camera", "patch", "r", "g", "b", "residual_r", "residual_g", "residual_b", "weight", "used"]
QUALITY_COLUMNS = ["camera", "patches", "residual", "sigma", "linear_up_to", "black_level"]
CORNER_COLUMNS = [f"{axis}{corner}" for corner in range(4) for axis in "xy"]


def residual_table(responses: Mapping[str, Response]) -> pd.DataFrame:
    """One row per camera and patch (from 1, as in the chart's csv).

    Columns: camera, patch; r, g, b: raw linear colour, NaN where unused; residual_r, ...: raw minus fitted; weight;
    used; x0, y0, ... x3, y3: corners of the square in the middle of the patch, image pixels.
    """
    parts = [pd.DataFrame(columns=RESIDUAL_COLUMNS + CORNER_COLUMNS)] if not responses else []
    for name, response in responses.items():
        patches = response.patches
        columns = [*patches.color.T, *response.residual.T, response.weight, patches.used]
        columns += [*patches.corners.reshape(-1, 8).T]
        part = pd.DataFrame(dict(zip(RESIDUAL_COLUMNS[2:] + CORNER_COLUMNS, columns, strict=True)))
        part = part.assign(camera=name, patch=np.arange(1, len(patches.used) + 1))
        parts.append(part[RESIDUAL_COLUMNS + CORNER_COLUMNS])
    return pd.concat(parts, ignore_index=True)


def quality_table(responses: Mapping[str, Response], sensors: Mapping[str, Linearity]) -> pd.DataFrame:
    """One row per camera, in the columns `QUALITY_COLUMNS`.

    NaN where there is no series of exposures.
    """
    rows = [
        (name, int(r.patches.used.sum()), float(np.nanmedian(r.relative_residual())), r.relative_sigma(),
         sensors[name].up_to if name in sensors else np.nan, sensors[name].black_level if name in sensors else np.nan)
        for name, r in responses.items()
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=QUALITY_COLUMNS)
