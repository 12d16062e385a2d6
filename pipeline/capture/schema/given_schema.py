"""Keys of `capture.yaml` about what was found elsewhere: meshes, and the set it is from."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.capture.schema.sections import Length, ParquetPath, Section


class Meshes(Section):
    """The template as it was tracked elsewhere: its vertices in some of the frames."""

    table: ParquetPath = Field(
        description="parquet: frame, path (.ply or .obj, vertices in the template's order), world_from_mesh (the 12 "
        "numbers of three rows [R | t], t in metres; null: the vertices are in the world). Frames without a row are "
        "interpolated between their neighbours in the segment"
    )
    motion: Literal["given", "fitted"] = Field(
        "given",
        description="given: world_from_mesh is how the template moves as a whole; fitted: it only takes the vertices "
        "into the world, and the template's motion is fitted to them",
    )
    scale_to_m: Length = Field(description="a vertex in metres is this times that of the file")


class Imported(Section):
    """Origin of a capture that import_capture wrote, for the report."""

    dataset: str = Field(description="the public set")
    digest: str = Field(description="of the files beside capture.yaml: what changes there changes this")
    given: dict[str, str] = Field(description="what was taken from the set -> from which of its files, and how")
    computed: dict[str, str] = Field(description="what the set lacks -> what makes it")
    left_out: dict[str, str] = Field(description="what of the set is not used -> why")
    assumed: dict[str, str] | None = Field(None, description="what the set does not say -> what is taken for it")
