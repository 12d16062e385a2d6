"""Public sets of people, each named in one line of configuration, from their own layouts to tables of metrics."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.support.datasets import actorshq_layout, ava256_layout, faceolat_layout, nersemble_layout

CHEAP = "unwrap_atlas: {size: 32}\ntrain_avatar: {steps: 4}\nevaluate_avatar: {pictures: false}\n"


def write_faceolat(folder):
    truth = faceolat_layout.true_head()
    return faceolat_layout.write_faceolat(folder, truth), faceolat_layout.settings(folder, truth)


def write_ava256(folder):
    truth = ava256_layout.true_head()
    return ava256_layout.write_ava256(folder, truth), ava256_layout.settings(folder, truth)


def write_actorshq(folder):
    truth = actorshq_layout.true_head()
    return actorshq_layout.write_actorshq(folder, truth), actorshq_layout.settings(folder, truth)


def write_nersemble(folder):
    truth = nersemble_layout.true_head()
    return nersemble_layout.write_nersemble(folder, truth), nersemble_layout.settings(folder, truth)


SETS = {
    "faceolat": (write_faceolat, {"test_cameras", "test_patterns"}), "ava256": (write_ava256, {"test_segments"}),
    "actorshq": (write_actorshq, {"test_cameras"}), "nersemble": (write_nersemble, {"test_cameras", "test_segments"}),
}  # fmt: skip


@pytest.fixture(scope="module")
def project(copy_of_project, stage_server, tmp_path_factory):
    return copy_of_project(tmp_path_factory.mktemp("faces") / "project").with_stages_of(stage_server)


@pytest.mark.parametrize("dataset", SETS)
def test_one_line_of_configuration_leads_to_metrics(project, dataset, tmp_path):
    write, splits = SETS[dataset]
    root, settings = write(tmp_path)
    subject = f"source: {dataset}\npath: {root}\nimport_capture: {settings}\n{CHEAP}"
    (project.folder / f"config/subjects/{dataset}.yaml").write_text(subject)
    project.ran(f"results/{dataset}/metrics.csv", "--config", "training_processes=1")
    table = pd.read_csv(project.folder / f"results/{dataset}/metrics.csv")
    scored = table[table.images > 0]
    assert splits <= set(scored.split)
    assert np.isfinite(scored.psnr_db).all()
