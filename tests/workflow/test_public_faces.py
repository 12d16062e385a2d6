"""Public sets of people, each named in one line of configuration, from their own layouts to tables of metrics.

Each is scored by its own protocol, if it has one.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from tests.support.datasets import actorshq_layout, ava256_layout, faceolat_layout, nersemble_layout
from tests.support.datasets.protocols import assert_kept, documented_protocols

CHEAP = "unwrap_atlas: {size: 32}\ntrain_avatar: {steps: 4}\nevaluate_avatar: {pictures: false}\n"

SETS = {
    "faceolat": (faceolat_layout, faceolat_layout.write_faceolat),
    "ava256": (ava256_layout, ava256_layout.write_ava256),
    "actorshq": (actorshq_layout, actorshq_layout.write_actorshq),
    "nersemble": (nersemble_layout, nersemble_layout.write_nersemble),
}


@pytest.fixture(scope="module")
def project(copy_of_project, stage_server, tmp_path_factory):
    return copy_of_project(tmp_path_factory.mktemp("faces") / "project").with_stages_of(stage_server)


@pytest.mark.parametrize("dataset", SETS)
def test_one_line_of_configuration_and_a_preset_lead_to_the_metrics_that_are_promised(project, dataset, tmp_path):
    (layout, write), promised = SETS[dataset], documented_protocols()[dataset]
    truth, results = layout.true_head(), project.folder / "results" / dataset
    subject = f"source: {dataset}\npath: {write(tmp_path, truth)}\n"
    subject += f"import_capture: {layout.settings(tmp_path, truth)}\n{CHEAP}"
    (project.folder / f"config/subjects/{dataset}.yaml").write_text(subject)
    preset = ["--configfile", promised.preset] if promised.preset else []
    project.ran(f"results/{dataset}/metrics.csv", "--config", "training_processes=1", *preset)
    smaller = promised.settings.get("import_capture", {}).get("reduced", 1)
    sizes = {name: tuple(side // smaller for side in truth.image_size(name)) for name in truth.cameras}
    assert_kept(dataset, results, sizes)
    table = pd.read_csv(results / "metrics.csv")
    assert np.isfinite(table[table.images > 0].psnr_db).all()


def test_preset_of_a_set_without_a_protocol_is_refused_with_the_reason(project):
    said = project.refused("results/tiny/metrics.csv", "--configfile", "config/presets/set_faceolat.yaml")
    assert "(--config, --configfile): evaluate_avatar.protocol: expected ours, or that of a set that states one" in said
    assert "faceolat has none: its programs" in said and "docs/datasets.md says what ours is" in said
    assert "Traceback" not in said
