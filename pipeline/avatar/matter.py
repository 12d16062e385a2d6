"""Albedo and gloss of an avatar's texels, which no pose and no light changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from pipeline.avatar.appearance.ggx_gloss import GgxGloss
from pipeline.avatar.model import Avatar


@dataclass(frozen=True)
class Matter:
    """Numbers of a dielectric with GGX microfacets, NumPy.

    Attributes:
        albedo: linear RGB.
        width: alpha of GGX.
        gloss: factor on what a dielectric reflects; 0 for avatars without such a lobe.
        coat: share of grazing light that it keeps back from what is matte.
    """

    albedo: Float[np.ndarray, "texels 3"]
    width: Float[np.ndarray, " texels"]
    gloss: Float[np.ndarray, " texels"]
    coat: float = 0.0


@torch.no_grad()
def read_matter(avatar: Avatar) -> Matter:
    """Matter of an avatar."""
    albedo, specular = avatar.albedo.cpu().numpy(), avatar.built.specular
    if not isinstance(specular, GgxGloss):
        return Matter(albedo, np.ones(len(albedo), np.float32), np.zeros(len(albedo), np.float32))
    width, gloss = avatar.log_ggx_width.exp().cpu().numpy(), specular.scale().cpu().numpy()
    return Matter(albedo, width, gloss, float(avatar.coat.bounded) if avatar.spec.coated else 0.0)
