"""A public set, imported and taken through the stages that its calibration and meshes go into."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.files import read_rows, read_table
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.config.import_capture import ImportCapture
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.geometry.cameras import read_cameras
from pipeline.stages import (
    book_patterns,
    calibrate_cameras,
    calibrate_color,
    calibrate_lights,
    evaluate_avatar,
    import_capture,
    index_capture,
    pack_shards,
    plan_effects,
    track_mesh,
    train_avatar,
    unwrap_atlas,
)
from tests.support.datasets.decodes import Decodes, counted_decodes
from tests.support.datasets.protocols import assert_kept, documented_protocols
from tests.support.datasets.turning_head import TurningHead


def import_set(
    dataset: str, source: Path, folder: Path, settings: ImportCapture = ImportCapture()
) -> tuple[Path, Path]:
    """The folders of the native capture, and of the results of these stages.

    On the way it is checked of every set that it is read in place: the index decodes each image and mask once,
    importing and tracking no mask twice, and the capture gets no pixels.
    """
    capture, results = folder / "captures/someone", folder / "results"
    before = sorted((path, path.stat().st_size) for path in source.rglob("*"))
    with counted_decodes() as looked_at:
        import_capture.run(dataset=dataset, source=source, subject="someone", out=capture, settings=settings)
    with counted_decodes() as decoded:
        index_capture.run(capture=capture, out=results / "index")
    images = pd.read_parquet(results / "index/images.parquet")
    times = Counter(path.removeprefix(f"{capture}/") for _, path in decoded.files)
    assert set(times) == set(images.path) | set(images.mask_path.dropna()), "each image and mask"
    masks = {path.removeprefix("source/") for path in images.mask_path.dropna()}
    proven = Counter(path for _, path in looked_at.files if path.removeprefix(f"{source.resolve()}/") in masks)
    assert max(proven.values(), default=1) == 1, "importing decodes no mask twice"
    assert max(times.values()) == 1, "once, those that tell whether cameras were exchanged, too"
    assert sorted((path, path.stat().st_size) for path in source.rglob("*")) == before, (
        "nothing is written into the set"
    )
    assert images.path.str.startswith("source/").all() and (capture / "source").is_symlink()
    own = {path.suffix for path in capture.rglob("*") if path.is_file() and (capture / "source") not in path.parents}
    assert own <= {".yaml", ".csv", ".parquet", ".json", ".glb", ".ply", ".obj"}, "tables and meshes alone"
    assert_provenance(json.loads((results / "index/capture.json").read_text())["imported"], dataset)
    given = {"capture": capture, "index": results / "index", "out": results / "calibration"}
    calibrate_cameras.run(**given)
    calibrate_color.run(**given)
    calibrate_lights.run(**given, rig=results / "calibration/rig.json")
    cameras = results / "calibration/cameras.json"
    with counted_decodes() as decoded:
        track_mesh.run(capture=capture, index=results / "index", cameras=cameras, chunk=0, out=results / "tracking")
    assert max(Counter(decoded.files).values(), default=1) == 1, "also masks that all frames share"
    return capture, results


def assert_provenance(imported: dict, dataset: str) -> None:
    """What the report shows: where each part comes from, by what the set gave or which stage makes it."""
    assert imported["dataset"] == dataset
    given, computed = imported["given"], imported["computed"]
    assert {"images", "cameras", "splits"} <= set(given) | set(computed)
    for part in ("lights", "mesh", "mask", "texture coordinates"):
        assert any(part in what for what in (*given, *computed)), part
    assert all(isinstance(how, str) and how for how in (*given.values(), *computed.values()))


def packed(capture: Path, results: Path, atlas: int = 32) -> dict:
    """Files of the packed images of what `import_set` made, by the stages that need no traces and no mean textures.

    On the way it is checked of every set that none of them decodes an image or a mask twice, and that packing leaves
    none out.
    """
    given, calibration = {"capture": capture, "index": results / "index"}, results / "calibration"
    cameras, lights = calibration / "cameras.json", calibration / "lights.parquet"
    seen = {"atlas": results / "atlas.safetensors", "cameras": cameras, "color": calibration / "color.json",
            "patterns": results / "patterns.parquet", "lights": lights}  # fmt: skip
    tracking, booked, effects = (
        results / name for name in ("tracking/0000.safetensors", "frames.parquet", "effects.json")
    )
    with counted_decodes(book_patterns, plan_effects, pack_shards) as decoded:
        book_patterns.run(**given, lights=lights, cameras=cameras, out=results)
        unwrap_atlas.run(**given, cameras=cameras, out=results, settings=UnwrapAtlas(size=atlas))
        plan_effects.run(**given, **seen, tracking=(tracking,), booked=booked, out=effects)
        pack_shards.run(**given, **seen, tracking=tracking, frames=booked, effects=effects, out=results / "shards")
    images = read_rows(results / "index/images.parquet", "frame", read_table(booked).frame)
    assert_decoded_once(decoded, images, capture)
    return {"subject": "someone", "atlas": seen["atlas"], "shards": results / "shards", "effects": effects}


def assert_decoded_once(decoded: Decodes, images: pd.DataFrame, capture: Path) -> None:
    """No image or mask is decoded twice by one of the stages, and packing leaves none of the booked `images` out."""
    times = Counter(decoded.files)
    assert max(times.values()) == 1, f"decoded again: {times.most_common(3)}"
    packed = {path.removeprefix(f"{capture}/") for stage, path in times if stage == "pack_shards"}
    assert packed == set(images.path) | set(images.mask_path.dropna())
    assert max(Counter(decoded.video_frames).values(), default=0) <= images.frame.nunique()


def score_as_preset(
    dataset: str, source: Path, folder: Path, sizes: Mapping[str, tuple[int, int]], **taken: Any
) -> pd.DataFrame:
    """Rows with images of the metrics.csv that a set's own protocol leads to, which is as promised.

    Args:
        sizes: width and height of each camera's images, as the protocol has them.
        taken: settings of import_capture beside those of the preset.
    """
    preset = documented_protocols()[dataset].settings
    settings = ImportCapture(**preset.get("import_capture", {}) | taken)
    capture, results = import_set(dataset, source, folder, settings)
    files, avatar = packed(capture, results), results / "avatars/full"
    train_avatar.run(**files, out=avatar, processes=1, settings=TrainAvatar(steps=2))
    scoring = EvaluateAvatar(pictures=False, **preset["evaluate_avatar"])
    evaluate_avatar.run(**files, index=results / "index", avatars=(avatar,), out=results, settings=scoring)
    assert_kept(dataset, results, sizes)
    table = pd.read_csv(results / "metrics.csv")
    return table[table.images > 0]


TRUE_PX, TRUE_M = 1e-6, 1e-6
"""Errors of cameras, and of lights and given meshes, that are rounding: files have seven digits of float32, or more."""


def assert_true_cameras(results: Path, truth: TurningHead, names: Sequence[str], frame: int) -> None:
    """Cameras are those of these names; the true vertices of a frame are where the true cameras have them.

    Those count from the first pixel's centre, as most sets do.
    """
    cameras, vertices = read_cameras(results / "calibration/cameras.json"), truth.vertices(frame)
    assert sorted(cameras) == sorted(names)
    for name, camera in cameras.items():
        np.testing.assert_allclose(
            camera.project(vertices)[0], truth.cameras[name].project(vertices) + 0.5, atol=TRUE_PX
        )


def assert_true_lights(results: Path, truth: TurningHead) -> None:
    """All lights are where the true ones are, in the order of their names."""
    lights = pd.read_parquet(results / "calibration/lights.parquet").sort_values("light")
    np.testing.assert_allclose(lights[["x", "y", "z"]], truth.lights_m, atol=TRUE_M)
