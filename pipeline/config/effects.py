"""The effects that a plan decides, and how a decision is asked for."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator

EFFECTS = (
    "shadow", "near_field", "articulation", "specular", "deferred", "learned_transport", "eyes", "lens_distortion",
    "color_correction",
)  # fmt: skip
"""All that a plan decides, in the order of the table in docs/effects.md."""


def word(value: Any) -> Any:
    """Read true and false as the words `on` and `off`.

    YAML reads these so, and the command line hands them on as words.
    """
    return {"true": "on", "false": "off"}.get(str(value).lower(), value)


Mode = Annotated[Literal["auto", "on", "off"], BeforeValidator(word)]
"""Whether an effect is simulated: `on` and `off` are obeyed, `auto` is decided by plan_effects."""
