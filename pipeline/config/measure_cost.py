"""Settings of measure_cost."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings

COSTED_STAGES = (
    "calibrate_cameras", "calibrate_lights", "unwrap_atlas", "track_mesh", "trace_irradiance", "pack_shards",
    "train_avatar", "relight_avatar",
)  # fmt: skip
"""Stages of which a dial of `pipeline.dials` turns a setting: their code and settings decide the measurement, too."""


class MeasureCost(Settings):
    """Dials that are turned, runs of each setting, and the error that is good enough."""

    dials: tuple[str, ...] = Field(
        (),
        description="dials to turn, by name (a wrong name lists them); none: all that the subject's results allow",
    )
    repeats: int = Field(3, ge=1, description="counted runs of every setting, interleaved [runs]")
    training_repeats: int = Field(
        3, ge=1, description="the same of settings whose runs train an avatar, for minutes [runs]"
    )
    relative_tolerance: float = Field(
        0.1, ge=0, description="error above a dial's smallest one, over it, up to which a setting is good enough"
    )
