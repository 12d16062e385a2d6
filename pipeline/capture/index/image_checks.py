"""Decoding every image of a capture once: its digest, and whether it is what the tables say."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.base.files import digest_bytes
from pipeline.capture.archives import read_bytes
from pipeline.capture.images import ImageSource, decode_color, decode_mask, decode_stored
from pipeline.capture.index.exchanged_images import Reduced, reduced_image, reduced_mask
from pipeline.capture.mask_format import PLAIN_MASKS, MaskFormat, reduced_size
from pipeline.capture.paths import locate

NAMED_UNREADABLE = 5
"""Unreadable images that are named for each camera before the rest are only counted."""

AHEAD_OF_A_THREAD = 16
"""Images for each thread that wait to be inspected, or to be looked at: a slow one holds the others up no longer than
it takes fifteen others."""


@dataclass(frozen=True)
class ExpectedImage:
    """One image that a capture should hold.

    Attributes:
        path: relative to the capture.
        what: `color` is finite R, G, B; `mask` one 8-bit channel; `pattern` anything that decodes (calibration).
        camera: whose image it is.
        size: (width, height) in pixels, None if any will do.
        table: what says so, for messages.
        masks: how a mask stores the subject, and how images are reduced as they are read.
        imported: True for images of an imported capture, which may lie behind its link.
        compared: the source of an image, or of a mask, that is compared with other cameras'; None for all others.
        frame: that an image belongs to.
    """

    path: str
    what: Literal["color", "mask", "pattern"]
    camera: str
    size: tuple[int, int] | None
    table: str = "the table of cameras"
    masks: MaskFormat = PLAIN_MASKS
    imported: bool = False
    compared: ImageSource | None = None
    frame: int | None = None


IndexSection = tuple[dict[str, Any], list[ExpectedImage]]
"""What the index says about a section of the calibration, and its images that are still to be decoded."""


@dataclass(frozen=True, slots=True)
class Flaw:
    """Difference of an image from what is expected; images with equal flaws share one complaint."""

    camera: str
    key: str
    expected: str
    found: str


@dataclass(frozen=True, slots=True)
class Inspection:
    """An image's content digest and flaws, and the reason if it cannot be decoded.

    `black`: no pixel is above 0. `reduced`: the image or mask as `pipeline.capture.index.exchanged_images` reduces it,
    for those that are compared.
    """

    digest: str
    flaws: tuple[Flaw, ...] = ()
    unreadable: str = ""
    black: bool = False
    reduced: Reduced | None = None


def inspect_image(root: Path, image: ExpectedImage) -> Inspection:
    """Read an image once: digest and checks."""
    try:
        content = read_bytes(locate(root, image.path, imported=image.imported))
    except InputError as error:
        return Inspection("", unreadable=str(error))
    digest = digest_bytes(content)
    try:
        decode = {"color": decode_color, "mask": decode_mask, "pattern": decode_stored}[image.what]
        pixels = decode(content, Path(image.path))
    except InputError as error:
        return Inspection(digest, unreadable=str(error))
    subject = image.masks.subject(pixels) if image.what == "mask" else pixels
    flaws, reduced = tuple(_flaws(image, pixels)), None
    if image.compared is not None and not flaws:
        reduced = reduced_mask(subject) if image.what == "mask" else reduced_image(
            image.compared.linear(pixels, image.frame)
        )  # fmt: skip
    return Inspection(digest, flaws, black=not subject.any(), reduced=reduced)


def _flaws(image: ExpectedImage, pixels: np.ndarray) -> Iterable[Flaw]:
    size = (pixels.shape[1], pixels.shape[0])
    if image.size is not None and not _fits(image, size):
        expected = f"{image.size[0]} x {image.size[1]} pixels, as {image.table} says"
        yield Flaw(image.camera, "size", expected, f"{size[0]} x {size[1]}")
    if image.what == "color" and (count := int(np.count_nonzero(~np.isfinite(pixels).all(-1)))):
        yield Flaw(image.camera, "pixels", "finite numbers", f"{count} of {size[0] * size[1]} pixels NaN or infinite")
    if image.what == "mask" and image.masks.labels is None and pixels.max(initial=0) == 1:
        yield Flaw(image.camera, "pixels", "0 to 255, 255 = subject", "none above 1")


def _fits(image: ExpectedImage, size: tuple[int, int]) -> bool:
    if image.what == "mask":
        return image.masks.factor(size[::-1], image.size[::-1]) is not None
    return reduced_size(size, image.masks.reduced if image.what == "color" else 1) == image.size


Known = Callable[[ExpectedImage], Inspection | None]
"""What is known of an image before it is read."""


def nothing_known(image: ExpectedImage) -> None:
    """No inspection: of an image of which nothing is known."""


def inspections(
    root: Path, images: Iterable[ExpectedImage], threads: int, known: Known = nothing_known
) -> Iterator[tuple[ExpectedImage, Inspection]]:
    """Inspect images on some threads, or look up what is known of them.

    Each is returned with its inspection, in their order. Threads are enough: OpenCV, OpenEXR and BLAKE2 release
    Python's lock. Few images are ahead of the one that is yielded: what waits takes no more memory with more images.
    """
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque = deque()
        for image in images:
            ahead.append((image, known(image) or pool.submit(inspect_image, root, image)))
            if len(ahead) > AHEAD_OF_A_THREAD * threads:
                yield _finished(*ahead.popleft())
        while ahead:
            yield _finished(*ahead.popleft())


def _finished(image: ExpectedImage, found: Inspection | Future[Inspection]) -> tuple[ExpectedImage, Inspection]:
    return image, found if isinstance(found, Inspection) else found.result()


def gather(
    inspected: Iterable[tuple[ExpectedImage, Inspection]], complaints: Complaints
) -> tuple[dict[str, str], dict[str, Reduced]]:
    """Complain about flawed images, by camera and flaw. Returns path to digest, and to what was reduced."""
    digests, alike, unreadable, masks_black = {}, defaultdict(list), defaultdict(list), Counter()
    reduced = {}
    for image, inspection in inspected:
        digests[image.path] = inspection.digest
        if inspection.reduced is not None:
            reduced[image.path] = inspection.reduced
        if image.what == "mask" and not inspection.unreadable:
            masks_black[inspection.black] += 1
        if inspection.unreadable:
            unreadable[image.camera].append(inspection.unreadable)
        for flaw in inspection.flaws:
            alike[flaw].append(image.path)
    if masks_black[True] and not masks_black[False]:
        hint = "mark the subject by 255, or leave masks out of capture.yaml"
        found = f"none above 0 in all {masks_black[True]} masks"
        complaints.add("masks", "pixels", expected="the subject in some", found=found, hint=hint)
    for camera, messages in unreadable.items():
        complaints.messages += messages[:NAMED_UNREADABLE]
        if (more := len(messages) - NAMED_UNREADABLE) > 0:
            complaints.add("images", camera, expected="whole images", found=f"{more} more that cannot be read")
    for flaw, paths in alike.items():
        key = f"{flaw.camera}: {flaw.key}"
        found = f"{flaw.found} in {len(paths)} images" if len(paths) > 1 else flaw.found
        complaints.add(listed(paths), key, expected=flaw.expected, found=found)
    return digests, reduced
