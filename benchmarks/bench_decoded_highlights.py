"""Share of highlights that a decoder's map cannot hold, by texels along its side (rows EyeNeRF and Linear of RGCA).

    python -m benchmarks.bench_decoded_highlights --results results/subjectB

Convolutional decoders give maps in the head's frame, drawn bilinearly at the atlas' texels. Here the highlights
themselves, of GGX on the template at rest, are put on such maps by least squares, lamp by lamp, over the texels that
face the camera: what is left is lost whatever a network learns. Beside it, the band limit: the same highlights through
harmonics of degree 8 in each texel's tangent frame, fitted over drawn lights.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import lsqr

from docs.generate.markdown import table
from pipeline.avatar.networks.decoders import bilinear
from pipeline.avatar.texels.posed_texels import PosedTexels, pose_texels
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.lighting.environment_sh import even_directions, spherical_harmonics
from pipeline.lighting.lobes import unit

SIDES = (16, 32, 64, 128)
CAMERA_M = torch.tensor([0.3, 0.1, 1.2])
LAMPS = 24
DRAWN = 2000
"""Lights that the band limit is fitted over."""

STEPS = 60
"""Of least squares; the residual falls by less than a percent after."""


def ggx(to_light: torch.Tensor, to_camera: torch.Tensor, alpha: float) -> torch.Tensor:
    """D F of a dielectric in tangent frames, times the light's cosine over that of the view: what a lamp's highlight
    looks like, but for masking."""
    half = unit(to_light + to_camera)
    spread = alpha**2 / (np.pi * (half[..., 2] ** 2 * (alpha**2 - 1) + 1) ** 2)
    fresnel = 0.04 + 0.96 * (1 - (half * to_camera).sum(-1).clamp(0, 1)) ** 5
    lit = (to_light[..., 2] > 0) & (to_camera[..., 2] > 0.1)
    return lit * spread * fresnel / (4 * to_camera[..., 2].clamp_min(0.1))


def lost_on_map(atlas: Atlas, posed: PosedTexels, side: int, alpha: float) -> float:
    """Share of the squares that is left of all lamps together."""
    nearest, weights = bilinear(atlas, side)
    rows = np.repeat(np.arange(len(nearest)), 4)
    drawn = csr_matrix((weights.ravel(), (rows, nearest.ravel())), (len(nearest), side**2))
    to_camera = (posed.tangent_frames.mT @ unit(CAMERA_M - posed.points)[..., None])[..., 0]
    seen, left, whole = (to_camera[:, 2] > 0.1).numpy(), 0.0, 0.0
    for lamp in torch.as_tensor(even_directions(LAMPS), dtype=torch.float32):
        to_light = (posed.tangent_frames.mT @ unit(1.3 * lamp - posed.points)[..., None])[..., 0]
        wanted = ggx(to_light, to_camera, alpha).numpy()[seen].astype(np.float64)
        found = lsqr(drawn[seen], wanted, iter_lim=STEPS)
        left, whole = left + found[3] ** 2, whole + (wanted**2).sum()
    return left / whole


def lost_to_band_limit(posed: PosedTexels, alpha: float) -> float:
    """The same of harmonics of degree 8 for each view, over lights from all sides."""
    lights = torch.as_tensor(even_directions(DRAWN), dtype=torch.float32)
    harmonics = spherical_harmonics(lights)
    to_camera = (posed.tangent_frames.mT @ unit(CAMERA_M - posed.points)[..., None])[..., 0]
    left = whole = 0.0
    for view in to_camera[to_camera[:, 2] > 0.1][:: len(to_camera) // 100]:
        wanted = ggx(lights, view.expand_as(lights), alpha)
        fitted = harmonics @ torch.linalg.lstsq(harmonics, wanted[:, None]).solution
        left, whole = left + float((fitted[:, 0] - wanted).square().sum()), whole + float(wanted.square().sum())
    return left / whole


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT of a head")
    parser.add_argument("--alpha", type=float, default=0.3, help="GGX width of the highlights")
    options = parser.parse_args()
    atlas = read_atlas(options.results / "atlas.safetensors")
    posed = pose_texels(atlas, atlas.rest_vertices)
    rows = [
        [f"map of {side} x {side}", f"{100 * lost_on_map(atlas, posed, side, options.alpha):.0f}"] for side in SIDES
    ]
    rows.append(["degree 8, at each texel", f"{100 * lost_to_band_limit(posed, options.alpha):.0f}"])
    print(table(("highlights through", "squares lost, %"), rows))


if __name__ == "__main__":
    main()
