"""Masks that images share: decoded once, whatever the order, and let go with the last of them."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.capture.images import ImageSource, write_png
from pipeline.capture.shared_masks import SharedMasks
from tests.support.datasets.decodes import counted_decodes

SHAPE = (3, 4)
LEVELS = {"a.png": 255, "b.png": 40}


@pytest.fixture
def source(tmp_path):
    for name, level in LEVELS.items():
        write_png(tmp_path / name, np.full(SHAPE, level, np.uint8))
    return ImageSource(tmp_path, "linear", 0.0)


def test_shared_masks_are_decoded_once_and_then_let_go(source):
    paths = ["a.png", "b.png", None, "a.png", float("nan"), "b.png", "a.png"]
    masks = SharedMasks(source, paths)
    with counted_decodes() as decoded:
        for path in [path for path in paths if isinstance(path, str)]:
            assert (masks.read(path, (*SHAPE, 3)) == LEVELS[path]).all()
    assert sorted(path for _, path in decoded.files) == [str(source.folder / name) for name in LEVELS]
    (source.folder / "a.png").unlink()
    with pytest.raises(InputError, match=r"a\.png"):
        masks.read("a.png", SHAPE)


def test_image_of_another_size_is_refused_although_its_mask_is_at_hand(source):
    masks = SharedMasks(source, ["a.png", "a.png"])
    masks.read("a.png", SHAPE)
    with pytest.raises(InputError, match="expected a mask of 4 x 9 pixels, as its image, found 4 x 3"):
        masks.read("a.png", (9, 4))
