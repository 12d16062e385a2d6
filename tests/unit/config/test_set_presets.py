"""Presets of public sets: one for each set that has a protocol, of settings that there are."""

from __future__ import annotations

import pytest

from pipeline.base.code_digest import ROOT
from pipeline.base.yaml_files import read_yaml
from pipeline.config.project import DATASETS, SubjectSettings

PRESETS = {path.stem.removeprefix("set_"): path for path in sorted((ROOT / "config/presets").glob("set_*.yaml"))}

SHIPPED = {
    "goliath": (1334, 2048), "becominglit": (2200, 3208), "humanolat": (810, 1440), "olatverse": (1500, 2844),
    "ava256": (667, 1024), "nersemble": (2200, 3208),
}  # fmt: skip
"""Width and height of images, as the sets have them."""


def test_every_set_with_a_protocol_has_one():
    assert set(PRESETS) == set(DATASETS) - {"faceolat"}, "FaceOLAT states none"


@pytest.mark.parametrize("dataset", PRESETS)
def test_settings_are_there_and_count_the_pixels_of_the_images(dataset):
    settings = SubjectSettings(source=dataset, path="somewhere", **read_yaml(PRESETS[dataset]))
    scored = settings.evaluate_avatar
    assert ("psnr_image" in scored.metrics) == (scored.image_pixels > 0)
    if scored.image_pixels:
        width, height = (side // settings.import_capture.reduced for side in SHIPPED[dataset])
        assert scored.image_pixels == width * height
    assert f"config/presets/set_{dataset}.yaml" in PRESETS[dataset].read_text()
