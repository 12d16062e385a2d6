"""Base class of all settings models."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel, ConfigDict, field_validator
from pydantic_core import PydanticCustomError


class Settings(BaseModel):
    """Immutable; an unknown key is an error, never ignored. A number where text is due is its text (`samples: 4`).

    Numbers are finite. True is none, as YAML reads `on` and `yes` as that; nor is a number true or false.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, coerce_numbers_to_str=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _refuse_truth_for_numbers_and_back(cls, value: Any, info: Any) -> Any:
        kinds, found = set(_leaves(cls.model_fields[info.field_name].annotation)), {type(i) for i in _items(value)}
        if {int, float} & kinds and bool not in kinds and bool in found:
            raise PydanticCustomError("truth_for_number", "Input should be a number, not true or false")
        if bool in kinds and not {int, float} & kinds and {int, float} & found:
            raise PydanticCustomError("number_for_truth", "Input should be true or false, not a number")
        return value


def _leaves(annotation: Any) -> Iterator[Any]:
    """Types that an annotation is made of: tuple[float, ...] | None is of float."""
    inner = get_args(annotation)
    for part in inner:
        yield from _leaves(part)
    if not inner:
        yield annotation


def _items(value: Any) -> Iterator[Any]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _items(item)
    else:
        yield value
