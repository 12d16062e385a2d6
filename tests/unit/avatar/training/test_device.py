"""What an avatar computes stays on the device of its parameters, without a GPU: torch's device `meta` carries shapes
but no numbers, and tensors that lie elsewhere are refused wherever they meet it, as a GPU would.

Splatting has tests of its own and is replaced by empty pictures here.
"""

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from pipeline.avatar import model
from pipeline.avatar.appearance import lobes
from pipeline.avatar.frames import inputs
from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.frames.sky import PreparedSky
from pipeline.avatar.geometry import gaussians_on_texels
from pipeline.avatar.model import Avatar
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.spec.planned import resolve_spec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.avatar.training.distributed import FlatGradients
from pipeline.avatar.training.step_loss import Portion, compute_loss
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.cameras import Camera
from pipeline.lighting import subsurface
from pipeline.lighting.environment import Environment
from pipeline.lighting.environment_lobes import prefilter
from pipeline.lighting.frame_lights import FrameLights
from pipeline.rendering.splat_conventions import Splatted
from tests.support.avatars.sheet import make_frame, make_image, make_sheet
from tests.support.avatars.variants import VARIANTS

PLANNED = {"shadow", "near_field", "articulation", "specular", "deferred"}

# Decoded anchors are placed by NumPy, from numbers.
HEAD = {"avatar": "head", "anchors": "tracked", "weight_ssim": 0.1}
HEADS = {
    "rgca": HEAD | {"deferred": "off"}, "eyenerf": HEAD | {"highlight": "harmonics"},
    "linear": HEAD | {"shading": "linear"}, "cosine": HEAD | {"highlight": "cosine", "transfer_degree": 3},
}  # fmt: skip
ELSEWHERE = torch.device("meta")
COVERED_PIXELS = 7


class OneDevice(TorchDispatchMode):
    """Refuses operations on tensors of several devices, but for copies and single numbers: GPUs take those."""

    def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
        tensors = [a for a in tree_leaves((args, kwargs or {})) if isinstance(a, torch.Tensor) and a.ndim]
        copies = operation._opname in ("copy_", "_to_copy")
        if len({tensor.device for tensor in tensors}) > 1 and not copies:
            raise RuntimeError(f"{operation}: tensors on {[str(tensor.device) for tensor in tensors]}")
        return operation(*args, **(kwargs or {}))


def empty_picture(gaussians, features, view, options, sampling):
    inputs = (*gaussians.named().values(), features, view.R, view.t, view.K)
    assert {tensor.device for tensor in inputs} == {ELSEWHERE}
    seen = sum(tensor.mean() for tensor in inputs)  # so that gradients go back to all of them
    blank = features.new_zeros(view.height, view.width) + seen
    return Splatted(features.new_zeros(view.height, view.width, features.shape[1]) + seen, blank, blank)


def empty_product(matrix, light):
    """Nothing elsewhere multiplies sparse matrices."""
    assert matrix.device == light.device == ELSEWHERE
    return light.new_zeros(matrix.shape[0], light.shape[1])


def covered_pixels(mask, as_tuple=False):
    """How many pixels are covered depends on numbers, of which there are none."""
    places = torch.zeros(COVERED_PIXELS, mask.ndim, dtype=torch.int64, device=mask.device)
    return places.unbind(1) if as_tuple else places


@pytest.fixture
def no_numbers(monkeypatch):
    """Stand-ins for what has to know numbers."""
    monkeypatch.setattr(subsurface, "product", empty_product)
    monkeypatch.setattr(gaussians_on_texels, "splat_supersampled", empty_picture)
    monkeypatch.setattr(torch, "nonzero", covered_pixels)
    # The mesh is drawn on the CPU, from numbers; its depth comes back to the picture's device.
    monkeypatch.setattr(lobes, "depth_of_pixels", lambda source, picture, *rest: picture.depth.detach())
    for module in (model, inputs):
        monkeypatch.setattr(module, "white_once", lambda lights: lights)


@pytest.mark.parametrize("name", ["full", *VARIANTS, *HEADS])
@pytest.mark.usefixtures("no_numbers")
def test_frame_picture_losses_and_gradients_are_on_the_device_of_the_parameters(name):
    settings = TrainAvatar(**(VARIANTS | HEADS).get(name, {}))
    atlas = make_sheet(8)
    record = make_frame(atlas, np.array([[0.5, 0.3, 1.5], [0.1, 0.2, 1.4]]), np.array([[3.0, 2, 1], [1, 1, 1]]))
    image = make_image(record, np.array([0.7, 0.4, 0.2]))
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(settings, PLANNED)).to(ELSEWHERE)
    inputs = FrameInputs(atlas, record, device=ELSEWHERE)
    with OneDevice():
        gradients = FlatGradients(avatar)
        terms = compute_loss(avatar, Portion(inputs, [image], 1), settings)
        assert {term.device for term in terms.values()} == {ELSEWHERE}
        sum(terms.values()).backward()
    assert gradients.flat.device == ELSEWHERE


@pytest.mark.usefixtures("no_numbers")
def test_relit_pictures_are_on_the_device_of_the_parameters():
    atlas = make_sheet(8)
    avatar = Avatar(atlas, texel_spacing(atlas), resolve_spec(TrainAvatar(), PLANNED)).to(ELSEWHERE)
    relighter = Relighter(LoadedAvatar(avatar, atlas), TraceIrradiance())
    camera = Camera(R=np.diag([1.0, -1, -1]), t=np.array([0, 0, 1.0]), K=np.eye(3), dist=np.zeros(5), width=4, height=4)
    lights = FrameLights(np.array([[0.5, 0.3, 1.5]]), np.ones((1, 3)))
    sky = Environment(np.ones((8, 16, 3), np.float32))
    prepared = PreparedSky(torch.zeros(81, 3, device=ELSEWHERE), prefilter(sky).to(ELSEWHERE), torch.eye(3))
    with OneDevice():
        frames = [
            relighter.under_lights(atlas.rest_vertices, lights),
            relighter.under_pixels(atlas.rest_vertices, sky, np.eye(3)),
            relighter.under_sky(atlas.rest_vertices, prepared, sky, np.eye(3)),
        ]
        for frame in frames:
            assert {tensor.device for tensor in relighter.view(frame, camera)} == {ELSEWHERE}


def test_a_tensor_that_stayed_behind_is_found():
    with OneDevice():
        there = torch.zeros(3, device=ELSEWHERE)
        assert (there + torch.tensor(1.0)).device == ELSEWHERE
        with pytest.raises(RuntimeError):
            there + torch.tensor([0.0, 0.0, 1.0])
        with pytest.raises(RuntimeError, match=r"index"):
            torch.zeros(3)[torch.zeros(2, dtype=torch.int64, device=ELSEWHERE)]
