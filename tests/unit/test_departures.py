"""docs/departures.md against the presets: every departure has a setting, a reason, a row and a compared equation."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
import yaml

from pipeline.config.train_avatar import TrainAvatar

SIZES = {"shadow_levels", "normal_steps"}
"""Settings that are a size, which may differ between a preset and that of the papers' sizes."""

NO_DEPARTURE = {"avatar"}
KINDS = {"body": "## Bodies", "head": "## Heads"}


def section(repo_root, name):
    return yaml.safe_load((repo_root / f"config/presets/{name}.yaml").read_text())


def rows_of(repo_root, kind):
    """Cells of the kind's table."""
    text = (repo_root / "docs/departures.md").read_text()
    part = text[text.index(KINDS[kind]) :].split("\n## ")[0]
    lines = [line for line in part.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines[1:] if "|---" not in line]


def settings_in(cell):
    return {k: v for code in re.findall(r"`([^`]+)`", cell) for k, v in yaml.safe_load(code).items()}


@pytest.mark.parametrize("kind", KINDS)
def test_every_row_names_settings_of_the_preset_that_differ_by_default(repo_root, kind):
    asked = section(repo_root, f"papers_{kind}")["train_avatar"]
    preset, default, told = TrainAvatar(**asked), TrainAvatar(), {}
    for element, printed, reason, cell, row in rows_of(repo_root, kind):
        assert element and printed and reason and row
        told |= settings_in(cell)
        for name in settings_in(cell):
            assert getattr(default, name) != getattr(preset, name), name
    assert {name: asked[name] for name in told} == told
    different = {name for name in asked if getattr(default, name) != getattr(preset, name)}
    assert different - NO_DEPARTURE == set(told)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_put_a_departure_back(repo_root, kind):
    variants = section(repo_root, f"departures_{kind}")["variants"]
    preset = TrainAvatar(**section(repo_root, f"papers_{kind}")["train_avatar"])
    named = set()
    for element, _, _, cell, row in rows_of(repo_root, kind):
        rows = re.findall(r"`([^`]+)`", row)
        changed = {name for one in rows for name, value in variants[one].items() if getattr(preset, name) != value}
        assert changed & set(settings_in(cell)), element
        named |= set(rows)
    assert set(variants) - named <= {"papers", "irradiance_1spp", "irradiance_1spp_shared", "fresnel", "traced_start"}
    for changes in variants.values():
        preset.model_copy(update={name: value for name, value in changes.items() if name != "trace_irradiance"})


@pytest.mark.parametrize("kind", KINDS)
def test_every_element_is_compared_with_its_printed_equation(repo_root, kind):
    text = (repo_root / f"tests/unit/avatar/test_papers_{kind}.py").read_text()
    compared = set()
    for name in re.findall(r"def test_(\d+(?:_(?:and|to)_\d+)*)\w*\(", text):
        tags = name.split("_")
        numbers = [int(tag) for tag in tags if tag.isdigit()]
        for (place, tag), after in pairwise([*enumerate(tags), (len(tags), "")]):
            if tag == "to":
                numbers += range(int(tags[place - 1]), int(after[1]) + 1)
        compared |= set(numbers)
    for element, *_ in rows_of(repo_root, kind):
        for low, high in re.findall(r"(?<![\w.])(\d+)(?:-(\d+))?", element):
            assert set(range(int(low), int(high or low) + 1)) <= compared, element


@pytest.mark.parametrize(("small", "large"), [("papers_body", "gpu"), ("papers_head", "gpu_head")])
def test_presets_in_the_papers_sizes_ask_for_the_same(repo_root, small, large):
    printed, sized = (section(repo_root, name)["train_avatar"] for name in (small, large))
    assert {name: sized.get(name) for name in printed.keys() - SIZES} == {
        name: value for name, value in printed.items() if name not in SIZES
    }
    TrainAvatar(**sized)
