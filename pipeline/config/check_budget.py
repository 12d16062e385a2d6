"""Settings of check_budget."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class CheckBudget(Settings):
    """Verdict on the estimate of a budget."""

    tolerance: float = Field(
        0.25, ge=0, description="share by which time or error may exceed the estimate and still be kept"
    )
