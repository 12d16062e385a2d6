"""Images under environments: whether the lights that were found for them explain them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tests.support.datasets.turning_head import TurningHead

LEFT = 0.05
"""Error of an image over its light, root mean squares: 26 dB. AVIF of quality 90 is off by 0.03 of it in such small
images, also in those that are fitted."""


def assert_explained(truth: TurningHead, patterns: pd.DataFrame, frame: int, camera: str, unit: float = 1.0) -> None:
    """Check that fitted lights make the true image of a camera that took no part in the fit.

    Args:
        truth: of the set.
        patterns: of the index.
        frame: an image under an environment.
        camera: held out.
        unit: brightness of the truth's lights of intensity 1.
    """
    rows = patterns[patterns.frame == frame]
    channels = rows[["intensity_r", "intensity_g", "intensity_b"]].to_numpy()
    lights = {int(name[1:]): unit * shade for name, shade in zip(rows.light, channels, strict=True)}
    true, made = truth.image(camera, frame), truth.lit_by(camera, frame, lights)
    assert np.sqrt(((made - true) ** 2).sum() / (true**2).sum()) < LEFT
    found, right = (
        np.array([side.get(k, np.zeros(3)) for k in truth.frames[frame]]) for side in (lights, truth.frames[frame])
    )
    assert np.corrcoef(found.mean(1), right.mean(1))[0, 1] > 0.9
    assert np.argsort(found[right.mean(1).argmax()]).tolist() == [2, 1, 0], "the lamp is red rather than blue"
