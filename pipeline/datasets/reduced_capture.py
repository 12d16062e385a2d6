"""Imported captures whose images are read at a whole fraction of their size."""

from __future__ import annotations

from dataclasses import replace

from pipeline.base.errors import InputError
from pipeline.capture.mask_format import reduced_size
from pipeline.datasets.imported_capture import ImportedCapture


def reduced(found: ImportedCapture, factor: int) -> ImportedCapture:
    """The capture at images `factor` times smaller, each pixel the mean of `factor` x `factor`.

    What is left over at the right and at the bottom is cut off, of sensors too; pixels count from the other corner.

    Raises:
        InputError: if no pixel is left.
    """
    if factor == 1:
        return found
    store = found.images
    sizes = {name: reduced_size(size, factor) for name, size in store.sizes.items()}
    if too_small := [name for name, size in sizes.items() if min(size) < 1]:
        raise InputError(f"import_capture.reduced: expected less than {factor}, as camera {too_small[0]} is smaller")
    downsample = store.downsample_from_sensor * factor
    cameras = {
        name: replace(camera, width=downsample * sizes[name][0], height=downsample * sizes[name][1])
        for name, camera in found.cameras.items()
    }
    found.provenance.computed["resolution"] = f"import_capture.reduced: means of {factor} x {factor} pixels, as read"
    images = replace(store, sizes=sizes, downsample_from_sensor=downsample, reduced=factor)
    keypoints = None if found.keypoints is None else found.keypoints.reduced(factor)
    return replace(found, cameras=cameras, images=images, keypoints=keypoints)
