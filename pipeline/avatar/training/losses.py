"""Terms of the training loss (RFGCA 17, 18 and Appendix B; RGCA 11-15). Each is a small function of tensors."""

from __future__ import annotations

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.lobes import SMALLEST_ALPHA
from pipeline.avatar.appearance.penalties import negative, outside, outside_as_printed, total_variation
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.model import Avatar, Picture
from pipeline.avatar.training.head_losses import structural_dissimilarity
from pipeline.avatar.training.shape_losses import shape_terms
from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.training_losses import Edges, LossMean, LossSpace
from pipeline.geometry.texels import HAIR
from pipeline.lighting.lobes import unit
from pipeline.metrics.images import LPIPS_SMALLEST_SIDE
from pipeline.metrics.lpips import Lpips, open_lpips
from pipeline.metrics.shift_tolerant_lpips import open_st_lpips
from pipeline.rendering.splat_types import CameraView

SMOOTH = ("albedo", "normal_offset", "log_gloss", "log_ggx_width")
"""Parameters that hardly change from a texel to the next, unless pictures say so."""


def per_pixel(summed: Float[Tensor, ""], mask: Float[Tensor, "h w"], mean: LossMean) -> Float[Tensor, ""]:
    """A sum over a picture, by its subject's pixels or by all of the crop's.

    By the subject's, the width of the crop's margin does not change the balance with other terms.
    """
    return summed / (mask.numel() if mean == "picture" else mask.sum().clamp_min(1))


def photometric(
    rgb: Float[Tensor, "h w 3"], captured: Float[Tensor, "h w 3"], mask: Float[Tensor, "h w"], edges: Edges,
    space: LossSpace = "srgb", mean: LossMean = "subject",
) -> Float[Tensor, ""]:  # fmt: skip
    """L1 against the capture over black (RFGCA 17, RGCA 12).

    By default in sRGB, where the result is scored.

    A mask of zeros and ones cuts through pixels that the subject covers in part. Compared with black, those beyond its
    edge would teach the avatar to end half a pixel inside its outline, so `edges` says what to do with them.
    """
    beside = widest(mask) - mask
    wanted = captured * (mask if edges == "ignored" else mask + beside)[..., None]
    if space == "srgb":
        rgb, wanted = srgb_from_linear(rgb), srgb_from_linear(wanted)
    difference = (rgb - wanted).abs()
    if edges == "ignored":
        difference = difference * (1 - beside)[..., None]
    if mean == "picture":
        return difference.mean()
    return difference.sum() / (3 * mask.sum()).clamp_min(1)


def widest(mask: Float[Tensor, "h w"]) -> Float[Tensor, "h w"]:
    """The largest value among each pixel and its eight neighbours."""
    padded = torch.nn.functional.pad(mask[None, None], (1, 1, 1, 1), mode="replicate")
    return torch.nn.functional.max_pool2d(padded, 3, 1)[0, 0]


def silhouette(
    alpha: Float[Tensor, "h w"], mask: Float[Tensor, "h w"], mean: LossMean = "subject"
) -> Float[Tensor, ""]:
    """L1 between alpha and mask per pixel. Pixels that touch the mask's edge are left out (Appendix B)."""
    high, low = widest(mask), -widest(-mask)
    inside = (high == low).to(mask.dtype)
    return per_pixel(((alpha - mask).abs() * inside).sum(), mask, mean)


def alpha_sparsity(
    alpha: Float[Tensor, "h w"], mask: Float[Tensor, "h w"], mean: LossMean = "subject",
    hair: Float[Tensor, "h w"] | None = None,
) -> Float[Tensor, ""]:  # fmt: skip
    """L1 between alpha and the nearer of 0 and 1, per pixel (Appendix B).

    Pixels that touch the mask's edge are left out: the subject covers them in part. So do hairs.

    Args:
        hair: share of what each pixel shows that is hair, which does not count; none if the template labels none.
    """
    inside = (widest(mask) == -widest(-mask)).to(mask.dtype)
    inside = inside if hair is None else inside * (1 - hair)
    return per_pixel((torch.minimum(alpha, 1 - alpha).abs() * inside).sum(), mask, mean)


@torch.no_grad()
def shown_hair(avatar: Avatar, frame: PreparedFrame, camera: CameraView) -> Float[Tensor, "h w"] | None:
    """Share of each pixel that shows what the template labels as hair; None if it labels none."""
    if not len(avatar.atlas.regions.get(HAIR, ())):
        return None
    share = torch.as_tensor(avatar.atlas.texels_of(HAIR)).to(avatar.albedo)[:, None]
    blended = avatar.draw(frame, share.expand(-1, 3), camera)
    return (blended.features[..., 0] / blended.alpha.clamp_min(SMALLEST_ALPHA)).clamp(0, 1)


def normal_orient(normal: Float[Tensor, "h w 3"], alpha: Float[Tensor, "h w"], camera: CameraView) -> Float[Tensor, ""]:
    """Mean over covered pixels of max(0, -n . w_o)^2.

    Blended normals that face away from the camera (Appendix B).

    With w_o from the surface to the camera, as elsewhere in the paper, B.3 as printed, max(0, n . w_o)^2, would punish
    the normals that can be seen.
    """
    row, column = torch.nonzero(alpha.detach() > SMALLEST_ALPHA, as_tuple=True)
    K = camera.K
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    toward = -unit(torch.stack([x, y, torch.ones_like(x)], -1) @ camera.R)
    away = torch.relu(-(unit(normal[row, column]) * toward).sum(-1))
    return away.square().sum() / max(1, len(row))


def lpips_loss(
    lpips: Lpips, rgb: Float[Tensor, "h w 3"], captured: Float[Tensor, "h w 3"], mask: Float[Tensor, "h w"]
) -> Float[Tensor, ""]:
    """LPIPS in sRGB between the picture and the capture over black (RFGCA 17). Small ones are padded with black."""
    height, width = mask.shape
    pad = (0, 0, 0, max(0, LPIPS_SMALLEST_SIDE - width), 0, max(0, LPIPS_SMALLEST_SIDE - height))
    pictures = [
        torch.nn.functional.pad(srgb_from_linear(linear.clamp(0, 1)), pad).permute(2, 0, 1)[None]
        for linear in (rgb, captured * mask[..., None])
    ]
    return lpips.to(rgb.device)(*pictures)[0]


@cache
def open_lpips_loss(net: str, backbone: str) -> Lpips:
    """LPIPS with the weights of a file, read once.

    Raises:
        InputError: if it is not there, or not the published one.
    """
    lpips, why = open_lpips(net, backbone)
    if lpips is None:
        raise InputError(f"lpips_backbone: expected the weights of {net}, found {why}")
    return lpips


def dropped_terms(weights: TrainAvatar) -> dict[str, str]:
    """Terms of the loss that have a weight and are left out all the same, with the reason."""
    if weights.weight_lpips and not weights.lpips_backbone:
        return {"lpips": f"weight_lpips is {weights.weight_lpips:g}, but lpips_backbone names no file"}
    return {}


def reconstruction(
    picture: Picture, captured: Float[Tensor, "h w 3"], mask: Float[Tensor, "h w"], camera: CameraView,
    weights: TrainAvatar, hair: Float[Tensor, "h w"] | None = None,
) -> dict[str, Tensor]:  # fmt: skip
    """All terms that look at one picture of `Avatar.view`, weighted. Those of weight 0 are not computed."""
    rgb, alpha, mean = picture.rgb, picture.alpha, weights.loss_mean
    l1 = photometric(rgb, captured, mask, weights.edges, weights.loss_space, mean)
    terms = {
        "photometric": weights.weight_photometric * l1,
        "silhouette": weights.weight_mask * silhouette(alpha, mask, mean),
    }
    if weights.weight_ssim:
        terms["ssim"] = weights.weight_ssim * structural_dissimilarity(rgb, captured, mask, weights.loss_space, mean)
    if weights.weight_alpha_sparsity:
        terms["alpha_sparsity"] = weights.weight_alpha_sparsity * alpha_sparsity(alpha, mask, mean, hair)
    if weights.weight_normal_orient and picture.normal is not None:
        terms["normal_orient"] = weights.weight_normal_orient * normal_orient(picture.normal, alpha, camera)
    if picture.eye_visibility is not None:
        terms["eye_visibility"] = weights.weight_eye_visibility * (1 - picture.eye_visibility).square().mean()
    if weights.weight_lpips and weights.lpips_backbone:
        lpips = open_lpips_loss(weights.lpips_net, weights.lpips_backbone)
        terms["lpips"] = weights.weight_lpips * lpips_loss(lpips, rgb, captured, mask)
    if weights.weight_st_lpips:
        terms["st_lpips"] = weights.weight_st_lpips * lpips_loss(open_st_lpips(), rgb, captured, mask)
    return terms


def normal_weight(weights: TrainAvatar, step: int) -> float:
    """Weight of the squared normal offset after `step` steps. Falls to zero in a straight line (Appendix B)."""
    if not weights.normal_steps:
        return weights.weight_normal
    return weights.weight_normal * max(0.0, 1 - step / weights.normal_steps)


def regularization(
    avatar: Avatar, frame: PreparedFrame, weights: TrainAvatar, step: int = 0, images: int = 1
) -> dict[str, Tensor]:
    """All terms that look at the parameters of a prepared frame, weighted.

    `images`: number of those that the avatar is trained on. Reconstruction is a mean over them, so a prior on
    parameters that all share (the smoothness) is divided by their number.
    """
    of_albedo = weights.weight_negative_albedo
    dark = negative(frame.shading.diffuse)
    if of_albedo is None:
        dark_terms = weights.weight_negative * (dark + negative(avatar.albedo))
    else:
        dark_terms = weights.weight_negative * dark + of_albedo * negative(avatar.albedo)
    terms = {
        **shape_terms(avatar, frame, weights),
        "albedo": weights.weight_albedo * avatar.albedo.abs().mean(),
        "negative": dark_terms,
    }
    if weights.weight_smooth:
        smooth = [total_variation(getattr(avatar, name), avatar.pairs) for name in SMOOTH if hasattr(avatar, name)]
        terms["smooth"] = weights.weight_smooth / images * torch.stack(smooth).sum()
    of_roughness = weights.weight_scale if weights.weight_roughness is None else weights.weight_roughness
    for part in (avatar.built.diffuse, avatar.built.normals, avatar.built.specular):
        if (bounded := part.bounded(frame.parameters)) is not None:
            beyond = outside if weights.bound == "log" else outside_as_printed
            terms["roughness"] = of_roughness * beyond(*bounded)
        for name, term in part.penalties(frame.parameters).items():
            weight = normal_weight(weights, step) if name == "normal" else getattr(weights, f"weight_{name}")
            terms[name] = weight * term
    if avatar.eyes is not None:
        # What is decoded for each camera is a term of its picture.
        shared = getattr(avatar, "visibility", None) if avatar.eyes.decoders is None else None
        found = avatar.eyes.losses(frame.gaussians, shared, weights.bound)
        terms |= {name: getattr(weights, f"weight_{name}") * term for name, term in found.items()}
    return terms
