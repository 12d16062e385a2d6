"""Templates that some program wrote wrongly: each is refused in words, by whoever reads it first."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.base.errors import InputError
from pipeline.geometry.template_file import read_template
from tests.support.meshes.glb_files import GlbFile


def arrays() -> dict[str, np.ndarray]:
    """A tetrahedron with a skin of two joints, nodes 1 and 2."""
    return {
        "positions": np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32),
        "faces": np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], np.uint16),
        "joints": np.array([[0, 1, 0, 0]] * 4, np.uint8),
        "weights": np.array([[0.5, 0.5, 0, 0]] * 4, np.float32),
        "inverse_bind": np.stack([np.eye(4, dtype=np.float32)] * 2),
    }


def glb(values: dict[str, np.ndarray]) -> GlbFile:
    file = GlbFile()
    attributes = {
        "POSITION": file.accessor(values["positions"]),
        "JOINTS_0": file.accessor(values["joints"]),
        "WEIGHTS_0": file.accessor(values["weights"]),
    }
    primitive = {"attributes": attributes, "indices": file.accessor(values["faces"])}
    file.content["meshes"] = [{"primitives": [primitive]}]
    file.content["nodes"] = [{"mesh": 0, "skin": 0}, {"children": [2]}, {"translation": [0.0, 0.5, 0.0]}]
    file.content["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.accessor(values["inverse_bind"])}]
    return file


def test_whole_template_is_read(tmp_path: Path) -> None:
    assert read_template(glb(arrays()).write(tmp_path / "a.glb"), 1.0).vertices_rest.shape == (4, 3)


@pytest.mark.parametrize(
    ("name", "place", "value", "said"),
    [
        ("positions", (2, 1), np.nan, "POSITION: expected finite numbers, found 1 of 4 vertices without"),
        ("positions", (2, 1), np.inf, "POSITION: expected finite numbers"),
        ("joints", (3, 1), 2, "JOINTS_n: expected joints of the skin, 0 to 1, found 0 to 2"),
        ("weights", (0, 0), np.nan, "WEIGHTS_n: expected finite weights of 0 or more"),
        ("weights", (0, 0), -1.0, "WEIGHTS_n: expected finite weights of 0 or more"),
        ("faces", (0,), 4, "indices: expected triples below 4"),
        ("inverse_bind", (1, 0, 0), np.nan, "inverseBindMatrices: expected 2 finite 4x4 matrices"),
    ],
)
def test_wrong_number_is_named(tmp_path: Path, name: str, place: tuple, value: float, said: str) -> None:
    values = arrays()
    values[name][place] = value
    with pytest.raises(InputError, match=re.escape(said)):
        read_template(glb(values).write(tmp_path / "a.glb"), 1.0)


ZEROS = {"componentType": 5123, "count": 4_000_000_000, "type": "SCALAR"}
"""An accessor without a buffer: zeros, as many as it says."""


def nodes(*changed: dict) -> Callable[[dict], None]:
    return lambda content: content.update(nodes=list(changed))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (nodes({"mesh": 0, "skin": 0}, {"children": [2]}, {"children": [1]}), "nodes.children: expected trees"),
        (nodes({"mesh": 0, "skin": 0, "children": [0]}, {"children": [2]}, {}), "nodes.children: expected trees"),
        (nodes({"mesh": 0, "skin": 0, "children": [2]}, {"children": [2]}, {}), "nodes[2]: expected one parent"),
        (nodes({"mesh": 0, "skin": 0}, {"children": [7]}, {}), "nodes[1].children: expected nodes, 0 to 2, found 7"),
        (
            nodes({"mesh": 0, "skin": 0}, {"children": [2]}, {"matrix": [float("nan")] * 16}),
            "nodes[2].matrix: expected 16 finite numbers",
        ),
        (
            nodes({"mesh": 0, "skin": 0}, {"children": [2]}, {"rotation": [0.0] * 4}),
            "nodes[2].rotation: expected a unit quaternion, found 0, 0, 0, 0",
        ),
        (lambda content: content["skins"][0].update(joints=[1, 9]), "joints: expected different nodes, 0 to 2"),
        (lambda content: content["skins"][0].update(joints=[1, 1]), "joints: expected different nodes"),
        (lambda content: content["skins"][0].update(joints=[1]), "inverseBindMatrices: expected 1 finite 4x4"),
        (lambda content: content["accessors"][0].update(count=4_000_000_000), "accessors[0].count: expected 1 to"),
        (lambda content: content["accessors"][0].update(count=40_000), "expected 40000 x 3 float32 from byte 0"),
        (lambda content: content["accessors"].__setitem__(3, ZEROS), "accessors[3].count: expected 1 to"),
    ],
)
def test_wrong_structure_is_named(tmp_path: Path, change: Callable[[dict], object], said: str) -> None:
    file = glb(arrays())
    change(file.content)
    with pytest.raises(InputError, match=re.escape(said)):
        read_template(file.write(tmp_path / "a.glb"), 1.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda file: file.content["accessors"][0].update(type=-1),
        lambda file: file.content["accessors"][0].update(componentType=1),
        lambda file: file.content["accessors"][1].update(normalized=4.5),
        lambda file: file.views.__setitem__(0, None),
        lambda file: file.views[0].update(buffer=1),
        lambda file: file.content.update(skins={}),
        lambda file: file.content["meshes"][0]["primitives"][0]["attributes"].update(WEIGHTS_0="text"),
    ],
)
def test_what_breaks_the_specification_is_refused_in_words(tmp_path: Path, change: Callable[[GlbFile], object]) -> None:
    file = glb(arrays())
    change(file)
    with pytest.raises(InputError, match=r"by the glTF 2\.0 specification"):
        read_template(file.write(tmp_path / "a.glb"), 1.0)


def test_mesh_without_triangles_is_refused(tmp_path: Path) -> None:
    values = arrays() | {"faces": np.zeros(1, np.uint16)}
    with pytest.raises(InputError, match="expected at least one triangle, found 1 indices"):
        read_template(glb(values).write(tmp_path / "a.glb"), 1.0)
