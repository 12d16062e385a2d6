"""Pixels in which a camera sees an eye past the skin, as rays in the head's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int64

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.spread import evenly
from pipeline.geometry.cameras import Camera
from pipeline.geometry.depth_maps import LEAST_COSINE

MOST_PIXELS = 200
"""Pixels of an eye that one picture gives, evenly chosen: more of them repeat what their neighbours say."""

MARGIN_PX = 2
"""Pixels around one that show an eye, in which no skin may be nearer: lids of a template are a pixel off."""

LEAST_PIXELS = 12
"""Fewer pixels than an iris of four pixels' width has show no iris."""


@dataclass(frozen=True)
class EyePixels:
    """Pixels of one eye in some pictures of one frame.

    Attributes:
        origins: where the rays of the pixels start, metres, relative to the eye's centre.
        directions: of length one; both in axes of the head's frame.
        colors: linear RGB as recorded.
        view: number of the picture that a pixel is of, in ascending order.
    """

    origins: Float64[np.ndarray, "n 3"]
    directions: Float64[np.ndarray, "n 3"]
    colors: Float64[np.ndarray, "n 3"]
    view: Int64[np.ndarray, " n"]

    def __len__(self) -> int:
        return len(self.view)


def nothing() -> EyePixels:
    """No pixel at all."""
    return EyePixels(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64))


def join_views(views: Sequence[EyePixels]) -> EyePixels:
    """Join the pixels of several pictures of one frame, numbered from 0.

    Pictures with too few are left out.
    """
    kept = [pixels for pixels in views if len(pixels) >= LEAST_PIXELS]
    if not kept:
        return nothing()
    names = ("origins", "directions", "colors")
    joined = {name: np.concatenate([getattr(pixels, name) for pixels in kept]) for name in names}
    return EyePixels(**joined, view=np.repeat(np.arange(len(kept)), [len(pixels) for pixels in kept]))


def seen_pixels(
    camera: Camera, image: Float32[np.ndarray, "h w 3"], skin_depth: Float32[np.ndarray, "h w"],
    head: Float64[np.ndarray, "3 4"], center: Float64[np.ndarray, "3"], radius: float,
) -> EyePixels:  # fmt: skip
    """Pixels of one picture whose rays meet an eyeball before they meet skin.

    Within `MARGIN_PX` of them no skin is nearer either: a pixel at a lid shows some of it. Pixels that see the eyeball
    at a grazing angle, or are no finite number, are left out.

    Args:
        image: linear, as `camera` recorded it.
        skin_depth: of the posed template without its eyes, by `draw_depth`.
        head: [R | t], head from world.
        center, radius: of the eyeball in the head's frame, metres.
    """
    R, t = head[:, :3], head[:, 3]
    place = (center - t) @ R
    middle, depth = camera.project(place[None])
    if not (depth[0] > radius and camera.sees(place[None])[0]):
        return nothing()
    around = range(-MARGIN_PX, MARGIN_PX + 1)
    reach = radius / depth[0] * np.sqrt(camera.K[0, 0] * camera.K[1, 1]) + 1
    last = np.array([camera.width, camera.height]) - 1 - MARGIN_PX
    low = np.maximum(np.floor(middle[0] - reach), MARGIN_PX).astype(np.int64)
    high = np.minimum(np.ceil(middle[0] + reach), last).astype(np.int64)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)))
    if not len(column):
        return nothing()
    ways = camera.ray_directions(np.stack([column, row], 1) + PIXEL_CENTER)
    origin = camera.center - place
    along, cosine = meet_sphere(np.broadcast_to(origin, ways.shape), ways, radius)
    hits = camera.center + along[:, None] * ways
    skin = np.stack([skin_depth[row + down, column + right] for down in around for right in around]).min(0)
    ahead = (hits @ camera.R.T + camera.t)[:, 2]
    colors = image[row, column].astype(np.float64)
    seen = np.flatnonzero((cosine > LEAST_COSINE) & (ahead < skin) & np.isfinite(colors).all(1))
    seen = np.array(evenly(seen.tolist(), MOST_PIXELS), np.int64)
    origins = np.repeat((R @ origin)[None], len(seen), 0)
    return EyePixels(origins, ways[seen] @ R.T, colors[seen], np.zeros(len(seen), np.int64))


def meet_sphere(
    origins: Float64[np.ndarray, "*n 3"], directions: Float64[np.ndarray, "*#n 3"], radius: float
) -> tuple[Float64[np.ndarray, "*n"], Float64[np.ndarray, "*n"]]:
    """Distance at which rays first meet a sphere about the origin, and the cosine there.

    A ray that passes it has no distance (NaN) and a cosine of -1.
    """
    along = (origins * directions).sum(-1)
    square = radius**2 - (origins * origins).sum(-1) + along**2
    root = np.sqrt(np.maximum(square, 0.0))
    return np.where(square > 0, -along - root, np.nan), np.where(square > 0, root / radius, -1.0)
