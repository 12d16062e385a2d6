"""Shards: what training and evaluation read. Arrow IPC files, one record batch per row, read by memory map.

An image shard has one row per image crop, a frame shard one row per frame. A row is found without reading its
neighbours, so many processes can share one file through the page cache.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from jaxtyping import Float32

from pipeline.base.errors import InputError
from pipeline.base.splits import TEST_FLAGS, VALIDATION
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shard_rows import ShardRows, rows_written, write_rows
from pipeline.config.pack_shards import Codec

IMAGE_SCHEMA = pa.schema(
    [("camera", pa.string()), ("frame", pa.int64())]
    + [(flag, pa.bool_()) for flag in (*TEST_FLAGS, VALIDATION, "fully_lit")]
    + [(edge, pa.int32()) for edge in ("x0", "y0", "width", "height")]
    + [("image", pa.binary()), ("mask", pa.binary())]
    + [
        ("K", pa.list_(pa.float64(), 9)),
        ("R", pa.list_(pa.float64(), 9)),
        ("t", pa.list_(pa.float64(), 3)),
    ]
)
"""image: float16 or float32 little-endian [height, width, 3], see `PIXELS`; mask: uint8 [height, width]; K, R
row-major."""

FRAME_ARRAYS = {
    "vertices": ("<f4", (-1, 3)), "irradiance": ("<f2", (-1,)), "falling": ("<f2", (-1,)),
    "light_positions": ("<f4", (-1, 3)), "light_intensities": ("<f4", (-1, 3)),
    "head_from_world": ("<f4", (3, 4)), "gaze": ("<f4", (-1, 3)), "texture": ("<f2", (-1, 3)),
}  # fmt: skip
"""How the arrays of a frame are stored, little-endian, and their shapes. What a frame lacks (None) is null."""

BYTES_OF_PLACE = 12
"""Of one row of `light_positions`."""

FIELDS = {"falling": "cosine_visibility"}
"""Field of a frame's record by column, where their names differ."""

FRAME_SCHEMA = pa.schema(
    [("frame", pa.int64()), ("segment", pa.string()), ("fully_lit", pa.bool_())]
    + [(name, pa.binary()) for name in FRAME_ARRAYS]
)

PIXELS = {2: "<f2", 4: "<f4"}
"""How a channel is stored, by its bytes: a crop's size in bytes over its size in values says which."""

COMPRESSION = {"float32": None, "float16": None, "float16_lz4": "lz4", "float16_zstd": "zstd"}
"""Of Arrow's buffers, for each codec; readers see to it by themselves."""

FLOAT16_MAX = 65504.0
"""Largest finite float16: brighter pixels (a light in view) are stored as this, not as infinity."""

MASK_LEVELS = 255
"""A mask is stored as 0..255 for 0..1: steps of 0.4 %, the precision of the masks that captures carry."""


def write_image_shard(path: Path, records: Iterable[ImageRecord], codec: Codec = "float16") -> int:
    """Write one image shard, a record at a time; returns the number of images."""
    return write_image_shards({"": path}, (("", record) for record in records), codec)[""]


def write_image_shards(
    paths: Mapping[str, Path], records: Iterable[tuple[str, ImageRecord]], codec: Codec = "float16"
) -> dict[str, int]:
    """Write several image shards in one pass over their records.

    Args:
        paths: of the shards, by name.
        records: each with the name of its shard.
        codec: of the pixels.

    Returns:
        The number of images by the shard's name.
    """
    pixels, count = "<f4" if codec == "float32" else "<f2", dict.fromkeys(paths, 0)
    with ExitStack() as opened:
        write = {
            name: opened.enter_context(rows_written(path, IMAGE_SCHEMA, COMPRESSION[codec]))
            for name, path in paths.items()
        }
        for name, record in records:
            write[name](_image_row(record, pixels))
            count[name] += 1
    return count


def write_frame_shard(path: Path, records: Iterable[FrameRecord]) -> int:
    """Write one frame shard, a record at a time; returns the number of frames."""
    return write_rows(path, FRAME_SCHEMA, (_frame_row(record) for record in records))


def read_image_shards(paths: Iterable[Path]) -> ImageShards:
    """Images of some shards, files or folders of `*.arrow`, as one sequence by sorted path."""
    return ImageShards(tuple(paths))


def read_frame_shards(paths: Iterable[Path]) -> FrameShards:
    """Records of some shards, files or folders of `*.arrow`, by frame number."""
    return FrameShards(tuple(paths))


class ImageShards(Sequence[ImageRecord]):
    """A sequence of image records; each access reads one row and returns arrays of its own.

    Attributes:
        table: every column but `image` and `mask`, to select images without reading their pixels.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._rows = ShardRows(paths, IMAGE_SCHEMA)
        light = [name for name in IMAGE_SCHEMA.names if name not in ("image", "mask")]
        self.table = self._rows.columns(light).to_pandas()
        self._rows.forget()

    def __reduce__(self) -> tuple:
        return ImageShards, (self._rows.paths,)

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, index: int) -> ImageRecord: ...
    @overload
    def __getitem__(self, index: slice) -> list[ImageRecord]: ...
    def __getitem__(self, index: int | slice) -> ImageRecord | list[ImageRecord]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        record = _image_record(self._rows.batch(index % len(self)))
        self._rows.forget()
        return record


class FrameShards(Mapping[int, FrameRecord]):
    """Frame records by frame number; each access reads one row and returns arrays of its own.

    Attributes:
        table: frame, segment, fully_lit, lights (number of lit lights) and is_head (its motion is known), to
            select frames without reading what they hold.
    """

    def __init__(self, paths: Iterable[Path]) -> None:
        self._rows = ShardRows(paths, FRAME_SCHEMA)
        known = self._rows.columns(["frame", "segment", "fully_lit", "light_positions", "head_from_world"])
        lights = pc.divide(pc.binary_length(known["light_positions"]), BYTES_OF_PLACE)
        counted = {"lights": lights.to_numpy(), "is_head": known["head_from_world"].is_valid().to_numpy()}
        self.table = known.select(["frame", "segment", "fully_lit"]).to_pandas().assign(**counted)
        self._rows.forget()
        if len(twice := self.table.frame[self.table.frame.duplicated()]):
            raise InputError(f"frame {twice.iloc[0]}: expected in one frame shard, found in two of {self._rows.paths}")
        self._index = {frame: row for row, frame in enumerate(self.table.frame.tolist())}

    def lights(self) -> dict[int, Float32[np.ndarray, "lit 6"]]:
        """Places, metres, and intensities of the lights of every frame; nothing else is read."""
        names = ("light_positions", "light_intensities")
        stored = self._rows.columns(["frame", *names]).to_pydict()
        self._rows.forget()
        arrays = zip(
            *([np.frombuffer(row, "<f4").reshape(-1, 3) for row in stored[name]] for name in names), strict=True
        )
        return {frame: np.concatenate(both, 1) for frame, both in zip(stored["frame"], arrays, strict=True)}

    def __reduce__(self) -> tuple:
        return FrameShards, (self._rows.paths,)

    def __len__(self) -> int:
        return len(self._index)

    def __iter__(self) -> Iterator[int]:
        return iter(self._index)

    def __getitem__(self, frame: int) -> FrameRecord:
        record = _frame_record(self._rows.batch(self._index[frame]))
        self._rows.forget()
        return record


def _image_row(record: ImageRecord, pixels: str) -> dict:
    row = {name: getattr(record, name) for name in IMAGE_SCHEMA.names}
    row["image"] = np.clip(record.image, -FLOAT16_MAX, FLOAT16_MAX).astype(pixels).tobytes()
    row["mask"] = np.round(np.clip(record.mask, 0, 1) * MASK_LEVELS).astype(np.uint8).tobytes()
    for name in ("K", "R", "t"):
        row[name] = np.asarray(row[name]).ravel().tolist()
    return row


def _image_record(batch: pa.RecordBatch) -> ImageRecord:
    row = {name: batch.column(name)[0] for name in IMAGE_SCHEMA.names}
    height, width = row["height"].as_py(), row["width"].as_py()
    stored = row.pop("image").as_buffer()
    image = np.frombuffer(stored, PIXELS[stored.size // (3 * height * width)]).astype(np.float32)
    image = image.reshape(height, width, 3)
    mask = np.frombuffer(row.pop("mask").as_buffer(), np.uint8).reshape(height, width) / np.float32(MASK_LEVELS)
    plain = {name: value.as_py() for name, value in row.items()}
    for name, shape in (("K", (3, 3)), ("R", (3, 3)), ("t", (3,))):
        plain[name] = np.array(plain[name], dtype=np.float64).reshape(shape)
    return ImageRecord(image=image, mask=mask.astype(np.float32), **plain)


def _frame_row(record: FrameRecord) -> dict:
    row = {name: getattr(record, FIELDS.get(name, name)) for name in FRAME_SCHEMA.names}
    for name, (stored, _) in FRAME_ARRAYS.items():
        if row[name] is not None:
            values = np.asarray(row[name])
            half = np.clip(values, 0, FLOAT16_MAX) if stored == "<f2" else values
            row[name] = half.astype(stored).tobytes()
    return row


def _frame_record(batch: pa.RecordBatch) -> FrameRecord:
    row = {name: batch.column(name)[0] for name in FRAME_SCHEMA.names}
    arrays = {}
    for name, (stored, shape) in FRAME_ARRAYS.items():
        value = row.pop(name)
        if value.is_valid:
            values = np.frombuffer(value.as_buffer(), stored).reshape(shape).astype(np.float32)
            arrays[FIELDS.get(name, name)] = values
    return FrameRecord(**{name: value.as_py() for name, value in row.items()}, **arrays)
