"""Public sets of people, each named in one line of configuration, from their layouts to tables of metrics.

Each is scored by its own protocol, if it has one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.support.datasets import (
    actorshq_layout,
    ava256_layout,
    faceolat_layout,
    goliath_kinds_layout,
    nersemble_layout,
)
from tests.support.datasets.protocols import assert_kept, documented_protocols
from tests.support.datasets.turning_head import TurningHead

CHEAP = "unwrap_atlas: {size: 32}\ntrain_avatar: {steps: 4}\nevaluate_avatar: {pictures: false}\n"

TINY = (24, 36)


@dataclass(frozen=True)
class Case:
    """A fake, and the set that it is of."""

    dataset: str
    truth: Callable[[], TurningHead]
    write: Callable[[Path, TurningHead], Path]
    settings: Callable[[Path, TurningHead], str] = lambda folder, truth: "{}"


CASES = {
    "faceolat": Case("faceolat", faceolat_layout.true_head, faceolat_layout.write_faceolat, faceolat_layout.settings),
    "ava256": Case("ava256", ava256_layout.true_head, ava256_layout.write_ava256, ava256_layout.settings),
    "actorshq": Case("actorshq", actorshq_layout.true_head, actorshq_layout.write_actorshq, actorshq_layout.settings),
    "nersemble": Case(
        "nersemble", nersemble_layout.true_head, nersemble_layout.write_nersemble, nersemble_layout.settings
    ),
    "hand": Case("goliath", partial(goliath_kinds_layout.true_hand, TINY), goliath_kinds_layout.write_hands),
    "clothed": Case("goliath", partial(goliath_kinds_layout.true_body, TINY), goliath_kinds_layout.write_body),
}


@pytest.fixture(scope="module")
def project(copy_of_project, stage_server, tmp_path_factory):
    return copy_of_project(tmp_path_factory.mktemp("faces") / "project").with_stages_of(stage_server)


@pytest.mark.parametrize("name", CASES)
def test_one_line_of_configuration_and_a_preset_lead_to_the_metrics_that_are_promised(project, name, tmp_path):
    case, promised = CASES[name], documented_protocols()[CASES[name].dataset]
    truth, results = case.truth(), project.folder / "results" / name
    subject = f"source: {case.dataset}\npath: {case.write(tmp_path, truth)}\n"
    subject += f"import_capture: {case.settings(tmp_path, truth)}\n{CHEAP}"
    (project.folder / f"config/subjects/{name}.yaml").write_text(subject)
    preset = ["--configfile", promised.preset] if promised.preset else []
    project.ran(f"results/{name}/metrics.csv", "--config", "training_processes=1", *preset)
    smaller = promised.settings.get("import_capture", {}).get("reduced", 1)
    sizes = {name: tuple(side // smaller for side in truth.image_size(name)) for name in truth.cameras}
    assert_kept(case.dataset, results, sizes)
    table = pd.read_csv(results / "metrics.csv")
    assert np.isfinite(table[table.images > 0].psnr_db).all()


def test_preset_of_a_set_without_a_protocol_is_refused_with_the_reason(project):
    said = project.refused("results/tiny/metrics.csv", "--configfile", "config/presets/set_faceolat.yaml")
    assert "(--config, --configfile): evaluate_avatar.protocol: expected ours, or that of a set that states one" in said
    assert "faceolat has none: its programs" in said and "docs/datasets.md says what ours is" in said
    assert "Traceback" not in said
