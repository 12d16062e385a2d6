"""The stage on a ball over a floor, whose shadows can be written down."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from pydantic import ValidationError

from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import read_arrays, write_arrays, write_table
from pipeline.base.whole_files import WRITTEN_BY
from pipeline.capture.images import read_exr_channel
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.texels import read_atlas
from pipeline.stages.trace_irradiance import run
from tests.support.captures.posed import BALL_HEIGHT, BALL_RADIUS, FLOOR_HALF, write_posed_capture


def test_maps_and_table(tmp_path: Path) -> None:
    paths = write_posed_capture(tmp_path)
    run(**paths, out=tmp_path / "irradiance/0000")
    found = sorted(p.name for p in (tmp_path / "irradiance/0000").iterdir())
    assert found == [WRITTEN_BY, *(f"{f:06d}.exr" for f in (10, 11, 12))]
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


def test_what_was_saved_adds_up(tmp_path: Path) -> None:
    """Pixels of the map times lights of the stage = rays + everything that needed none."""
    paths = write_posed_capture(tmp_path)
    atlas = read_atlas(paths["atlas"])
    for out, settings in (("full", TraceIrradiance()), ("drawn", TraceIrradiance(samples="1"))):
        run(**paths, out=tmp_path / out, settings=settings)
        table = pd.read_parquet(tmp_path / f"{out}.parquet").set_index("frame")
        np.testing.assert_array_equal(table.rays + table.filter(like="saved_").sum(axis=1), 64 * 64 * 3)
        assert (table.saved_outside_charts == (64 * 64 - atlas.texel_count) * 3).all()
        assert table.saved_unlit.tolist() == [atlas.texel_count * off for off in (1, 2, 3)]
    assert table.saved_drawn_or_known.loc[10] == atlas.texel_count
    # The light under the floor is below the horizon of all its texels.
    write_table(paths["patterns"], pd.read_parquet(paths["patterns"]).assign(light="L2"))
    run(**paths, out=tmp_path / "below")
    assert pd.read_parquet(tmp_path / "below.parquet").set_index("frame").saved_below_horizon.loc[11] >= 32 * 64


def test_as_many_draws_as_lights_are_all_lights(tmp_path: Path) -> None:
    """Two lights are on: two draws are both of them, to the bit, and one is not."""
    paths = write_posed_capture(tmp_path)

    def map_of(samples: str) -> np.ndarray:
        run(**paths, out=tmp_path / samples, settings=TraceIrradiance(samples=samples))
        return read_exr_channel(tmp_path / samples / "000010.exr", "Y")

    np.testing.assert_array_equal(map_of("2"), map_of("full"))
    assert np.abs(map_of("1") - map_of("full")).max() > 0.01


def test_standard_error_is_written_beside_the_map(tmp_path: Path) -> None:
    paths = write_posed_capture(tmp_path)

    def error_of(samples: str) -> np.ndarray:
        settings = TraceIrradiance(samples=samples, sampling="uniform", share_rays=False)
        run(**paths, out=tmp_path / samples, settings=settings)
        return read_exr_channel(tmp_path / samples / "000010.exr", "error")

    assert not error_of("full").any()
    one = error_of("1")
    # Two lights and three strata: the middle one alone is left to chance, with a third of the weight.
    assert error_of("3").mean() == pytest.approx(one.mean() / 3, rel=0.2)
    truth = read_exr_channel(tmp_path / "full/000010.exr")
    off = np.sqrt(np.mean((read_exr_channel(tmp_path / "1/000010.exr") - truth) ** 2))
    assert np.sqrt(np.mean(one**2)) == pytest.approx(off, rel=0.3)


def test_kept_visibility_makes_other_patterns_free(tmp_path: Path) -> None:
    paths, kept = write_posed_capture(tmp_path), {"cache": tmp_path / "visibility"}
    run(**paths, **kept, out=tmp_path / "first", settings=TraceIrradiance(relightings=100))
    assert len(list((tmp_path / "visibility").iterdir())) == 2  # of the two frames that are lit
    patterns = pd.read_parquet(paths["patterns"])
    write_table(paths["patterns"], patterns.assign(light="L1", intensity_g=3.0))
    run(**paths, **kept, out=tmp_path / "known")
    run(**paths, out=tmp_path / "traced")
    assert pd.read_parquet(tmp_path / "known.parquet").rays.sum() == 0
    assert pd.read_parquet(tmp_path / "traced.parquet").rays.sum() > 0
    for frame in (10, 11, 12):
        for channel in ("Y", "falling"):
            maps = [read_exr_channel(tmp_path / out / f"{frame:06d}.exr", channel) for out in ("known", "traced")]
            np.testing.assert_array_equal(*maps)
    # Nothing is kept where one pattern is all that a pose is asked for.
    run(**paths, cache=tmp_path / "none", out=tmp_path / "once")
    assert not (tmp_path / "none").exists()


def test_environment_lights_every_frame(tmp_path: Path) -> None:
    """Under a sky of one brightness the open floor sees half of all directions; frame 12, unlit otherwise, too."""
    paths = write_posed_capture(tmp_path, ball=False)
    write_exr(tmp_path / "sky.exr", dict.fromkeys("RGB", np.full((32, 64), 2, np.float32)))
    run(**paths, out=tmp_path / "out", environment=tmp_path / "sky.exr")
    table = pd.read_parquet(tmp_path / "out.parquet")
    assert not table.unlit.any()
    np.testing.assert_allclose(table["mean"], 0.5, atol=1e-3)
    falling = read_exr_channel(tmp_path / "out/000012.exr", "falling")
    np.testing.assert_allclose(falling[:, :32], 1, atol=1e-3)
    with pytest.raises(InputError, match="no such file"):
        run(**paths, out=tmp_path / "other", environment=tmp_path / "missing.exr")


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


def test_results_of_others_are_not_replaced(tmp_path: Path) -> None:
    """`--out results/tiny` once left the maps alone of all that was there."""
    paths = write_posed_capture(tmp_path)
    (tmp_path / "results/tracking").mkdir(parents=True)
    (tmp_path / "results/tracking/0000.parquet").touch()
    with pytest.raises(InputError, match="expected no folder, an empty one, or one that trace_irradiance wrote"):
        run(**paths, out=tmp_path / "results")
    assert (tmp_path / "results/tracking/0000.parquet").exists()
