"""Settings of trace_irradiance."""

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings


class TraceIrradiance(Settings):
    """How many shadow rays each texel gets, and towards which lights."""

    samples: str = Field(
        "full", pattern=r"^(full|[1-9][0-9]{0,3})$", description="lights drawn per texel, or full: all of them [rays]"
    )
    sampling: Literal["uniform", "power", "arriving"] = Field(
        "power",
        description="probability of a light: the same for all, by intensity, or by what would arrive unoccluded",
    )

    @property
    def samples_or_none(self) -> int | None:
        """Lights drawn per texel; None for all."""
        return None if self.samples == "full" else int(self.samples)
