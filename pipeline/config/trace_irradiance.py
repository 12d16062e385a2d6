"""Settings of trace_irradiance."""

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class TraceIrradiance(Settings):
    """Shadow rays of each texel, and the lights they go towards."""

    samples: str = Field(
        "full", pattern=r"^(full|[1-9][0-9]{0,3})$", description="lights drawn per texel, or full: all of them [rays]"
    )
    sampling: Literal["uniform", "power", "arriving"] = Field(
        "power",
        description="probability of a light: the same for all, by intensity, or by what would arrive unoccluded",
    )
    spread: Literal["random", "stratified", "low_discrepancy"] = Field(
        "low_discrepancy",
        description="draws of neighbouring texels: independent, one in each sixteenth per 4 x 4 texels, or a shifted "
        "lattice over the map",
    )
    share_rays: bool = Field(
        True,
        description="whether texels also use what their neighbours' rays found, and, where no more lights are on than "
        "would be drawn, all lights are summed; if not, maps are unbiased draws, too noisy to learn from",
    )
    visibility: Literal["auto", "traced", "cached"] = Field(
        "auto",
        description="whether every texel's visibility to every light of the stage is kept as bits, from which any "
        "pattern costs no rays; auto: if that is cheaper for `relightings` patterns per pose",
    )
    relightings: int = Field(
        1, ge=1, description="light patterns that each posed frame is expected to be asked for, over all runs"
    )
    environment_height: int = Field(
        64, ge=1, description="height to which environment maps are reduced before they are traced [pixels]"
    )

    @property
    def samples_or_none(self) -> int | None:
        """Lights drawn per texel; None for all."""
        return None if self.samples == "full" else int(self.samples)
