"""Committed curves of error against time, from which presets and budgets choose settings.

`config/curves/accuracy_cost.csv` has the rows of some subjects' tables of that name for the dials that are to be
chosen, `config/curves/subjects.yaml` what these subjects were like. Written by `pipeline.dials.curves`. Seconds are
those of a processor: on a busy machine they hardly change, and on several cores a run takes less.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from pipeline.base.errors import InputError
from pipeline.budget.curve import Curve
from pipeline.budget.subject_curve import SubjectCurve
from pipeline.config.project import SECTIONS
from pipeline.config.synthesize_capture import Material
from pipeline.config.trained_model import Kind
from pipeline.metrics.cost import IMPORTS_ONLY

FOLDER = Path("config/curves")
COLUMNS = [
    "subject",
    "dial",
    "stage",
    "option",
    "setting",
    "metric",
    "error",
    "standard_error",
    "seconds",
    "allowed",
    "work",
]


@dataclass(frozen=True)
class Measured:
    """A subject that the curves were measured on.

    Attributes:
        subject: its name.
        kind: body or head.
        material: opaque, or translucent where the plan of effects found light from below the surface.
        cameras, frames, pixels, texels: cameras, frames, pixels of an image, and texels of the atlas.
        psnr_db: of its partially lit test images, with its own settings.
        settings: of each dial's option in that run.
    """

    subject: str
    kind: Kind
    cameras: int
    frames: int
    pixels: int
    texels: int
    psnr_db: float
    settings: Mapping[str, Any]
    material: Material = "opaque"


def read_curves(path: Path) -> list[Curve]:
    """The curves of a table of accuracy and cost, in its order; by each dial's first metric.

    Raises:
        InputError: if it is no such table, naming every dial and column that is amiss.
    """
    try:
        table = pd.read_csv(path, dtype={"setting": str})
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: expected the table of the curves, found: {error}; run `make curves`") from error
    if lacking := [name for name in COLUMNS if name not in table]:
        found = ", ".join(table.columns)
        raise InputError(f"{path}: expected the column {lacking[0]}, found {found}; run `make curves`")
    return [_read_curve(path, str(dial), rows) for dial, rows in table.groupby("dial", sort=False)]


def _read_curve(path: Path, dial: str, rows: pd.DataFrame) -> Curve:
    first = rows.iloc[0]
    stage, option = str(first.stage), str(first.option)
    if stage not in SECTIONS or option not in SECTIONS[stage].model_fields:
        raise InputError(f"{path}: {dial}: expected a setting of a stage, found {stage}.{option}; run `make curves`")
    parts = tuple(_read_part(path, dial, str(name), own) for name, own in rows.groupby("subject", sort=False))
    default = SECTIONS[stage]().model_dump(mode="json")[option]
    return Curve(dial, stage, option, default, parts)


def _read_part(path: Path, dial: str, subject: str, rows: pd.DataFrame) -> SubjectCurve:
    metric = str(rows.metric.iloc[0])
    rows = rows[rows.metric == metric]
    known, imports = rows[np.isfinite(rows.error) & (rows.setting != IMPORTS_ONLY)], rows[rows.setting == IMPORTS_ONLY]
    allowed = float(rows.allowed.iloc[0])
    if known.empty or imports.empty or not (known.seconds > 0).all() or not allowed >= 0:
        raise InputError(
            f"{path}: {dial} of {subject}: expected settings with errors and seconds, and {IMPORTS_ONLY}; found none"
        )
    return SubjectCurve(
        subject, metric, tuple(known.setting), tuple(known.error), tuple(known.standard_error), tuple(known.seconds),
        float(imports.seconds.iloc[0]), allowed, tuple(known.work.astype(float)),
    )  # fmt: skip


def read_measured(path: Path) -> list[Measured]:
    """Read the facts of the curves' subjects.

    Raises:
        InputError: if the file does not say what it should.
    """
    try:
        return [Measured(**facts) for facts in yaml.safe_load(path.read_text())]
    except (OSError, TypeError, yaml.YAMLError) as error:
        raise InputError(
            f"{path}: expected facts of the curves' subjects, found: {error}; run `make curves`"
        ) from error
