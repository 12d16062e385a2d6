"""Checking a capture's template mesh, its keypoints and its eyes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float64, Int64

from pipeline.base.errors import Complaints, InputError, listed
from pipeline.capture.index.csv_tables import Kind, complain_repeats, complain_rows, header_cells, read_csv
from pipeline.capture.index.eye_tables import read_eyes_csv
from pipeline.capture.paths import locate
from pipeline.capture.schema.capture_yaml import Template
from pipeline.geometry.gltf import GltfFile, by_the_specification
from pipeline.geometry.template_file import read_template

REGION_COLUMNS: Mapping[str, Kind] = {"region": "name", "vertex": "whole"}

SMALLEST_M, LARGEST_M = 0.05, 10.0
"""Longest side of a template at rest: an eye to a person with outstretched arms, and some. Metres for centimetres, or
millimetres for metres, are outside, and so are vertices that a program threw far off or onto one point."""


@dataclass(frozen=True)
class Shape:
    """Parts of a template that other files may name.

    Attributes:
        vertices: their number.
        joints: glTF nodes.
    """

    vertices: int
    faces: Int64[np.ndarray, "f 3"]
    joints: set[int]


def check_template(
    root: Path, template: Template, complaints: Complaints
) -> tuple[list[str] | None, pd.DataFrame, int | None]:
    """Check that the mesh loads, and that keypoints and eyes lie on its joints or vertices.

    Returns:
        the keypoints' names, None if there is no table of them or it is in doubt; the table of eyes; and the number of
        vertices, None if it is in doubt.
    """
    shape = None
    with complaints.collecting():
        shape = _read_shape(root, template.mesh)
        # As tracking reads it, so that what it would refuse is said now.
        rest = read_template(locate(root, template.mesh), template.scale_to_m).vertices_rest
        _check_size(template, rest, complaints)
    faces, vertices = (None, 0) if shape is None else (shape.faces, shape.vertices)
    count = None if shape is None else shape.vertices
    eyes = read_eyes_csv(root, template.eyes, faces, vertices, complaints)
    _check_regions(root, template.regions, count, complaints)
    table = read_keypoint_places(root, template.keypoints, complaints)
    if table is None:
        return None, eyes, count
    complain_repeats(complaints, template.keypoints, table, ["keypoint"])
    if shape is not None:
        _check_places(template.keypoints, table, shape.vertices, shape.joints, complaints)
    return list(table["keypoint"]), eyes, count


def _check_regions(root: Path, path: str | None, vertices: int | None, complaints: Complaints) -> None:
    """A vertex may be in several regions, but is listed once in each."""
    table = None if path is None else read_csv(root, path, REGION_COLUMNS, complaints)
    if table is None:
        return
    if table.empty:
        complaints.add(path, "region", expected="at least one row", found="none", hint="leave the key out")
    complain_repeats(complaints, path, table, ["region", "vertex"])
    if vertices is not None and (bad := ~table["vertex"].between(0, vertices - 1)).any():
        complain_rows(
            complaints, path, "vertex", bad, f"a vertex of the template, 0 to {vertices - 1}", table["vertex"]
        )


def _check_size(template: Template, rest: Float64[np.ndarray, "vertices 3"], complaints: Complaints) -> None:
    size = float(np.ptp(rest, axis=0).max())
    if not SMALLEST_M <= size <= LARGEST_M:
        complaints.add(
            template.mesh, "size", expected=f"{SMALLEST_M:g} to {LARGEST_M:g} m at rest, in metres by scale_to_m",
            found=f"{size:.3g} m", hint="mend template.scale_to_m, or export the mesh anew",
        )  # fmt: skip


def _read_shape(root: Path, path: str) -> Shape:
    with by_the_specification(Path(path)):
        mesh = GltfFile(locate(root, path))
        primitives = mesh.primitives()
        starts = np.cumsum([0] + [len(primitive.positions) for primitive in primitives])
        faces = [primitive.faces + start for primitive, start in zip(primitives, starts[:-1], strict=True)]
        joints = {joint for skin in mesh.document.skins or [] for joint in skin.joints}
        return Shape(int(starts[-1]), np.concatenate(faces).astype(np.int64), joints)


def read_keypoint_places(root: Path, path: str | None, complaints: Complaints) -> pd.DataFrame | None:
    """The template's keypoints: `keypoint` and either `node_index` or `vertex`."""
    if path is None:
        return None
    try:
        header = header_cells(locate(root, path))
    except (InputError, OSError, ValueError) as error:
        complaints.add(path, "table", expected="the columns keypoint and node_index or vertex", found=str(error))
        return None
    places = [column for column in ("node_index", "vertex") if column in header]
    if len(places) != 1:
        found = ", ".join(header)
        complaints.add(path, "columns", expected="keypoint and either node_index or vertex", found=found)
        return None
    return read_csv(root, path, {"keypoint": "text", places[0]: "whole"}, complaints)


def _check_places(path: str, table: pd.DataFrame, vertices: int, joints: set[int], complaints: Complaints) -> None:
    if "vertex" in table.columns:
        bad = ~table["vertex"].between(0, vertices - 1)
        if bad.any():
            complain_rows(
                complaints, path, "vertex", bad, f"a vertex of the template, 0 to {vertices - 1}", table["vertex"]
            )
    elif not joints:
        hint = "place keypoints by vertex"
        complaints.add(path, "node_index", expected="a template with a skin", found="a template without one", hint=hint)
    else:
        bad = ~table["node_index"].isin(joints)
        if bad.any():
            expected = f"a joint of the template's skin, one of {listed(sorted(joints), 30)}"
            complain_rows(complaints, path, "node_index", bad, expected, table["node_index"])
