"""What all settings models share."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Immutable; an unknown key is an error, never ignored."""

    model_config = ConfigDict(extra="forbid", frozen=True)
