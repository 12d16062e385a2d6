"""Costs of effects where they are simulated, which are spared where they are not."""

from __future__ import annotations

from pipeline.config.train_avatar import TrainAvatar

STEP_US = {
    "shadow": 7.0, "near_field": 4.3, "articulation": 6.5, "specular": 11.5, "deferred": 7.4, "learned_transport": 23.0,
}  # fmt: skip
"""Microseconds of a training step per texel on one core, with an effect less without it, all others on: differences
of medians over 24 steps of two images (6,765 texels, 5 to 24 lights); a factor of two either way on other captures."""

CHANNELS = {"shadow": 1, "deferred": 5, "eyes": 2}
"""Blended per pixel on top of colour: the shadow factor; normal, roughness and visibility; the last two of eyes."""

ZONAL, HARMONIC = 3 * (4 * 3 + 5), 16 * 3 + 65
"""Transfer coefficients of a texel: along three axes, and unturned (RFGCA 9, RGCA 5)."""

LOBE, NORMAL = 2, 3
"""Parameters of a texel for its lobe, and for the normal that it is mirrored about."""


def effect_cost(effect: str, texels: int, chunks: int) -> dict[str, int | float]:
    """Jobs, blended channels, parameters and seconds of training that an effect costs.

    Seconds are estimates for the default settings on one core. Negative where simulating less takes more: unturned SH
    has more coefficients than zonal lobes, and is faster.
    """
    settings = TrainAvatar()
    width = settings.shadow_width
    parameters = {
        "shadow": 9 * (3 * width + width * width + width) + 2 * width + 1,
        "articulation": texels * (ZONAL - HARMONIC),
        "specular": texels * (LOBE + NORMAL),
        "learned_transport": texels * ZONAL,
    }
    seconds = 1e-6 * STEP_US.get(effect, 0.0) * texels * settings.steps
    return {
        "jobs": {"shadow": chunks, "eyes": 1}.get(effect, 0),
        "channels": CHANNELS.get(effect, 0),
        "parameters": parameters.get(effect, 0),
        "seconds": round(seconds, 1),
    }
