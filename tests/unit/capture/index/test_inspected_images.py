"""Images inspected by several jobs: the index, and what is wrong, are those of one job that inspects them all."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

from pipeline.base.errors import Complaints, InputError
from pipeline.base.verdicts import verdict_table
from pipeline.capture.images import ImageSource
from pipeline.capture.index import image_checks
from pipeline.capture.index.exchanged_images import complain_of_exchanged
from pipeline.capture.index.inspected_images import InspectedImages
from pipeline.stages.index_capture import run
from tests.support.captures.broken import inspected_by_two
from tests.support.captures.builder import build_capture, edit_manifest
from tests.support.datasets.decodes import counted_decodes


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("measured", [False, True])
def test_index_has_the_same_bytes_and_reads_no_image_again(tmp_path, monkeypatch, measured):
    capture = build_capture(tmp_path / "tiny", measured=measured)
    run(capture=capture, out=tmp_path / "one")
    tables = inspected_by_two(capture, tmp_path / "shares")
    inspect, read = image_checks.inspect_image, []
    monkeypatch.setattr(
        image_checks, "inspect_image", lambda root, image: (read.append(image), inspect(root, image))[1]
    )
    with counted_decodes() as decoded:
        run(capture=capture, out=tmp_path / "joined", inspected=tables)
    assert contents(tmp_path / "one") == contents(tmp_path / "joined")
    assert not read and not decoded.files
    found = [pd.read_parquet(table) for table in tables]
    assert [sum(not is_photograph(path) for path in table.path) for table in found] == [2 * 2 * 2, 2 * 2]
    named = re.findall(r'"path": "(calibration/[^"{]+\.(?:png|exr))"', "".join(text_of(tmp_path / "one")))
    photographs = [set(filter(is_photograph, table.path)) for table in found]
    assert set.union(*photographs) == set(named) and not set.intersection(*photographs)
    assert all(photographs) == measured


def test_images_are_compared_as_if_they_were_read_again(tmp_path):
    capture = build_capture(tmp_path / "tiny")
    with counted_decodes() as decoded:
        run(capture=capture, out=tmp_path / "one")
    assert max(Counter(path for _, path in decoded.files).values()) == 1
    images, cameras = (pd.read_parquet(tmp_path / f"one/{name}.parquet") for name in ("images", "cameras"))
    source = ImageSource.from_index(capture, json.loads((tmp_path / "one/capture.json").read_text())["images"])
    verdicts = complain_of_exchanged(images, cameras, source, Complaints(capture))
    written = pd.read_csv(tmp_path / "one/verdicts_images.csv")
    assert len(verdicts) == 2 and written.equals(pd.read_csv(io.StringIO(verdict_table(verdicts).to_csv(index=False))))


def is_photograph(path: str) -> bool:
    return path.startswith("calibration/")


def text_of(folder: Path) -> list[str]:
    return [path.read_text() for path in folder.glob("calibration_*.json")]


@pytest.mark.parametrize("lost", ["capture.yaml", "frames.csv", "cameras.csv"])
def test_share_of_a_capture_in_doubt_is_empty_and_complains_of_nothing(tmp_path, lost):
    capture = build_capture(tmp_path / "tiny")
    (capture / lost).unlink()
    for table in inspected_by_two(capture, tmp_path / "shares"):
        assert pd.read_parquet(table).empty


def test_images_of_which_no_table_says_anything_are_inspected(tmp_path):
    capture = build_capture(tmp_path / "tiny")
    run(capture=capture, out=tmp_path / "one")
    run(capture=capture, out=tmp_path / "joined", inspected=inspected_by_two(capture, tmp_path / "shares")[:1])
    assert contents(tmp_path / "one") == contents(tmp_path / "joined")


def test_images_listed_in_a_table_are_shared_by_frame(tmp_path):
    capture = build_capture(tmp_path / "tiny")
    rows = [
        {"camera": c, "frame": f, "path": f"images/{c}/{f:06d}.exr", "mask_path": f"masks/{c}/{f:06d}.png"}
        for c in ("left", "right")
        for f in range(3)
    ]
    pd.DataFrame(rows).to_parquet(capture / "images.parquet", index=False)

    def listed(manifest):
        manifest["images"] = {**manifest["images"], "table": "images.parquet"}
        del manifest["images"]["path"]
        manifest["masks"] = {}

    edit_manifest(capture, listed)
    run(capture=capture, out=tmp_path / "one")
    tables = inspected_by_two(capture, tmp_path / "shares")
    assert [len(pd.read_parquet(table)) for table in tables] == [2 * 2 * 2, 2 * 2]
    run(capture=capture, out=tmp_path / "joined", inspected=tables)
    assert contents(tmp_path / "one") == contents(tmp_path / "joined")


def test_another_table_is_refused_by_name(tmp_path):
    capture = build_capture(tmp_path / "tiny")
    tables = inspected_by_two(capture, tmp_path / "shares")
    shutil.copy(capture / "keypoints_2d.parquet", tables[1])
    with pytest.raises(InputError, match=r"0002\.parquet: expected columns what, camera, .* found frame"):
        InspectedImages(tables)
