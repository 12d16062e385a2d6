"""What an avatar may not ask of a GPU: refused before anything starts."""

import importlib.util
from pathlib import Path

import pytest
import torch

from pipeline.avatar.spec import gpu_limits
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.spec.gpu_limits import require_drawable
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.base.errors import InputError
from pipeline.base.yaml_files import read_yaml
from pipeline.budget.presets import RULES
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar

CUDA, CPU = torch.device("cuda"), torch.device("cpu")
PRESETS = sorted(Path("config/presets").glob("*.yaml"))


@pytest.fixture
def gsplat(monkeypatch):
    """A function: says that gsplat is there, or is not."""
    return lambda there: monkeypatch.setattr(gpu_limits, "find_spec", lambda name: there or None)


def spec_of(kind="body", **settings) -> AvatarSpec:
    return resolve_spec(TrainAvatar(**{"shading": "transfer", **settings}), set(EFFECTS) - {"eyes"}, kind)


def test_median_depth_is_refused_where_a_pixel_is_asked_for_its_depth(gsplat):
    gsplat(True)
    with pytest.raises(InputError, match=r"train_avatar.depth: expected traced, .* found median.*device: cpu"):
        require_drawable(spec_of(depth="median", deferred="on"), CUDA)
    require_drawable(spec_of(depth="median", deferred="off"), CUDA)
    require_drawable(spec_of(depth="normalised", deferred="on"), CUDA)
    require_drawable(spec_of(depth="median", deferred="on"), CPU)


def test_gaussians_need_gsplat_and_volumes_do_not(gsplat):
    gsplat(False)
    with pytest.raises(InputError, match=r"expected gsplat.*pip install '\.\[gpu\]', or set device: cpu"):
        require_drawable(spec_of(), CUDA)
    require_drawable(spec_of(), CPU)
    require_drawable(spec_of("head", geometry="volumes", eyes="off"), CUDA)


def test_median_depth_on_a_gpu_that_is_named_is_refused_with_the_settings():
    with pytest.raises(ValueError, match="device: cuda: expected depth: traced, normalised or expected, found median"):
        TrainAvatar(device="cuda", depth="median", shading="transfer")
    for unread in ({"deferred": "off"}, {"specular": "off"}, {"highlight": "harmonics"}, {"shading": "combined"}):
        asked = {"shading": "transfer", **unread}
        assert TrainAvatar(device="cuda", depth="median", **asked).depth == "median"


@pytest.mark.parametrize("preset", PRESETS, ids=lambda path: path.stem)
def test_every_preset_can_be_drawn_on_a_gpu(repo_root, gsplat, preset):
    """Those of budgets, which say nothing of the model, as the papers' models, too."""
    gsplat(True)
    asked = read_yaml(repo_root / preset)
    kind = "head" if "head" in preset.stem else "body"
    papers = [{"shading": "transfer", "deferred": "on"}] * (preset.stem in RULES)
    for changes in [{}, *papers, *asked.get("variants", {}).values()]:
        own = {name: value for name, value in (changes or {}).items() if name != "trace_irradiance"}
        settings = TrainAvatar(**{**asked.get("train_avatar", {}), **own, "device": "cuda"})
        require_drawable(resolve_spec(settings, set(EFFECTS), kind), CUDA)


def test_gsplat_is_looked_for_and_not_imported():
    assert gpu_limits.find_spec is importlib.util.find_spec
