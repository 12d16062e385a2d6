"""Estimate of a budget: seconds of every stage, and errors by dial."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pipeline.budget.total_loss import is_psnr_loss, total_loss_db


@dataclass(frozen=True)
class Choice:
    """Estimate of one dial: its setting, who said it, and the error to expect.

    It was said by `budget` or `user`.
    """

    dial: str
    stage: str
    option: str
    setting: str
    by: str
    metric: str
    error: float
    allowed: float
    factor: float


@dataclass(frozen=True)
class Estimate:
    """Estimate of a budget: expected seconds, settings and errors.

    Attributes:
        subject, measured_on: whose budget, and whose curves.
        budget_s: seconds of one processor that were given.
        seconds: expected of each stage.
        choices: by dial.
        psnr_db: of the partially lit test images, if it is a subject of the curves; else NaN.
        paces: of each stage, seconds that its jobs take here over those that are expected, as counted with.
    """

    subject: str
    measured_on: str
    budget_s: float
    seconds: Mapping[str, float]
    choices: Sequence[Choice]
    psnr_db: float
    paces: Mapping[str, float]

    @property
    def total(self) -> float:
        """Seconds of all stages."""
        return sum(self.seconds.values())

    @property
    def lost_db(self) -> float:
        """PSNR that all dials lose together against their best settings, dB."""
        return total_loss_db(choice.error for choice in self.choices if is_psnr_loss(choice.metric))

    def as_json(self) -> dict[str, Any]:
        """All of it, as JSON has it: no number that is not one."""
        content = asdict(self) | {"seconds": dict(self.seconds), "paces": dict(self.paces)}
        content["lost_db"] = self.lost_db
        content["psnr_db"] = None if math.isnan(self.psnr_db) else self.psnr_db
        content["choices"] = [
            asdict(choice) | {"error": None if math.isnan(choice.error) else choice.error} for choice in self.choices
        ]
        return content

    def lines(self) -> list[str]:
        """Lines for the log."""
        minutes = f"budget {self.budget_s / 60:.3g} minutes of one processor, expected {self.total / 60:.3g}"
        said = [f"{self.subject}: {minutes}; errors as measured on {self.measured_on}:"]
        for choice in self.choices:
            error = "unknown" if math.isnan(choice.error) else f"{choice.error:.3g} (allowed {choice.allowed:.3g})"
            who = "" if choice.by == "budget" else ", set by you"
            said.append(f"  {choice.stage}.{choice.option} {choice.setting}{who}: {error}; {choice.metric}")
        said.append(f"  together they lose {self.lost_db:.3g} dB of PSNR")
        return said
