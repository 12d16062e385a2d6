"""The stage on a ball over a floor, whose shadows can be written down."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_arrays, write_table
from pipeline.capture.images import read_exr_channel
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.texels import read_atlas
from pipeline.trace_irradiance import run
from tests.stages.posed_capture import BALL_HEIGHT, BALL_RADIUS, FLOOR_HALF, write_posed_capture


def test_maps_and_table(tmp_path: Path) -> None:
    paths = write_posed_capture(tmp_path)
    run(**paths, out=tmp_path / "irradiance/0000")
    assert sorted(p.name for p in (tmp_path / "irradiance/0000").iterdir()) == [f"{f:06d}.exr" for f in (10, 11, 12)]
    table = pd.read_parquet(tmp_path / "irradiance/0000.parquet").set_index("frame")
    assert table.lights_on.tolist() == [2, 1, 0]
    assert table.unlit.tolist() == [False, False, True]
    assert table.rays.loc[12] == 0
    assert cv2.imread(str(tmp_path / "irradiance/0000.png")) is not None

    atlas = read_atlas(paths["atlas"])
    maps = {frame: read_exr_channel(tmp_path / f"irradiance/0000/{frame:06d}.exr") for frame in (10, 11, 12)}
    outside = atlas.to_map(np.ones(atlas.texel_count)) == 0
    assert all((image[outside] == 0).all() for image in maps.values())
    assert (atlas.from_map(maps[12]) == 1).all()
    assert table["mean"].loc[11] == pytest.approx(atlas.from_map(maps[11]).mean(), abs=1e-3)

    # The floor has the left half of the map: 64 rows over its length, 32 columns over its width.
    x, z = np.meshgrid((np.arange(32) + 0.5) / 32 * 2 * FLOOR_HALF - FLOOR_HALF, (np.arange(64) + 0.5) / 64 * 6 - 3)
    disc = 5 * np.tan(np.arcsin(BALL_RADIUS / (5 - BALL_HEIGHT)))
    radius = np.hypot(x, z)
    clear = np.abs(radius - disc) > 0.03
    np.testing.assert_array_equal(maps[11][:, :32][clear], (radius > disc)[clear])
    # In the disc's middle the second light (I = 2, twice as far squared, or nearly) is all that arrives.
    first, second = 1 / (radius**2 + 25), 2 / ((x - 5) ** 2 + z**2 + 25)
    middle = radius < disc / 2
    np.testing.assert_allclose(maps[10][:, :32][middle], (second / (first + second))[middle], atol=2e-3)


def test_threads_do_not_matter_and_seeds_do(tmp_path: Path) -> None:
    paths, drawn = write_posed_capture(tmp_path), TraceIrradiance(samples="1")
    for out, threads, subject in (("one", 1, "ball"), ("two", 2, "ball"), ("other", 1, "cube")):
        run(**paths, out=tmp_path / out, threads=threads, subject=subject, settings=drawn)
    one, two, other = (read_exr_channel(tmp_path / out / "000010.exr") for out in ("one", "two", "other"))
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()


def test_samples_are_validated() -> None:
    assert TraceIrradiance().samples_or_none is None
    assert TraceIrradiance(samples="16").samples_or_none == 16
    for wrong in ("0", "-1", "1.5", "all", ""):
        with pytest.raises(ValidationError):
            TraceIrradiance(samples=wrong)


def test_complaints_come_before_any_work(tmp_path: Path) -> None:
    paths = write_posed_capture(tmp_path)
    patterns = pd.read_parquet(paths["patterns"])
    for broken, message in [
        (patterns.assign(light=["L0", "L9", "L0"]), "L9"),
        (patterns.assign(intensity_g=[1.0, -1, np.nan]), "2 problems"),
    ]:
        write_table(tmp_path / "broken.parquet", broken)
        with pytest.raises(InputError, match=message):
            run(**{**paths, "patterns": tmp_path / "broken.parquet"}, out=tmp_path / "out")
    arrays = read_arrays(paths["tracking"])
    for broken, message in [
        ({**arrays, "vertices": arrays["vertices"][:, 1:]}, "vertices: expected shape"),
        ({**arrays, "vertices": arrays["vertices"] * np.float32(np.nan)}, "finite"),
        ({**arrays, "frames": arrays["frames"] + 100}, "at least one frame"),
    ]:
        write_arrays(tmp_path / "broken.safetensors", broken)
        with pytest.raises(InputError, match=message):
            run(**{**paths, "tracking": tmp_path / "broken.safetensors"}, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
