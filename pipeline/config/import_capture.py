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
        "(000015.ply), in the world of the set's cameras, metres, for sets that ship none; empty: the set's own",
    )
    least_overlap: float = Field(
        0.5,
        ge=0,
        le=1,
        description="share of the projected meshes that has to lie in the masks, or the set is read in a wrong way",
    )
