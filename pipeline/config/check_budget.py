"""Settings of check_budget."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class CheckBudget(Settings):
    """When a promise of time counts as kept."""

    tolerance: float = Field(
        0.25, ge=0, description="share by which time or error may exceed what was promised and still be kept"
    )
