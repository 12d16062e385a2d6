"""Lights of frames: positions belong to names, whatever the order of the tables."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from pipeline.base.files import write_table
from pipeline.lighting.frame_irradiance import read_stage_lights
from pipeline.lighting.frame_lights import read_frame_lights

PLACES = {"C": (3.0, 0.0, 1.0), "A": (1.0, 5.0, 0.0), "B": (2.0, -1.0, 4.0)}


def test_positions_and_strengths_belong_to_one_light_in_any_order(tmp_path: Path) -> None:
    lights = pd.DataFrame([(name, *place) for name, place in PLACES.items()], columns=["light", "x", "y", "z"])
    lit = [(7, "B", 20.0), (5, "A", 1.0), (7, "C", 30.0), (5, "C", 3.0), (7, "A", 10.0)]
    patterns = pd.DataFrame(lit, columns=["frame", "light", "intensity_r"])
    patterns = patterns.assign(intensity_g=2 * patterns.intensity_r, intensity_b=0.0)
    write_table(tmp_path / "lights.parquet", lights)
    write_table(tmp_path / "patterns.parquet", patterns)
    found = read_frame_lights(tmp_path / "lights.parquet", tmp_path / "patterns.parquet")
    assert set(found) == {5, 7}
    for frame, each in found.items():
        expected = {PLACES[name]: (red, 2 * red, 0.0) for f, name, red in lit if f == frame}
        assert dict(zip(map(tuple, each.positions), map(tuple, each.intensities), strict=True)) == expected
    stage = read_stage_lights(tmp_path / "lights.parquet", tmp_path / "patterns.parquet")
    for frame in found:
        at = stage.at(frame)
        shown = dict(zip(map(tuple, at.places), at.luminances, strict=True))
        gray = {PLACES[name]: (0.2126 + 2 * 0.7152) * red for f, name, red in lit if f == frame}
        assert shown == pytest.approx(dict.fromkeys(PLACES.values(), 0.0) | gray, rel=1e-6)
