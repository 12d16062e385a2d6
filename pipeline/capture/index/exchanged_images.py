"""Images of cameras that were exchanged or turned: they fit other masks than their own.

A few frames tell. Their images and masks are reduced as the index decodes them for its checks, so that none is decoded
a second time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Float32, Float64, Shaped, UInt8

from pipeline.base.errors import Complaints
from pipeline.base.verdicts import Verdict
from pipeline.capture.images import ImageSource, read_mask

FRAMES = 8
"""Frames that are looked at, evenly chosen: enough for a median that dark or empty ones do not move."""

SIDE_PX = 32
"""Side to which images and masks are reduced: a subject's outline is what is compared, and not its texture."""

CLEAR = 0.5
"""Correlation from which an image shows the subject of a mask at all. Own masks have 0.82 to 0.98 on captures of a
figure, a walker and a head; what has nothing to do with a mask has hardly 0.1."""

MARGIN = 0.05
"""By how much both of two cameras' images have to fit the other's masks better. On those captures they fit the others'
worse by 0.07 at least, between neighbours in a ring of ten round a head; an exchange turns the sign."""

TURNED_MARGIN = 0.15
"""By how much a camera's images have to fit its turned masks better. Those of sound captures do by 0.07 at most (a head
before a bright background, lit from one side), mirrored ones of bodies by 0.24 at least. Heads are more nearly alike
upside down, by 0.1 to 0.3: not all that are turned are told."""


Reduced = Float32[np.ndarray, " pixels"]
"""An image or a mask of `SIDE_PX` pixels a side, row by row."""

NOTHING_REDUCED: Mapping[str, Reduced] = MappingProxyType({})


@dataclass(frozen=True)
class ComparedCameras:
    """Cameras whose images are of one size, and the frames that are looked at."""

    cameras: list[str]
    frames: list[int]
    square: bool


def compared_cameras(images: pd.DataFrame, sizes: pd.DataFrame) -> list[ComparedCameras]:
    """Cameras to compare, and frames in which all of them have a mask.

    Args:
        images: camera, frame and mask_path (null without a mask), one row for each.
        sizes: camera, width and height.
    """
    masked, found = images.loc[images.mask_path.notna(), ["camera", "frame"]], []
    for (width, height), alike in sizes.groupby(["width", "height"]):
        here = masked[masked.camera.isin(alike.camera)]
        cameras, counts = sorted(here.camera.unique()), here.frame.value_counts()
        frames = np.sort(counts.index[counts == len(cameras)].to_numpy(np.int64))
        if len(cameras) < 2 or not len(frames):
            continue
        frames = frames[np.unique(np.linspace(0, len(frames) - 1, min(FRAMES, len(frames))).round().astype(int))]
        found.append(ComparedCameras(cameras, frames.tolist(), width == height))
    return found


@dataclass(frozen=True)
class Compared:
    """Images that are looked at, by camera and frame, and their source."""

    source: ImageSource
    keys: frozenset[tuple[str, int]]

    @classmethod
    def among(cls, images: pd.DataFrame, sizes: pd.DataFrame, source: ImageSource) -> Compared:
        """The images of a table that are looked at; arguments as of `compared_cameras`."""
        chosen = compared_cameras(images, sizes)
        return cls(source, frozenset((c, frame) for each in chosen for c in each.cameras for frame in each.frames))


def complain_of_exchanged(
    images: pd.DataFrame, sizes: pd.DataFrame, source: ImageSource, complaints: Complaints,
    reduced: Mapping[str, Reduced] = NOTHING_REDUCED,
) -> list[Verdict]:  # fmt: skip
    """Complain about cameras whose images were exchanged or turned; needs masks. Returns a verdict on each.

    Good: nothing speaks for another camera's masks, or for turned ones.

    Args:
        images: camera, frame, path and mask_path (null without a mask).
        sizes: camera, width and height.
        source: of the images.
        reduced: images and masks by path, as far as they were reduced before; others are read.
    """
    verdicts = []
    for compared in compared_cameras(images, sizes):
        cameras, frames = compared.cameras, compared.frames
        rows = images[images.camera.isin(cameras) & images.frame.isin(frames)].set_index(["frame", "camera"])
        order = [(frame, camera) for frame in frames for camera in cameras]
        shape = (len(frames), len(cameras), SIDE_PX**2)
        shown = np.stack([_image(source, rows.path[key], key[0], reduced) for key in order]).reshape(shape)
        paths = [rows.mask_path[key] for key in order]
        masks = {path: _mask(source, path, reduced) for path in dict.fromkeys(paths)}  # Which images may share.
        given = np.stack([masks[path] for path in paths]).reshape(shape)
        fits = correlations(shown, given)
        pairs = exchanged(fits)
        in_pairs = {camera for pair in pairs for camera in pair}  # Which may look like the mirror image of the other.
        for i, how, fit in (found for found in turned(shown, given, compared.square) if found[0] not in in_pairs):
            complaints.add(
                "images", cameras[i], expected="the subject where the camera's own masks are",
                found=f"images that fit these masks {how} (correlation {fit:.2f}, as they are {fits[i, i]:.2f})",
                hint="turn the images of this camera back, or its masks",
            )  # fmt: skip
        for i, j in pairs:
            found = f"images that fit the masks of the other (correlation {fits[i, j]:.2f} and {fits[j, i]:.2f}"
            complaints.add(
                "images", f"{cameras[i]}, {cameras[j]}", expected="the subject where the camera's own masks are",
                found=f"{found}, their own {fits[i, i]:.2f} and {fits[j, j]:.2f})",
                hint="exchange the images of the two, or their masks",
            )  # fmt: skip
        said = [f"correlation with its masks {fit:.2f}" for fit in np.diag(fits)]
        verdicts += [Verdict("images", name, "good", why) for name, why in zip(cameras, said, strict=True)]
    return sorted(verdicts, key=lambda verdict: verdict.name)


def correlations(
    shown: Float64[np.ndarray, "frames cameras pixels"], given: Float64[np.ndarray, "frames cameras pixels"]
) -> Float64[np.ndarray, "cameras cameras"]:
    """Correlate every camera's images with every camera's masks; median over frames."""
    return np.median(np.einsum("fip,fjp->fij", _standard(shown), _standard(given)), axis=0)


def exchanged(fits: Float64[np.ndarray, "cameras cameras"]) -> list[tuple[int, int]]:
    """Pairs of cameras whose images both fit the other's masks, and better than their own."""
    gain = fits - np.diag(fits)[:, None]
    mutual, clear = np.minimum(gain, gain.T), np.minimum(fits, fits.T)
    pairs = np.argwhere(np.triu((mutual > MARGIN) & (clear > CLEAR), 1))
    return [(int(i), int(j)) for i, j in pairs]


def turned(
    shown: Float64[np.ndarray, "frames cameras pixels"],
    given: Float64[np.ndarray, "frames cameras pixels"],
    quarters: bool = False,
) -> list[tuple[int, str, float]]:
    """Cameras whose images fit their own masks better when these are turned: which, how, fit.

    Args:
        shown: images, reduced.
        given: masks, reduced.
        quarters: look at quarter turns, too: of images that are no squares, these change the size.
    """
    square = given.reshape(*given.shape[:2], SIDE_PX, SIDE_PX)
    ways = {
        "mirrored": square[..., ::-1],
        "upside down": square[..., ::-1, :],
        "half a turn round": square[..., ::-1, ::-1],
    }
    if quarters:
        ways |= {"a quarter turn to the left": np.rot90(square, 1, (2, 3)),
                 "a quarter turn to the right": np.rot90(square, -1, (2, 3))}  # fmt: skip
    own = np.diag(correlations(shown, given))
    fits = {how: np.diag(correlations(shown, way.reshape(given.shape))) for how, way in ways.items()}
    best = {camera: max(fits, key=lambda how: fits[how][camera]) for camera in range(len(own))}
    found = [(camera, how, float(fits[how][camera])) for camera, how in best.items()]
    return [(camera, how, fit) for camera, how, fit in found if fit > CLEAR and fit - own[camera] > TURNED_MARGIN]


def _standard(values: Float64[np.ndarray, "*rows pixels"]) -> Float64[np.ndarray, "*rows pixels"]:
    centred = values - values.mean(-1, keepdims=True)
    length = np.linalg.norm(centred, axis=-1, keepdims=True)
    return centred / np.where(length > 0, length, 1.0)  # What is the same everywhere correlates with nothing.


def _image(
    source: ImageSource, path: str, frame: int, reduced: Mapping[str, Reduced]
) -> Float64[np.ndarray, " pixels"]:  # fmt: skip
    found = reduced.get(path)
    return (reduced_image(source.read(path, frame)) if found is None else found).astype(np.float64)


def _mask(source: ImageSource, path: str, reduced: Mapping[str, Reduced]) -> Float64[np.ndarray, " pixels"]:
    found = reduced.get(path)
    if found is None:
        found = reduced_mask(source.masks.subject(read_mask(source.mask_file(path))))
    return found.astype(np.float64)


def reduced_image(linear: Float32[np.ndarray, "h w 3"]) -> Reduced:
    """Square root of the mean colour, reduced: shadows count about as much as lit skin."""
    return _reduced(np.sqrt(np.clip(np.nan_to_num(linear.mean(2), posinf=0.0), 0, None)))


def reduced_mask(subject: UInt8[np.ndarray, "h w"]) -> Reduced:
    """A mask, reduced."""
    return _reduced(subject.astype(np.float32))


def _reduced(values: Shaped[np.ndarray, "h w"]) -> Reduced:
    return cv2.resize(values, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
