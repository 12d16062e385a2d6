"""Settings of the comparison of several subjects."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class CompareSubjects(Settings):
    """Subjects that stand in one table, and what their avatars are compared with."""

    subjects: tuple[str, ...] = Field((), description="subjects to compare, by name; none: all that there are")
    baseline: str = Field(
        "", description="variant that the others are compared with; every subject has it. Empty: the first one"
    )
