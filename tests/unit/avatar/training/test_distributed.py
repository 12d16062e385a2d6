"""What processes that train together have to agree on; `tests/stages/test_train_processes.py` starts real ones."""

import copy

import numpy as np
import pytest
import torch

from pipeline.avatar.frames.inputs import FrameInputs
from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.avatar.training.distributed import FlatGradients, Processes, choose_device
from pipeline.avatar.training.optimizer import make_optimizer
from pipeline.avatar.training.step_loss import Portion, compute_loss
from pipeline.avatar.training.training import Training
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from tests.support.avatars.sheet import make_frame, make_image, make_sheet

PARTS_RTOL = 100 * 2**-24
"""Of the largest gradient of a parameter. One process adds the gradients of its pictures before they go back through
the frame, several do it afterwards: each of the about 100 operations on the way rounds, by 2^-24, differently."""

SETTINGS = TrainAvatar(steps=4, weight_offset=1.0, weight_normal=1.0)


@pytest.fixture
def scene():
    atlas = make_sheet(8)
    frame = make_frame(atlas, np.array([[0.5, 0.3, 1.5]]), np.array([[3.0, 3.0, 3.0]]))
    images = [make_image(frame, np.array([0.7, 0.4, 0.2]), shift) for shift in (-0.2, 0.0, 0.2)]
    torch.manual_seed(0)
    avatar = Avatar(atlas, texel_spacing(atlas), AvatarSpec(True, True, 4, 2, 0.1))
    with torch.no_grad():
        for parameter in avatar.parameters():  # where the terms that look at no image have gradients as well
            parameter += 1e-3 * torch.randn_like(parameter)
    return avatar, FrameInputs(atlas, frame), images


def gradients_of(avatar, inputs, images, processes):
    gradients, sharers = FlatGradients(avatar), processes.sharers(0, 1)
    portion = Portion(inputs, processes.share(images, sharers), len(images), len(sharers))
    terms = compute_loss(avatar, portion, SETTINGS)
    sum(terms.values()).backward()
    return gradients, sum(terms.values()).item()


@pytest.mark.parametrize("count", [2, 3, 5])
def test_parts_sum_to_what_one_process_computes(scene, count):
    """Loss and gradients, also with more processes than images; no part is the whole."""
    avatar, inputs, images = scene
    whole, loss = gradients_of(avatar, inputs, images, Processes())
    parts = [gradients_of(avatar, inputs, images, Processes(rank, count)) for rank in range(count)]
    assert sum(part_loss for _, part_loss in parts) == pytest.approx(loss, rel=PARTS_RTOL)
    for name, expected in whole.views[0].items():
        found = sum(part.views[0][name] for part, _ in parts)
        assert (found - expected).abs().max() <= PARTS_RTOL * expected.abs().max(), name
        assert expected.abs().max() > 0, name
        for part, _ in parts:
            assert (part.views[0][name] - expected).abs().max() > 0.01 * expected.abs().max(), name


def test_every_image_falls_to_one_process():
    for count in (1, 2, 3, 7):
        shares = [Processes(rank, count).share(range(5), range(count)) for rank in range(count)]
        assert sorted(image for share in shares for image in share) == list(range(5))
        assert max(map(len, shares)) - min(map(len, shares)) <= 1


@pytest.mark.parametrize(("count", "steps"), [(1, 1), (1, 3), (2, 2), (2, 4), (2, 3), (3, 2), (5, 2), (4, 1)])
def test_every_step_of_a_round_has_its_processes_and_none_is_idle(count, steps):
    """Processes share a step only where there are more of them than steps; no two differ by more than one."""
    sharers = [Processes(0, count).sharers(step, steps) for step in range(steps)]
    assert {rank for ranks in sharers for rank in ranks} == set(range(count))
    if count <= steps:
        assert all(len(ranks) == 1 for ranks in sharers)
        done = [sum(rank in ranks for ranks in sharers) for rank in range(count)]
    else:
        done = [len(ranks) for ranks in sharers]
        assert sum(done) == count
    assert max(done) - min(done) <= 1


def test_steps_of_a_round_are_those_of_delayed_gradients(scene):
    """Adam by hand: both gradients at the parameters before the round, applied one after the other."""
    avatar, inputs, images = scene
    twin = copy.deepcopy(avatar)
    training = Training(avatar, SETTINGS)
    batches = [images[:2], images[2:]]
    training.take_round(0, [Portion(inputs, batch, len(batch)) for batch in batches])
    gradients = []
    for step, batch in enumerate(batches):
        sum(compute_loss(twin, Portion(inputs, batch, len(batch)), SETTINGS, step).values()).backward()
        gradients.append({name: parameter.grad for name, parameter in twin.named_parameters()})
        for parameter in twin.parameters():
            parameter.grad = None
    optimizer = make_optimizer(twin, SETTINGS)
    for step, of_step in enumerate(gradients):
        for group in optimizer.param_groups:
            group["lr"] = group["start_rate"] * SETTINGS.final_rate ** (step / SETTINGS.steps)
        for name, parameter in twin.named_parameters():
            parameter.grad = of_step[name] if of_step[name] is not None else torch.zeros_like(parameter)
        optimizer.step()
    for (name, found), expected in zip(avatar.named_parameters(), twin.parameters(), strict=True):
        assert torch.equal(found, expected), name


def test_frames_of_a_step_are_averaged(scene):
    """Adam by hand on the mean of both gradients; the terms are their means, too."""
    avatar, inputs, images = scene
    twin, settings = copy.deepcopy(avatar), SETTINGS.model_copy(update={"frames_per_step": 2, "steps_together": 1})
    portions = [Portion(inputs, batch, len(batch)) for batch in (images[:2], images[2:])]
    rows, _ = Training(avatar, settings).take_round(3, portions)
    losses = [compute_loss(twin, portion, settings, 3) for portion in portions]
    (sum(sum(terms.values()) for terms in losses) / 2).backward()
    optimizer = make_optimizer(twin, settings)
    for group in optimizer.param_groups:
        group["lr"] *= settings.final_rate ** (3 / settings.steps)
    optimizer.step()
    assert len(rows) == 1
    for name, value in rows[0].items():
        assert value == pytest.approx(sum(terms[name].item() for terms in losses) / 2, rel=1e-6), name
    for (name, found), expected in zip(avatar.named_parameters(), twin.parameters(), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6, msg=name)


def test_a_parameter_that_is_not_used_stays_and_has_a_state(scene):
    avatar, inputs, images = scene
    avatar.unused = torch.nn.Parameter(torch.ones(3))
    training = Training(avatar, SETTINGS)
    training.take_step(0, inputs, images)
    assert avatar.unused.tolist() == [1, 1, 1]
    assert training.optimizer.state[avatar.unused]["exp_avg"].tolist() == [0, 0, 0]


def test_no_gpu_is_said(monkeypatch):
    assert choose_device("cpu") == torch.device("cpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    assert choose_device("auto", 0, 2) == torch.device("cpu")
    with pytest.raises(InputError, match=r"device: cuda: expected a GPU for each process .* found 1 for 2"):
        choose_device("cuda", 0, 2)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert choose_device("auto") == torch.device("cpu")
    with pytest.raises(InputError, match="found 0 for 1"):
        choose_device("cuda")
