"""Parts of a template by name: from labels, from the skin's weights, and as shares of texels."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_arrays, write_arrays
from pipeline.geometry.skin import Template
from pipeline.geometry.template_regions import head_of_skin, read_regions
from pipeline.geometry.texels import read_atlas, write_atlas
from tests.support.avatars.sheet import make_sheet

PARENTS = np.array([-1, 0, 1, 0])
"""Root 10, neck 11, jaw 12 below it, hand 13."""

KEYPOINTS = "keypoint,node_index\nroot,10\nHead,11\nhand,13\n"


def skinned(weights):
    weights = np.asarray(weights, np.float64)
    points, joints = np.zeros((len(weights), 3)), np.tile(np.eye(4), (4, 1, 1))
    return Template(
        vertices_rest=points, faces=np.zeros((0, 3), np.int64), uv=None, joint_nodes=np.array([10, 11, 12, 13]),
        parents=PARENTS, before=joints, after=joints, rest_rotations=np.tile([1.0, 0, 0, 0], (4, 1)),
        inverse_bind=joints, weights=weights, vertices_bind=points, scale_to_m=1.0,
    )  # fmt: skip


def test_head_is_what_its_joint_and_those_below_move_most(tmp_path):
    (tmp_path / "keypoints.csv").write_text(KEYPOINTS)
    template = skinned([[1, 0, 0, 0], [0.4, 0.6, 0, 0], [0.45, 0.3, 0.25, 0], [0.5, 0.5, 0, 0], [0, 0, 0, 1]])
    found = head_of_skin(template, tmp_path / "keypoints.csv")
    assert {name: vertices.tolist() for name, vertices in found.items()} == {"head": [1, 2]}


@pytest.mark.parametrize("text", ["keypoint,node_index\nroot,10\n", "keypoint,vertex\nhead,0\n", None])
def test_no_head_without_a_joint_of_that_name(tmp_path, text):
    path = tmp_path / "keypoints.csv"
    if text:
        path.write_text(text)
    assert head_of_skin(skinned([[0, 1, 0, 0]]), path if text else None) == {}


def test_labels_are_read_and_kept_with_the_atlas(tmp_path):
    (tmp_path / "regions.csv").write_text("region,vertex\nhair,1\nface,3\nhair,0\n")
    regions = read_regions(tmp_path / "regions.csv")
    atlas = dataclasses.replace(make_sheet(8), regions=regions)
    write_atlas(tmp_path / "atlas.safetensors", atlas)
    again = read_atlas(tmp_path / "atlas.safetensors")
    assert {name: vertices.tolist() for name, vertices in again.regions.items()} == {"face": [3], "hair": [0, 1]}
    assert again.to_torch().regions.keys() == again.regions.keys()
    # The sheet's upper edge is hair: the share falls from 1 to 0 with y, texel by texel.
    share = again.texels_of("hair")
    np.testing.assert_allclose(share, 1 - (again.texel[:, 0] + 0.5) / 8, atol=1e-6)
    assert not again.texels_of("cloth").any()


def test_region_beyond_the_template_is_refused(tmp_path):
    path = tmp_path / "atlas.safetensors"
    write_atlas(path, make_sheet(4))
    write_arrays(path, {**read_arrays(path), "region.hair": np.array([4], np.int32)})
    with pytest.raises(InputError, match="hair: expected vertices below 4"):
        read_atlas(path)
