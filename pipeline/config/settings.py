"""Base class of all settings models."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Immutable; an unknown key is an error, never ignored. A number where text is due is its text (`samples: 4`)."""

    model_config = ConfigDict(extra="forbid", frozen=True, coerce_numbers_to_str=True)
