"""Which keypoint sits where, and templates in the wrong unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.geometry.skin import Template
from pipeline.geometry.template_file import read_template
from pipeline.tracking.keypoint_targets import KeypointTargets, read_keypoint_targets, size_ratio
from tests.support.figures.walking import BONES, rest_joints, write_template


@pytest.fixture
def template(tmp_path: Path) -> Template:
    return read_template(write_template(tmp_path / "t.glb"), 1.0)


def test_nodes_become_joints_and_vertices_stay(template: Template, tmp_path: Path) -> None:
    (tmp_path / "joints.csv").write_text("keypoint,node_index\nneck,3\nhip,1\n")
    targets = read_keypoint_targets(tmp_path / "joints.csv", template)
    assert targets.names == ("neck", "hip")
    assert targets.joints.tolist() == [2, 0]
    (tmp_path / "vertices.csv").write_text("keypoint,vertex\nnose,7\n")
    targets = read_keypoint_targets(tmp_path / "vertices.csv", template)
    assert targets.joints.tolist() == [-1]
    assert targets.vertices.tolist() == [7]


def test_every_bad_row_is_named_at_once(template: Template, tmp_path: Path) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("keypoint,node_index\nneck,3\nneck,4\ntail,0\nwing,99\n")
    with pytest.raises(InputError, match="3 problems") as caught:
        read_keypoint_targets(path, template)
    assert all(name in str(caught.value) for name in ("neck", "tail", "wing"))
    path.write_text("keypoint,vertex\nnose,100000\n")
    with pytest.raises(InputError, match="nose: expected a vertex below"):
        read_keypoint_targets(path, template)
    path.write_text("name,joint\nnose,1\n")
    with pytest.raises(InputError, match="columns: expected keypoint,node_index or keypoint,vertex"):
        read_keypoint_targets(path, template)
    with pytest.raises(InputError, match="expected a csv table"):
        read_keypoint_targets(tmp_path / "absent.csv", template)


@pytest.mark.parametrize("by_vertex", [False, True])
def test_size_ratio_and_wrong_units(template: Template, by_vertex: bool) -> None:
    count = len(BONES)
    joints = np.full(count, -1) if by_vertex else np.arange(count)
    targets = KeypointTargets(tuple(map(str, range(count))), joints, -1 - joints)
    rest, gap = rest_joints(), rest_joints()[None].repeat(3, 0)
    gap[1, 4:] = np.nan
    assert size_ratio(template, targets, 1.1 * gap, rest) == pytest.approx(1.1)
    assert np.isnan(size_ratio(template, targets, np.nan * gap, rest))
    with pytest.raises(InputError, match=r"100 times as long; set template.scale_to_m .* to about 0\.01"):
        size_ratio(template, targets, 0.01 * gap, rest)
    with pytest.raises(InputError, match=r"to about 39\.4"):
        size_ratio(template, targets, 39.37 * gap, rest)
