"""Settings of budget_errors."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings

RETRAINED_STAGES = ("pack_shards", "train_avatar", "evaluate_avatar")
"""Stages that are run for each step, in order."""

Part = Literal["color", "lights", "cameras", "tracking"]


class BudgetErrors(Settings):
    """Steps from the truth to what was found."""

    parts: tuple[Part, ...] = Field(
        ("color", "lights", "cameras", "tracking"),
        min_length=1,
        description="inputs that are true at first, and then ours, one after the other in this order",
    )
