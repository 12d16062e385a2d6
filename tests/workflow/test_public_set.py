"""A public set named in one line of configuration, from its own layout to the table of metrics."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest

from tests.support.datasets.goliath_layout import CAMERAS, true_head, write_goliath
from tests.support.datasets.protocols import assert_kept

TARGET = "results/someone/metrics.csv"
PRESET = ("--configfile", "config/presets/set_goliath.yaml")
IMAGE = (32, 48)
CHEAP = "unwrap_atlas: {size: 32}\ntrain_avatar: {steps: 4}\nevaluate_avatar: {pictures: false}\n"

STAGES = [
    "import_capture", "index_capture", "calibrate_cameras", "calibrate_color", "calibrate_lights", "book_patterns",
    "track_mesh", "unwrap_atlas", "plan_effects", "bake_textures", "pack_shards", "train_avatar",
    "evaluate_avatar_without_pictures",
]  # fmt: skip


@pytest.fixture(scope="module")
def made(copy_of_project, stage_server, tmp_path_factory):
    folder = tmp_path_factory.mktemp("public")
    workflow = copy_of_project(folder / "project").with_stages_of(stage_server)
    shipped = write_goliath(folder / "sets", true_head(image=IMAGE))
    (workflow.folder / "config/subjects/someone.yaml").write_text(f"source: goliath\npath: {shipped}\n{CHEAP}")
    return workflow, shipped, workflow.ran(TARGET, "--config", "training_processes=1", *PRESET)


def test_one_line_of_configuration_and_a_preset_lead_to_the_metrics_that_are_promised(made):
    workflow, _, ran = made
    assert sorted(set(ran)) == sorted(STAGES)
    table = pd.read_csv(workflow.folder / TARGET)
    assert np.isfinite(table[table.images > 0].psnr_db).all()
    assert_kept("goliath", (workflow.folder / TARGET).parent, dict.fromkeys(CAMERAS, IMAGE))
    assert workflow.planned(TARGET, *PRESET) == {}


def test_images_stay_where_the_set_has_them(made):
    workflow, shipped, _ = made
    capture = workflow.folder / "captures/someone"
    assert (capture / "source").resolve() == shipped.resolve()
    own = sum(path.stat().st_size for path in capture.iterdir() if path.is_file())
    images = sum(path.stat().st_size for path in (shipped / "image").iterdir())
    assert own < images
    described = json.loads((workflow.folder / "results/someone/index/capture.json").read_text())
    assert described["imported"]["dataset"] == "goliath"


def test_changed_setting_is_heeded_where_an_import_leaves_all_as_it_was(made, tmp_path):
    workflow = made[0].copied(tmp_path / "project").with_own_code()
    workflow.append("pipeline/stages/import_capture.py", "EDITED = 1\n")
    options = ("--config", "training_processes=1", "train_avatar={steps: 5}", *PRESET)
    ran = set(workflow.ran(TARGET, *options))
    assert ran == {"import_capture", "train_avatar", "evaluate_avatar_without_pictures"}
    assert workflow.planned(TARGET, *options) == {}


def test_changed_calibration_of_the_set_is_imported_anew_and_smaller_chunks_are_counted(made):
    workflow, shipped, _ = made
    path = shipped / "camera_calibration.json"
    content = json.loads(path.read_text())
    next(entry for entry in content["KRT"] if entry["cameraId"] == CAMERAS[0])["K"][0][0] *= 1.001
    path.write_text(json.dumps(content))
    assert workflow.planned(TARGET, *PRESET)["import_capture"] == 1
    # What was imported says how many frames there are: eleven are left of fourteen.
    assert workflow.planned("results/someone/tracking/review", "--config", "chunk_frames=4", *PRESET)["track_mesh"] == 3
