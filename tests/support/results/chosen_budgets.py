"""What a budget chooses on curves made by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pipeline.budget.allocation import within_budget
from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curves import read_curves, read_measured
from pipeline.budget.estimate import Estimate
from pipeline.config.project import SubjectSettings
from pipeline.config.sections import merge
from tests.support.results.curve_files import CURVES, write_curves

SAME_SIZE = CaptureSize(4, 10, 1000, 1)
SHADOWED = {"train_avatar": {"shading": "transfer", "shadow": "on"}}
"""An avatar that reads irradiance maps, so that they are traced."""


def choose(
    tmp_path: Path, minutes: float, said: dict[str, Any] | None = None, size: CaptureSize = SAME_SIZE,
    curves: dict = CURVES, subject: str = "someone",
) -> tuple[SubjectSettings, Estimate]:  # fmt: skip
    """The settings that so many minutes buy, and what to expect of them."""
    path = write_curves(tmp_path / "curves", curves)
    settings = SubjectSettings(**merge({"budget_minutes": minutes}, merge(SHADOWED, said or {})))
    read = read_curves(path), read_measured(path.parent / "subjects.yaml")
    return within_budget(subject, settings, said or {}, size, *read)
