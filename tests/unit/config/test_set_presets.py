"""Presets of public sets against the page that lists them: one for each set that has a protocol."""

from __future__ import annotations

import pytest

from pipeline.base.code_digest import ROOT
from pipeline.base.errors import InputError
from pipeline.base.yaml_files import read_yaml
from pipeline.config.datasets import DATASETS, WITHOUT_PROTOCOL
from pipeline.config.loading import load_project
from pipeline.config.project import SubjectSettings
from pipeline.config.subjects import require_own_protocol
from pipeline.metrics.evaluation import SPLITS
from tests.support.datasets.protocols import documented_protocols

FILES = {path.stem.removeprefix("set_"): path for path in sorted((ROOT / "config/presets").glob("set_*.yaml"))}
PROTOCOLS = documented_protocols()
STATED = [dataset for dataset in DATASETS if dataset not in WITHOUT_PROTOCOL]

SHIPPED = {
    "goliath": (1334, 2048), "becominglit": (2200, 3208), "humanolat": (810, 1440), "olatverse": (1500, 2844),
    "ava256": (667, 1024), "nersemble": (2200, 3208),
}  # fmt: skip
"""Width and height of images, as the sets have them."""


def test_every_set_has_a_row_and_a_file_and_every_protocol_a_preset():
    assert list(PROTOCOLS) == list(DATASETS) and set(FILES) == set(DATASETS)
    assert [dataset for dataset in DATASETS if PROTOCOLS[dataset].preset] == STATED


@pytest.mark.parametrize("dataset", STATED)
def test_preset_is_what_its_row_says(dataset):
    promised = PROTOCOLS[dataset]
    settings = SubjectSettings(source=dataset, path="somewhere", **promised.settings)
    scored = settings.evaluate_avatar
    assert promised.preset == f"config/presets/set_{dataset}.yaml" and scored.protocol == dataset
    assert f"FLAGS='--configfile {promised.preset}'" in FILES[dataset].read_text()
    assert ("psnr_image" in promised.metrics) == ("psnr_image" in scored.metrics)
    assert promised.row in SPLITS and promised.splits <= set(SPLITS)
    if promised.size:
        assert promised.size == tuple(side // settings.import_capture.reduced for side in SHIPPED[dataset])
    assert promised.ours == ("ours are" in FILES[dataset].read_text().replace("\n# ", " "))


def asked(tmp_path, source, protocol):
    """A subject of a set is asked for the scores of a preset."""
    (tmp_path / "someone.yaml").write_text(f"source: {source}\npath: somewhere\n")
    content = read_yaml(FILES[protocol])
    require_own_protocol(load_project(content, content, tmp_path), "someone")


@pytest.mark.parametrize("dataset", STATED)
def test_protocol_of_the_own_set_is_taken(tmp_path, dataset):
    asked(tmp_path, dataset, dataset)


@pytest.mark.parametrize(("source", "own"), [("goliath", "ours or goliath"), ("faceolat", "ours")])
def test_protocol_of_another_set_is_refused(tmp_path, source, own):
    with pytest.raises(
        InputError, match=f"someone: .*protocol: expected {own}, as it is of {source}, found ava256; take"
    ):
        asked(tmp_path, source, "ava256")


@pytest.mark.parametrize("dataset", WITHOUT_PROTOCOL)
def test_protocol_that_a_set_lacks_is_refused_with_the_reason(tmp_path, dataset):
    with pytest.raises(InputError, match=rf"1 problem\n.*found {dataset}; {dataset} has none: its programs .* take no"):
        asked(tmp_path, dataset, dataset)
