"""Flags are what tyro reads back to the same settings."""

from typing import Literal

import pytest
import tyro
from pydantic import Field

from pipeline.config.flags import flags
from pipeline.config.project import SECTIONS
from pipeline.config.settings import Settings


class Inner(Settings):
    depth: int = Field(1)


class Varied(Settings):
    """One field of every kind."""

    is_on: bool = Field(True)
    is_off: bool = Field(False)
    small: float = Field(1e-7)
    negative: float = Field(-2.5)
    mode: Literal["auto", "on", "off"] = Field("on")
    text: str = Field("two words; $HOME 'quoted'")
    empty: str = Field("")
    absent: int | None = Field(None)
    sizes: tuple[int, ...] = Field((1, 2, 3))
    named: dict[str, Literal["x", "negative_x"]] = Field({})
    inner: Inner = Inner(depth=4)


def read_back(model, words):
    def run(*, settings: model = model()) -> model:
        return settings

    return tyro.cli(run, args=words, config=(tyro.conf.OmitArgPrefixes,))


@pytest.mark.parametrize(
    "settings",
    [
        Varied(),
        Varied(
            is_on=False,
            is_off=True,
            small=123456789.123,
            negative=0,
            mode="off",
            empty="x",
            absent=3,
            sizes=(9,),
            named={},
        ),
    ],
)
def test_flags_of_every_kind_read_back(settings):
    assert read_back(Varied, flags(settings)) == settings


def test_every_field_is_said():
    words = " ".join(flags(Varied()))
    assert all(f"-{name.replace('_', '-')}" in words for name in Varied.model_fields if name != "inner")
    assert "--depth 4" in words
    assert "--no-is-off" in words


@pytest.mark.parametrize(("stage", "model"), SECTIONS.items())
def test_default_flags_of_every_stage_read_back(stage, model):
    assert read_back(model, flags(model())) == model()
