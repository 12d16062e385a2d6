"""Keys of `capture.yaml` about the template, the mesh that is tracked."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pipeline.capture.schema.sections import CsvPath, Length, Section, path_to


class Template(Section):
    """The rest mesh that is posed for every frame."""

    mesh: Annotated[str, path_to(".glb")] = Field(
        description="glTF binary: mesh, texture coordinates if any, skin if it is rigged"
    )
    keypoints: CsvPath | None = Field(None, description="csv: keypoint, and node_index (of a joint) or vertex")
    points: CsvPath | None = Field(
        None,
        description="csv: keypoint, point; which of the points that detectors find (docs/detection.md) a keypoint is, "
        "for keypoints whose names do not say it",
    )
    scale_to_m: Length = Field(description="a vertex in metres is this times its (skinned) glTF position")
    eyes: CsvPath | None = Field(
        None, description="csv: eye, vertex; every vertex of each eyeball, which is a separate part of the mesh"
    )
    regions: CsvPath | None = Field(
        None,
        description="csv: region, vertex; parts of the surface by name, among them hair and face if they are known",
    )
