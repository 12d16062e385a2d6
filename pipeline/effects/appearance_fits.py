"""Gains in explaining texels' colours by gloss, and by light that spreads below the surface.

Observed colours are fitted by one albedo per texel times its shading, plus what is under test, by linear least squares.
Residuals count as PSNR counts them: in sRGB, to first order, so squared and weighted by the squared slope of the
transfer curve. What is under test has few coefficients for all texels together; they are found on one half of the
texels and judged on the other, so that nothing gains by fitting noise. A gain is in decibels of that residual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from jaxtyping import Float64, Int64
from scipy.spatial import cKDTree

from pipeline.effects.appearance_columns import gloss_columns, subsurface_columns
from pipeline.effects.seen_texels import SeenTexels
from pipeline.effects.shared_fits import crossed, each, solve_apart, solve_shared
from pipeline.effects.texel_light import TexelLight
from pipeline.lighting.frame_lights import FrameLights
from pipeline.lighting.subsurface import SurfaceSamples
from pipeline.tracking.point_colors import MEDIAN_LENGTH

DARKEST = 0.01
"""Linear value below which the slope of the sRGB curve is taken there: darker pixels are mostly noise."""

TURNS = 4
"""Turns of albedo, light bounced off other texels' albedo, and which observations count: each bounce adds a tenth of
the last, and the rest settles about as fast."""

STRAY_SIGMAS = 8.0
"""Residuals longer than this many robust standard deviations, with or without transport in the fit, are no noise and no
effect of light, which all are well below: three in a hundred on a tracked body, and they would drown the rest."""


@dataclass(frozen=True)
class Gains:
    """Gains on some of the observations.

    Attributes:
        observations: how many.
        gloss_db, transport_db: gain by gloss, and by light from below the surface where there is gloss.
        floor: mean square of what is left with everything.
    """

    observations: int
    gloss_db: float
    transport_db: float
    floor: float


@dataclass(frozen=True)
class Explained:
    """Results of fitting a capture's colours.

    Attributes:
        observations: how many colours were fitted.
        strays: share of them that is left out.
        floor: root mean square residual with everything, in sRGB of full scale 1.
        gloss_db, transport_db: gain by gloss, and by light from below the surface where there is gloss.
        gloss: root mean square of the fitted gloss of each width, in the unit of the floor.
        regions: the same gains, of the texels of each region.
    """

    observations: int
    strays: float
    floor: float
    gloss_db: float
    transport_db: float
    gloss: Float64[np.ndarray, " widths"]
    regions: Mapping[str, Gains] = field(default_factory=dict)


def explain_colors(
    seen: SeenTexels,
    lights: Sequence[FrameLights],
    lit: Sequence[TexelLight],
    rest: SurfaceSamples,
    regions: Mapping[str, Int64[np.ndarray, " _"]] = MappingProxyType({}),
) -> Explained:
    """Fit the colours.

    Args:
        lights, lit: of each of `seen.frames`.
        rest: all texels of the atlas at rest: a bounce comes from the nearest texel that was looked at.
        regions: texels of the parts of the surface that are judged by themselves, too; together they are all.
    """
    parts = {name: np.flatnonzero(np.isin(seen.texels, texels)) for name, texels in regions.items()}
    inside = {name: np.flatnonzero(np.isin(seen.point, part)) for name, part in parts.items()}
    inside = {name: rows for name, rows in inside.items() if len(rows)}
    groups = list(inside.values()) or [np.arange(len(seen.point))]
    direct = np.stack([light.direct for light in lit])
    nearest = np.append(cKDTree(rest.points[seen.texels]).query(rest.points)[1], len(seen.texels))
    spread_in = [part for part in parts.values() if len(part)] or [np.arange(len(seen.texels))]
    transport = subsurface_columns(seen, lit, rest, spread_in)
    gloss, kept = gloss_columns(seen, lights, lit), np.ones(len(seen.point))
    shading = direct
    for _ in range(TURNS):
        sent = np.pi * fit_albedo(seen, shading, kept) * direct
        shading = direct + np.stack([mean_sent(sent[f], nearest[light.hits]) for f, light in enumerate(lit)])
        albedo, shaded = fit_albedo(seen, shading, kept)[seen.point], shading[seen.frame, seen.point]
        fit = AlbedoFit(shaded, srgb_slope(albedo * shaded), kept, seen.point, len(seen.texels))
        target = fit.residual(seen.color[:, None])
        strengths = each(groups, solve_shared, target, fit.residual(gloss))
        columns = np.concatenate([(gloss * strengths).sum(1)[:, None], transport * albedo[:, None]], 1)
        # What is a stray with and without transport under test: neither side may choose what it is judged by.
        judged = []
        for some in (columns[:, :1], columns):
            found = each(groups, solve_apart, target, fit.residual(some))
            left = fit.residual((seen.color - (some * found).sum(1))[:, None], everywhere=True)
            judged.append(without_strays(left[:, 0]))
        kept = judged[0] * judged[1]

    shiny, beyond = fit.residual(gloss), fit.residual(transport * albedo[:, None])
    whole = gains(target, shiny, beyond, seen.point)
    share = max(float(fit.kept.mean()), np.finfo(float).tiny)
    weighed = (fit.kept[:, None] * fit.slope)[:, None] * gloss * strengths
    return Explained(
        len(seen.point), 1 - share, float(np.sqrt(whole.floor / share)), whole.gloss_db, whole.transport_db,
        np.sqrt((weighed**2).mean((0, 2)) / share),
        {name: gains(target[at], shiny[at], beyond[at], seen.point[at]) for name, at in inside.items()},
    )  # fmt: skip


def gains(
    target: Float64[np.ndarray, "n 1 3"],
    gloss: Float64[np.ndarray, "n widths 3"],
    transport: Float64[np.ndarray, "n spreads 3"],
    point: Int64[np.ndarray, " n"],
) -> Gains:
    """Gains on some observations, of what an albedo per texel leaves of them and of all columns."""
    columns = np.concatenate([(gloss * solve_shared(target, gloss)).sum(1)[:, None], transport], 1)
    matte = float((target**2).mean())
    shiny = crossed(target, gloss, point, solve_shared)
    plain = crossed(target, columns[:, :1], point, solve_apart)
    learned = crossed(target, columns, point, solve_apart)
    return Gains(len(point), decibels(matte, shiny), decibels(plain, learned), min(learned, plain))


def without_strays(left: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    """Weight of observations: 0 for strays, else 1.

    Strays are not what they are taken for: a wrong pose, a neighbour, no subject.
    """
    length = np.linalg.norm(left, axis=1)
    return (length <= STRAY_SIGMAS / MEDIAN_LENGTH * np.median(length)).astype(np.float64)


def decibels(without: float, with_it: float) -> float:
    """Gain in PSNR of one mean square error over another; 0 where there is nothing to gain on."""
    return float(10 * np.log10(without / with_it)) if without > 0 and with_it > 0 else 0.0


def mean_sent(sent: Float64[np.ndarray, "some 3"], hits: Int64[np.ndarray, "P rays"]) -> Float64[np.ndarray, "P 3"]:
    """Irradiance from what cosine-spread rays hit, each sending `sent` / pi alike to all sides."""
    padded = np.concatenate([sent, np.zeros((1, 3))])
    return padded[hits].mean(1) if hits.size else np.zeros((len(hits), 3))


def fit_albedo(
    seen: SeenTexels, shading: Float64[np.ndarray, "F P 3"], weight: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "P 3"]:
    """Albedo of each texel over pi: at most white, 0 where not seen or not lit."""
    shaded, albedo = shading[seen.frame, seen.point], np.zeros((len(seen.texels), 3))
    for c in range(3):
        dot, norm = (
            np.bincount(seen.point, x, len(albedo)) for x in (shaded[:, c] * seen.color[:, c], shaded[:, c] ** 2)
        )
        albedo[:, c] = np.divide(dot, norm, out=np.zeros_like(dot), where=norm > 0)
    return albedo.clip(0, 1 / np.pi)


def srgb_slope(linear: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Derivative of the sRGB transfer curve, IEC 61966-2-1."""
    return 1.055 / 2.4 * np.clip(linear, DARKEST, 1.0) ** (1 / 2.4 - 1)


@dataclass(frozen=True)
class AlbedoFit:
    """Weighted columns less what one albedo per texel explains of them.

    Attributes:
        shaded: what an albedo of 1 would show.
        slope: weight of each number.
        kept: 1 for observations that count, else 0.
        point: texel of each row.
    """

    shaded: Float64[np.ndarray, "n 3"]
    slope: Float64[np.ndarray, "n 3"]
    kept: Float64[np.ndarray, " n"]
    point: Int64[np.ndarray, " n"]
    points: int

    def residual(self, columns: Float64[np.ndarray, "n k 3"], everywhere: bool = False) -> Float64[np.ndarray, "n k 3"]:
        """Columns times the slope, less what one albedo per texel explains of them.

        The albedo is fitted where observations count; the result is 0 where they do not, unless `everywhere`.
        """
        unit, rest = self.slope * self.shaded, self.slope[:, None] * columns
        for c in range(3):
            norm = np.bincount(self.point, self.kept * unit[:, c] ** 2, self.points)
            for k in range(columns.shape[1]):
                dot = np.bincount(self.point, self.kept * unit[:, c] * rest[:, k, c], self.points)
                share = np.divide(dot, norm, out=np.zeros_like(dot), where=norm > 0)
                rest[:, k, c] -= share[self.point] * unit[:, c]
        return rest if everywhere else rest * self.kept[:, None, None]
