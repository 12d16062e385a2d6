"""Albedo that training images show, by a round of the image space reconstruction algorithm.

Daube-Witherspoon and Muehllehner (1986). A picture is J rho + s, linear in the texels' albedo rho but for what bounces,
and each texel's albedo is multiplied by

    J^T y / J^T (J rho + s)

over the captured pictures y: what its pixels show, over what they show as drawn. How splatting blends texels, and how
light falls on them, is all in J, whose transpose is one backward pass. Trainings start from it, and refine lights
between two rounds. Where light also spreads below the surface, colours tell the two apart less well than training does:
on a body of wax grey was the better start.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.model import Avatar
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.training.checkpoint import camera_view
from pipeline.avatar.training.read_ahead import ReadAhead, Rounds
from pipeline.avatar.training.step_loss import Portion, drawn_expression
from pipeline.avatar.training.training import Training
from pipeline.config.train_avatar import TrainAvatar
from pipeline.rendering.splat_conventions import NotFinite

MOST_IMAGES = 24
"""Training images that are looked at, those of the first steps. On a body of 8 cameras twice as many tell no more."""

PRIOR_SHARE = 0.02
"""Weight of what all texels show together, of a texel's mean weight: it decides where next to nothing is seen."""


def tells_albedo(spec: AvatarSpec) -> bool:
    """True if colours tell the albedo: Lambert and GGX are all that is built."""
    return spec.shading == "microfacet"


def starts_from_images(settings: TrainAvatar, spec: AvatarSpec) -> bool:
    """True if a training starts from the albedo that images show, and not from grey."""
    return settings.albedo_start == "images" or (settings.albedo_start == "auto" and tells_albedo(spec))


def first_portions(rounds: Rounds, ahead: ReadAhead) -> Iterator[list[Portion]]:
    """Portions of the rounds that are looked at; the next round is read meanwhile."""
    settings = rounds.settings
    step_images, together = settings.cameras_per_step * settings.frames_per_step, settings.steps_together
    for first in range(0, min(settings.steps, -(-MOST_IMAGES // step_images)), together):
        portions = ahead.portions(rounds.batches(first))
        ahead.start(rounds.batches(first + together))
        yield portions


def isra_round(training: Training, rounds: Iterable[Sequence[Portion]]) -> None:
    """Move the albedo to what the images of some rounds show, the same in all processes.

    Frames of which nothing finite can be drawn tell nothing: the first step says what is wrong with them.
    """
    avatar, places = training.avatar, training.settings.steps_together * training.settings.frames_per_step
    sums = avatar.albedo.new_zeros(places, 2, *avatar.albedo.shape)
    with only_albedo_learned(avatar):
        for number, portions in enumerate(rounds):
            for place, portion in enumerate(portions):
                if portion.mine:
                    drawn = drawn_expression(avatar, training.subject, number * places + place)
                    add_back_projections(avatar, portion, drawn, sums[place])
    training.processes.sum_in_place(sums)
    with torch.no_grad():
        avatar.albedo.mul_(isra_factors(*sums.sum(0)))


@contextmanager
def only_albedo_learned(avatar: Avatar) -> Iterator[None]:
    """Gradients of nothing but the albedo meanwhile: others would be thrown away."""
    learned = [each for each in avatar.parameters() if each.requires_grad]
    for each in learned:
        each.requires_grad_(each is avatar.albedo)
    try:
        yield
    finally:
        for each in learned:
            each.requires_grad_(True)


def add_back_projections(
    avatar: Avatar, portion: Portion, expression: dict[str, Tensor], sums: Float[Tensor, "2 texels 3"]
) -> None:
    """Add J^T y and J^T (J rho + s) of a frame's images.

    Pixels count as far as the subject covers them.
    """
    try:
        frame = avatar.prepare(portion.inputs, **expression)
        for image in portion.images:
            captured, mask = (torch.tensor(array, device=sums.device) for array in (image.image, image.mask))
            rgb = avatar.view(frame, camera_view(image, sums.device)).rgb
            for row, shown in enumerate((captured, rgb.detach())):
                weighed = shown * mask[..., None]
                sums[row] += torch.autograd.grad(rgb, avatar.albedo, weighed, retain_graph=True)[0]
    except NotFinite:
        return


def isra_factors(shown: Float[Tensor, "texels 3"], drawn: Float[Tensor, "texels 3"]) -> Float[Tensor, "texels 3"]:
    """Factors on the albedo: J^T y over J^T (J rho + s).

    Where next to nothing is seen, that of all texels together; 1 if no texel is seen in any light.
    """
    prior = PRIOR_SHARE * drawn.mean(0)
    together = torch.where(prior > 0, shown.mean(0) / drawn.mean(0), 1.0)
    found = (shown + prior * together) / (drawn + prior)
    return torch.where(prior > 0, found, 1.0)
