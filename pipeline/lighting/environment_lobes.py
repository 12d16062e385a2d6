"""Specular light of an environment map by one look-up per pixel.

RFGCA 12-13; RGCA 8, after Kautz et al. 2000.

The specular lobe of every mirror direction q and roughness sigma is summed over the map beforehand,

    P_sigma(q) = sum_j E_j G(w_j; q, sigma)     (E_j: radiance times solid angle of a pixel, G: RFGCA 13)

for a ladder of roughnesses, as panoramas whose resolution falls as the lobe widens: a mip chain whose filter is the
lobe. A look-up is bicubic in q, and linear in 1 / sigma^2 between two rungs, which keeps it linear in the light and
makes the peak of a lobe exact for any sigma. What is kept and interpolated is P / sigma, nearly the mean radiance under
the lobe, which hardly changes along the ladder.

Against the sum over all pixels, a single bright pixel (the worst map there is) is off by at most `LOOKUP_BOUND` of the
lobe's peak; a photographed sky by far less. A lobe narrower than a pixel of the map sees the map's blur: then the
ladder ends at the pixel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64
from scipy.fft import dct
from torch import Tensor

from pipeline.lighting.environment import WIDTH_OVER_HEIGHT, Environment
from pipeline.lighting.lobes import LOBE_CONSTANT

ROUGHNESS_RANGE = (0.01, 0.25)
"""The papers' bounds on roughness, radians (RFGCA Appendix B)."""

RUNGS_PER_OCTAVE = 4
"""Neighbouring roughnesses differ by a factor of 2^(1/4)."""

PIXELS_PER_SIGMA = 3.0
"""Of a prefiltered panorama: bicubic interpolation of a Gaussian sampled so is off by 0.4 % of its peak."""

REACH_SIGMAS = 5.0
"""Pixels further from the lobe's centre are left out: exp(-5^2 / 2) = 4e-6 of the peak."""

MARGIN = 2
"""Pixels around a prefiltered panorama, for a cubic's four neighbours."""

LOOKUP_BOUND = 0.01
"""Error of a look-up over the lobe's peak value. Between rungs: (range of 1 / sigma^2)^2 / 8 times the curvature of
t exp(-t angle^2 / 2), at most 0.6 % of the peak for a factor of 2^(1/4); the rest is bicubic interpolation."""


@dataclass(frozen=True)
class LobeLadder:
    """Prefiltered panoramas, sharpest first.

    Attributes:
        sigmas: their roughness, radians, rising.
        panoramas: P / sigma, linear RGB, [3, rows + 4, columns + 4]: two pixels of margin on each side, from across
            the pole or around, so that interpolation needs no special cases.
    """

    sigmas: Float64[np.ndarray, " rungs"]
    panoramas: tuple[Float[Tensor, "3 _ _"], ...]

    def to(self, device: torch.device) -> LobeLadder:
        """The same on another device."""
        return LobeLadder(self.sigmas, tuple(panorama.to(device) for panorama in self.panoramas))

    def look_up(self, centers: Float[Tensor, "n 3"], sigma: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """sum_j E_j G(w_j; q, sigma) for unit mirror directions q. Beyond the ladder its end is taken, scaled."""
        steps = torch.as_tensor(self.sigmas, dtype=sigma.dtype, device=sigma.device) ** -2
        wanted = sigma.clamp(float(self.sigmas[0]), float(self.sigmas[-1])) ** -2
        upper = torch.searchsorted(-steps, -wanted).clamp(1, len(steps) - 1) if len(steps) > 1 else None
        if upper is None:
            return sigma[:, None] * _sample(self.panoramas[0], centers, _catmull_rom)
        share = (wanted - steps[upper]) / (steps[upper - 1] - steps[upper])
        found = torch.zeros_like(centers)
        for rung, panorama in enumerate(self.panoramas):
            weight = torch.where(upper == rung, 1 - share, torch.where(upper == rung + 1, share, 0.0))
            used = torch.nonzero(weight)[:, 0]
            found[used] += weight[used, None] * _sample(panorama, centers[used], _catmull_rom)
        return sigma[:, None] * found


def prefilter(
    environment: Environment, smallest: float = ROUGHNESS_RANGE[0], largest: float = ROUGHNESS_RANGE[1]
) -> LobeLadder:
    """Prefilter a panorama for lobes of roughness `smallest` to `largest`, radians."""
    finest = max(smallest, math.pi / len(environment.radiance))
    rungs = 1 + math.ceil(RUNGS_PER_OCTAVE * math.log2(max(largest / finest, 1)) - 1e-9)
    sigmas = finest * 2 ** (np.arange(rungs) / RUNGS_PER_OCTAVE)
    return LobeLadder(sigmas, tuple(_rung(environment, sigma) for sigma in sigmas))


def _rung(environment: Environment, sigma: float) -> Float[Tensor, "3 _ _"]:
    """Lobes of one roughness. Between two rows they depend on the difference in azimuth only: a circular convolution.
    Its Fourier series also resamples it: a lobe's part beyond a coarser panorama's frequencies is exp(-9^2 / 2)."""
    height, width = environment.radiance.shape[:2]
    rows = max(math.ceil(math.pi * PIXELS_PER_SIGMA / sigma), 8)
    columns = WIDTH_OVER_HEIGHT * rows
    light = np.fft.rfft(environment.radiance * environment.solid_angles()[:, None, None], axis=1)
    around, polar = 2 * np.pi * np.arange(width // 2 + 1) / width, np.pi * (np.arange(height) + 0.5) / height
    series = np.empty((rows, width // 2 + 1, 3), complex)
    for row, center in enumerate(np.pi * (np.arange(rows) + 0.5) / rows):
        near = np.abs(polar - center) < REACH_SIGMAS * sigma
        upright, across = np.cos(center) * np.cos(polar[near]), np.sin(center) * np.sin(polar[near])
        cosine = upright[:, None] + across[:, None] * np.cos(around)
        lobe = np.exp(-0.5 * (np.arccos(np.clip(cosine, -1, 1)) / sigma) ** 2)
        series[row] = np.einsum("im,imc->mc", dct(lobe, type=1, axis=1), light[near])  # of an even function
    # Pixels' centres are half a pixel from the edge, on either grid.
    series *= np.exp(1j * np.pi * np.arange(width // 2 + 1) * (1 / columns - 1 / width))[:, None]
    lobes = np.fft.irfft(series, columns, axis=1) * columns / width
    lobes *= LOBE_CONSTANT / sigma**2  # C / sigma of the lobe, and the sigma that a look-up puts back
    return _with_margin(torch.from_numpy(lobes.astype(np.float32)).permute(2, 0, 1))


def _with_margin(panorama: Float[Tensor, "3 h w"]) -> Float[Tensor, "3 _ _"]:
    """Two more pixels on each side: beyond a pole lies the row at the other side of it, half the way around."""
    across = panorama.roll(panorama.shape[2] // 2, 2)
    tall = torch.cat([across[:, :2].flip(1), panorama, across[:, -2:].flip(1)], 1)
    return torch.cat([tall[:, :, -2:], tall, tall[:, :, :2]], 2)


def _sample(
    panorama: Float[Tensor, "3 _ _"], directions: Float[Tensor, "n 3"], weights: Callable[[Tensor], tuple[Tensor, ...]]
) -> Float[Tensor, "n 3"]:
    """Look-up in a panorama with margin; see `pipeline.lighting.environment` for where a direction lies.

    `weights`: of four neighbours in a row, from how far between the middle two a place is.
    """
    height, width = panorama.shape[1] - 2 * MARGIN, panorama.shape[2] - 2 * MARGIN
    x, y, z = directions.unbind(-1)
    # A pole has every azimuth: any will do, and its slope has to be finite.
    pole = (x == 0) & (z == 0)
    z = torch.where(pole, -torch.ones_like(z), z)
    columns = torch.atan2(x, -z) / (2 * math.pi) % 1 * width + MARGIN - 0.5
    rows = torch.atan2(torch.where(pole, torch.zeros_like(x), torch.hypot(x, z)), y) / math.pi * height + MARGIN - 0.5
    row, column = rows.floor(), columns.floor()
    down, right = weights(rows - row), weights(columns - column)
    found = torch.zeros_like(directions)
    for i in range(4):
        for j in range(4):
            texels = panorama[:, row.long() + i - 1, column.long() + j - 1]
            found += (down[i] * right[j])[:, None] * texels.T
    return found


def _catmull_rom(share: Float[Tensor, " n"]) -> tuple[Tensor, ...]:
    """Weights of four neighbours (Keys 1981, a = -1/2): exact for quadratics, which other values of a are not."""
    t = share
    return (
        ((2 - t) * t - 1) * t / 2, ((3 * t - 5) * t * t + 2) / 2, ((4 - 3 * t) * t + 1) * t / 2, (t - 1) * t * t / 2,
    )  # fmt: skip


def _linear(share: Float[Tensor, " n"]) -> tuple[Tensor, ...]:
    """Weights of four neighbours, of which two count."""
    return torch.zeros_like(share), 1 - share, share, torch.zeros_like(share)


def sample_environment(environment: Environment, directions: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, "n 3"]:
    """Radiance of the map itself along unit directions, what a background shows. Bilinear: lamps get no dark rims."""
    panorama = _with_margin(torch.from_numpy(environment.radiance).permute(2, 0, 1))
    return _sample(panorama, torch.from_numpy(directions), _linear).numpy()
