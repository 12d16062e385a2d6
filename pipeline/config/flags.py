"""Settings as the command-line flags of a stage: the inverse of what tyro reads."""

from __future__ import annotations

from pydantic import BaseModel


def flags(settings: BaseModel) -> list[str]:
    """All fields as flags, also those at their default, so that a log shows what ran."""
    words: list[str] = []
    for name in type(settings).model_fields:
        value, option = getattr(settings, name), name.replace("_", "-")
        if isinstance(value, BaseModel):
            words += flags(value)
        elif isinstance(value, bool):
            words.append(f"--{option}" if value else f"--no-{option}")
        elif isinstance(value, list | tuple):
            words += [f"--{option}", *map(str, value)]
        elif isinstance(value, dict):
            words += [f"--{option}", *(str(part) for item in value.items() for part in item)]
        elif value == "":
            words.append(f"--{option}=")  # An empty word would not survive a shell's quoting by Snakemake.
        else:
            words += [f"--{option}", str(value)]
    return words
