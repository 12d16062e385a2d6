"""Costs of effects where they are simulated, which are spared where they are not."""

from __future__ import annotations

from pipeline.config.train_avatar import TrainAvatar

STEP_US = {"specular": 0.4, "learned_transport": 1.4}
"""Microseconds of a training step per texel on one core. Gloss: with the effect less without it, all others on, by
`benchmarks.bench_effect_steps`, 0.2 on 30,626 texels and 0.6 on 51,206. Light below the surface: of its products alone,
29 ms on 20,771 texels. Shadows, what bounces off other texels, and where lights are as seen from texels are found once
per frame: a step shows nothing of them."""

JOBS, CHANNELS = {"eyes": 1}, {"eyes": 2}
"""Jobs, and channels that are blended per pixel on top of colour: what eyes mirror, and how sharply."""

PARAMETERS = {"specular": 2}
"""Of each texel: scale and width of the gloss."""

SHARED_PARAMETERS = {"specular": 1, "learned_transport": 5 * 3}
"""Of all texels together: the share of the coat; five Gaussians that light spreads by below the surface."""


def effect_cost(effect: str, texels: int, built: int) -> dict[str, int | float]:
    """Jobs, blended channels, parameters and seconds of training that an effect costs.

    Those of the default avatar of a body. Seconds are estimates for the default number of steps on one core.

    Args:
        texels: of the atlas, which all have the effect's parameters.
        built: of the regions where it is on; elsewhere parameters stay where they are, and take no time.
    """
    seconds = 1e-6 * STEP_US.get(effect, 0.0) * built * TrainAvatar().steps
    return {
        "jobs": JOBS.get(effect, 0),
        "channels": CHANNELS.get(effect, 0),
        "parameters": PARAMETERS.get(effect, 0) * texels + SHARED_PARAMETERS.get(effect, 0),
        "seconds": round(seconds, 1),
    }
