"""Intrinsic layers of a picture: what its light is made of (RGCA Figure 3)."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import accumulate

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.layers import Layers
from pipeline.avatar.appearance.lobes import SMALLEST_ALPHA
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.model import Avatar
from pipeline.metrics.comparison import preview_srgb
from pipeline.rendering.splat_types import CameraView

DARK = 1e-12
"""Radiance below which light that nothing hides is none: there is no share of it to lose."""


@dataclass(frozen=True)
class IntrinsicLayers:
    """Images of one camera; None for what an avatar does not have.

    The picture is (diffuse + specular) shadow + indirect. Where shadows are traced, those of `diffuse` and `specular`
    are in them already, and `shadow` only shows them.

    Attributes:
        albedo, roughness, visibility, shadow: averages over what each pixel shows, 0 beside the subject.
        normal: unit normals for shading, in the world; 0 beside the subject.
        diffuse, specular, indirect: linear RGB over black.
        alpha: coverage.
        depth: of what is seen, metres, not divided by less than SMALLEST_ALPHA.
    """

    albedo: Float[Tensor, "h w 3"]
    normal: Float[Tensor, "h w 3"]
    diffuse: Float[Tensor, "h w 3"]
    specular: Float[Tensor, "h w 3"]
    alpha: Float[Tensor, "h w 1"]
    depth: Float[Tensor, "h w 1"]
    roughness: Float[Tensor, "h w 1"] | None = None
    visibility: Float[Tensor, "h w 1"] | None = None
    shadow: Float[Tensor, "h w 1"] | None = None
    indirect: Float[Tensor, "h w 3"] | None = None

    def named(self) -> dict[str, Tensor]:
        """The layers that there are."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: layer for name, layer in own.items() if layer is not None}


@torch.no_grad()
def intrinsic_layers(avatar: Avatar, frame: PreparedFrame, camera: CameraView) -> IntrinsicLayers:
    """Blend the layers of a prepared frame for one camera."""
    shown, layers = of_texels(avatar, frame, camera.center), avatar.layers(frame, camera.center)
    widths = [values.shape[-1] for values in shown.values()]
    starts = dict(zip(shown, accumulate(widths, initial=0), strict=False))
    colors = [starts[name] for name in ("albedo", "diffuse", "indirect") if name in starts]
    colors += [sum(widths) + first for first in layers.colors()]
    picture = avatar.draw(frame, torch.cat([*shown.values(), layers.stacked()], -1), camera, colors)
    *parts, rest = picture.features.split([*widths, picture.features.shape[-1] - sum(widths)], -1)
    blended = dict(zip(shown, parts, strict=True))

    lit = avatar.shade_pixels(unshadowed(layers.images(rest)), picture, frame, camera)
    specular = lit - blended["diffuse"]
    if layers.indirect is None and "indirect" in blended:  # it was blended with the colour
        specular = specular - blended["indirect"]
    weight = picture.alpha[..., None].clamp_min(SMALLEST_ALPHA)
    for name in ("albedo", "roughness", "visibility", "shadow"):
        if name in blended:
            blended[name] = blended[name] / weight
    blended["normal"] = torch.nn.functional.normalize(blended["normal"], dim=-1)
    depth = picture.depth[..., None] / weight
    return IntrinsicLayers(specular=specular, alpha=picture.alpha[..., None], depth=depth, **blended)


def unshadowed(images: Layers) -> Layers:
    """Layers of the lamps alone."""
    return replace(images, shadow=None, indirect=None)


def of_texels(
    avatar: Avatar, frame: PreparedFrame, center: Float[Tensor, " 3"]
) -> dict[str, Float[Tensor, "texels _"]]:
    """Values of texels as a camera at `center` sees them, without specular light.

    By the names of `IntrinsicLayers`.
    """
    viewed = avatar.viewed(frame, center)
    samples, shading = avatar.samples(frame, viewed), frame.shading
    albedo, (diffuse, indirect) = avatar.albedo, avatar.leaving(frame, center)
    if frame.eyes is not None:
        albedo, diffuse = (avatar.eyes.seen_from(frame, center, color, viewed.eye_gain) for color in (albedo, diffuse))
    mirrors = samples if samples is not None else avatar.built.specular.mirrors(frame, viewed)
    normals = frame.surface.bent_normals if samples is None else samples.normals
    shown = {"albedo": albedo, "normal": normals, "diffuse": diffuse}
    if mirrors is not None:
        shown |= {"roughness": mirrors.roughness[:, None], "visibility": mirrors.visibility[:, None]}
    shadow = traced_shadow(avatar, frame) if shading.shadow is None else shading.shadow
    if shadow is not None:
        shown["shadow"] = shadow[:, None]
    if indirect is not None:
        shown["indirect"] = indirect
    return shown


def traced_shadow(avatar: Avatar, frame: PreparedFrame) -> Float[Tensor, " texels"] | None:
    """Share of each texel's diffuse light that nothing hides; 1 where none would come. None: nothing was traced."""
    incident = frame.incident
    if incident.lights.visibility_bits is None:
        return None
    free = replace(incident, lights=replace(incident.lights, visibility_bits=None))
    sent = avatar.built.diffuse.shade(frame.parameters, frame.surface, free).sum(-1)
    came = avatar.built.diffuse.shade(frame.parameters, frame.surface, incident).sum(-1)
    return torch.where(sent > DARK, came / sent.clamp_min(DARK), torch.ones_like(sent)).clamp(0, 1)


ROUGHNESS_AT_TOP = 0.5
"""Roughness that pictures show as white, radians."""

VISIBILITY_IN_BLACK = 1e-3
"""Visibility that pictures show as black. A lobe of skin has a height of a fiftieth, eyes of up to 1: in equal steps
the skin beside an eye is black."""

SHOWN = ("albedo", "normal", "diffuse", "specular", "roughness", "visibility", "shadow", "indirect")
"""Layers that are pictures, in this order."""


def as_pictures(layers: IntrinsicLayers, camera: CameraView) -> dict[str, Float[np.ndarray, "h w 3"]]:
    """Layers as sRGB pictures in [0, 1] to look at, by title.

    Normals have the camera's axes as colours: red to the right, green up, blue towards it.
    """
    pictures, there = {}, layers.named()
    for name in (name for name in SHOWN if name in there):
        values, title = there[name].cpu().numpy(), name
        if name == "normal":
            title = "normal, as the camera sees it"
            covered = (values != 0).any(-1, keepdims=True)
            values = covered * (0.5 + 0.5 * values @ camera.R.cpu().numpy().T * (1, -1, -1))
        elif name == "visibility":
            title = f"visibility, {VISIBILITY_IN_BLACK:g} to 1, logarithmic"
            decades = np.log10(np.maximum(values, VISIBILITY_IN_BLACK) / VISIBILITY_IN_BLACK)
            values = (decades / -np.log10(VISIBILITY_IN_BLACK)).clip(0, 1).repeat(3, -1)
        elif name in ("roughness", "shadow"):
            top = {"roughness": ROUGHNESS_AT_TOP, "shadow": 1.0}[name]
            title = name if name == "shadow" else f"{name}, 0 to {top:.2g}"
            values = (values / top).clip(0, 1).repeat(3, -1)
        else:
            values = preview_srgb(values)
        pictures[title] = values
    return pictures
