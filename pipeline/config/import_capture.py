"""Settings of the stage import_capture."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class ImportCapture(Settings):
    """Choice of what is taken of a public set."""

    cameras: tuple[str, ...] = Field((), description="cameras to take, by the set's names; none: all")
    segments: tuple[str, ...] = Field((), description="segments (takes, sequences) to take; none: all")
    topology: str = Field(
        "",
        description=".obj or .ply with the faces of the tracked meshes, for sets that ship vertices alone; empty: the "
        "set's own template",
    )
    mesh: str = Field(
        "",
        description=".obj or .ply of a subject that stands still, or a folder of them named after the images' numbers "
        "(000015.ply) for one that moves, in the world of the set's cameras, metres or the set's unit, for sets that "
        "ship none; empty: the set's own, else, of objects, the visual hull of the masks",
    )
    hull_cells: int = Field(
        48,
        ge=16,
        le=256,
        description="cells along the longest side of a visual hull, for objects without a mesh; fewer, if masks are so "
        "coarse that a cell would be smaller than two of their pixels",
    )
    environments: bool = Field(
        True,
        description="of sets of single lights, take images under environments for testing: how bright each light is in "
        "them is found from images of single lights by eight training cameras, which are decoded for that",
    )
    reduced: int = Field(
        1,
        ge=1,
        le=64,
        description="r: images and masks are r times smaller than the set has them, each pixel the mean of r x r, in "
        "linear light; they are reduced as they are read, and nothing is copied [pixels]",
    )
    light_patterns: str = Field(
        "",
        description="csv of pattern, light, x, y, z, intensity, one row per lit light, metres in the world of the "
        "set's cameras, for sets that do not say which lights their patterns turn on",
    )
    least_overlap: float = Field(
        0.5,
        ge=0,
        le=1,
        description="share of the projected meshes that has to lie in the masks, or the set is read in a wrong way",
    )
