"""Texels of regions: each in one, the smallest that has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.texel_regions import REST, in_regions, texels_by_region
from tests.support.avatars.sheet import make_sheet

SHEET = make_sheet(8)
X = SHEET.rest_vertices[:, 0]
RIGHT = np.flatnonzero(np.median(X) <= X)


def labelled(**regions):
    return replace(SHEET, regions=regions)


def test_without_labels_nothing_is_known():
    assert texels_by_region(SHEET) == {}


def test_every_texel_lies_in_one_region():
    found = texels_by_region(labelled(cloth=RIGHT))
    assert list(found) == ["cloth", REST]
    assert np.array_equal(np.sort(np.concatenate(list(found.values()))), np.arange(SHEET.texel_count))
    points = (SHEET.rest_vertices[SHEET.corners] * SHEET.barycentric[..., None]).sum(1)
    assert points[found["cloth"], 0].min() > points[found[REST], 0].max() - 1e-6


def test_of_regions_that_overlap_the_smaller_has_the_texel():
    everywhere = np.arange(len(SHEET.rest_vertices))
    found = texels_by_region(labelled(body=everywhere, cloth=RIGHT))
    assert list(found) == ["cloth", "body"]  # nothing is left over
    assert len(np.intersect1d(found["body"], found["cloth"])) == 0
    atlas = labelled(body=everywhere, cloth=RIGHT)
    assert np.array_equal(np.flatnonzero(in_regions(atlas, ("cloth",))), found["cloth"])
    assert in_regions(atlas, ("cloth", "body")).all()


def test_a_region_that_the_atlas_does_not_know_is_an_error():
    with pytest.raises(KeyError, match="hair"):
        in_regions(labelled(cloth=RIGHT), ("hair",))
