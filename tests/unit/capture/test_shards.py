"""Shards keep what was put in, row by row, and refuse what is not a shard."""

from __future__ import annotations

import multiprocessing
import operator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from typing import get_args

import numpy as np
import pyarrow as pa
import pytest

from pipeline.base.errors import InputError
from pipeline.base.splits import TEST_FLAGS
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import (
    read_frame_shards,
    read_image_shards,
    write_frame_shard,
    write_image_shard,
    write_image_shards,
)
from pipeline.config.pack_shards import Codec

HALF_ULP_OF_FLOAT16 = 2.0**-11
"""Relative rounding error of float16 (10 stored bits of mantissa)."""


def image_record(frame: int, width: int = 5, height: int = 3) -> ImageRecord:
    rng = np.random.default_rng(frame)
    return ImageRecord(
        camera=f"cam{frame:02d}",
        frame=frame,
        test_camera=frame % 2 == 0,
        test_frame=False,
        test_segment=frame == 3,
        test_pattern=frame == 2,
        fully_lit=frame % 3 == 0,
        x0=7,
        y0=-2,
        width=width,
        height=height,
        image=rng.uniform(-0.1, 2, (height, width, 3)).astype(np.float32),
        mask=(rng.integers(0, 256, (height, width)) / 255).astype(np.float32),
        K=rng.normal(size=(3, 3)),
        R=rng.normal(size=(3, 3)),
        t=rng.normal(size=3),
    )


def frame_record(frame: int, lights: int = 4) -> FrameRecord:
    rng = np.random.default_rng(frame)
    return FrameRecord(
        frame=frame,
        segment="a",
        fully_lit=False,
        vertices=rng.normal(size=(6, 3)).astype(np.float32),
        irradiance=rng.uniform(0, 3, 9).astype(np.float32),
        cosine_visibility=rng.uniform(0, 1, 9).astype(np.float32),
        light_positions=rng.normal(size=(lights, 3)).astype(np.float32),
        light_intensities=rng.uniform(size=(lights, 3)).astype(np.float32),
    )


def assert_same(found: object, expected: object, rounded: str | tuple[str, ...]) -> None:
    for field in fields(expected):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if field.name in rounded:
            np.testing.assert_allclose(a, b, rtol=HALF_ULP_OF_FLOAT16)
        elif isinstance(b, np.ndarray):
            assert a.dtype == b.dtype
            assert a.shape == b.shape
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=0)  # one rounding of float32 (the mask's division)
        else:
            assert a == b
            assert type(a) is type(b)


def test_images_round_trip_over_several_shards(tmp_path):
    records = [image_record(i, width=4 + i) for i in range(5)]
    assert write_image_shard(tmp_path / "0000.arrow", records[:3]) == 3
    assert write_image_shard(tmp_path / "0001.arrow", iter(records[3:])) == 2
    (tmp_path / ".b26333b1.0000.arrow").write_text("half of a shard, of a killed stage")
    for paths in ([tmp_path], [tmp_path / "0000.arrow", tmp_path / "0001.arrow"]):
        images = read_image_shards(paths)
        assert len(images) == 5
        for index in (4, 0, 3, 2, 1):
            assert_same(images[index], records[index], "image")
    assert images[-1].frame == 4
    assert [r.frame for r in images[1:4]] == [1, 2, 3]
    assert [r.frame for r in images] == [0, 1, 2, 3, 4]
    assert images.table["frame"].tolist() == [0, 1, 2, 3, 4]
    assert "image" not in images.table
    with pytest.raises(IndexError):
        images[5]


def test_several_shards_are_written_in_one_pass_over_the_records(tmp_path):
    """A video's frames have to be decoded in their order, whatever their splits."""
    untested = dict.fromkeys(TEST_FLAGS, False)
    records = [
        replace(image_record(i), **untested | {"validation": i in (1, 3), "test_frame": i > 2}) for i in range(5)
    ]
    paths = {split: tmp_path / f"{split}.arrow" for split in ("train", "validation", "test", "none")}
    written = write_image_shards(paths, ((record.split, record) for record in iter(records)))
    assert written == {"train": 2, "validation": 1, "test": 2, "none": 0}
    for split, frames in {"train": [0, 2], "validation": [1], "test": [3, 4], "none": []}.items():
        images = read_image_shards([paths[split]])
        assert [image.frame for image in images] == frames
        for image in images:
            assert_same(image, records[image.frame], "image")


def test_frames_round_trip(tmp_path):
    records = [frame_record(8), frame_record(3, lights=0)]
    write_frame_shard(tmp_path / "0000.arrow", records)
    frames = read_frame_shards([tmp_path])
    assert list(frames) == [8, 3]
    assert 3 in frames
    assert 4 not in frames
    for record in records:
        assert_same(frames[record.frame], record, ("irradiance", "cosine_visibility"))
    with pytest.raises(KeyError):
        frames[4]


def test_a_head_keeps_what_only_heads_have(tmp_path):
    rng = np.random.default_rng(1)
    motion, gaze = rng.normal(size=(3, 4)).astype(np.float32), rng.normal(size=(2, 3)).astype(np.float32)
    texture = rng.uniform(size=(9, 3)).astype(np.float32)
    head = replace(frame_record(8), head_from_world=motion, gaze=gaze, texture=texture)
    write_frame_shard(tmp_path / "0000.arrow", [head, frame_record(3)])
    frames = read_frame_shards([tmp_path])
    assert_same(frames[8], head, ("irradiance", "cosine_visibility", "texture"))
    assert (frames[3].head_from_world, frames[3].gaze, frames[3].texture) == (None, None, None)


def test_records_can_be_changed_and_readers_sent_to_another_process(tmp_path):
    write_image_shard(tmp_path / "a.arrow", [image_record(1)])
    write_frame_shard(tmp_path / "b.arrow", [frame_record(1)])
    images, frames = read_image_shards([tmp_path / "a.arrow"]), read_frame_shards([tmp_path / "b.arrow"])
    # A process that shares nothing: it is sent the reader, and sends back what it read.
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        there = [pool.submit(operator.getitem, rows, key) for rows, key in ((images, 0), (frames, 1))]
        assert_same(there[0].result(), images[0], ())
        assert_same(there[1].result(), frames[1], ())
    images[0].image[:] = 0
    frames[1].vertices[:] = 0
    assert images[0].image.any()
    assert frames[1].vertices.any()


def test_values_outside_the_stored_range_are_clamped_not_wrapped(tmp_path):
    record = image_record(1)
    image = np.full_like(record.image, 1e6)
    write_image_shard(
        tmp_path / "a.arrow",
        [replace(record, image=image, mask=np.full_like(record.mask, 1.5))],
    )
    found = read_image_shards([tmp_path / "a.arrow"])[0]
    assert np.isfinite(found.image).all()
    assert found.image.max() == 65504
    assert (found.mask == 1).all()


def test_an_empty_shard_is_a_shard(tmp_path):
    write_image_shard(tmp_path / "a.arrow", [])
    assert len(read_image_shards([tmp_path / "a.arrow"])) == 0


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="none"):
        read_image_shards([tmp_path])
    (tmp_path / "a.arrow").write_text("no")
    with pytest.raises(InputError, match="Arrow IPC"):
        read_image_shards([tmp_path / "a.arrow"])
    write_frame_shard(tmp_path / "b.arrow", [frame_record(1), frame_record(1)])
    with pytest.raises(InputError, match="columns"):
        read_image_shards([tmp_path / "b.arrow"])
    with pytest.raises(InputError, match="frame 1"):
        read_frame_shards([tmp_path / "b.arrow"])


def test_rows_are_read_without_copying_the_file(tmp_path):
    write_image_shard(tmp_path / "a.arrow", [image_record(i, 64, 64) for i in range(4)])
    before = pa.total_allocated_bytes()
    batch = read_image_shards([tmp_path / "a.arrow"])._rows.batch(2)
    assert batch.num_rows == 1
    assert pa.total_allocated_bytes() - before < 64 * 64 * 3 * 2  # less than one image: the pixels stay in the map


@pytest.mark.parametrize("codec", get_args(Codec))
def test_every_codec_keeps_what_was_put_in(tmp_path, codec):
    """float32 to the bit, the others as float16 rounds, however they are compressed."""
    records = [image_record(i, width=4 + i) for i in range(3)]
    write_image_shard(tmp_path / "0000.arrow", records, codec)
    for found, expected in zip(read_image_shards([tmp_path]), records, strict=True):
        assert_same(found, expected, () if codec == "float32" else "image")


def test_compression_makes_even_images_small_and_the_default_is_none(tmp_path):
    even = [replace(image_record(1, 64, 64), image=np.full((64, 64, 3), 0.5, np.float32))]
    sizes = {}
    for codec in get_args(Codec):
        write_image_shard(tmp_path / codec, even, codec)
        sizes[codec] = (tmp_path / codec).stat().st_size
    assert sizes["float16_zstd"] < 0.5 * sizes["float16"] and sizes["float16_lz4"] < 0.5 * sizes["float16"]
    assert sizes["float32"] - sizes["float16"] == 64 * 64 * 3 * 2
    write_image_shard(tmp_path / "default", even)
    assert (tmp_path / "default").read_bytes() == (tmp_path / "float16").read_bytes()
