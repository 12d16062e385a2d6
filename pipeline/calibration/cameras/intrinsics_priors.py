"""Standard deviations of the priors of a camera's intrinsics."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from pipeline.geometry.cameras import PINHOLE_TERMS, Camera

PRIOR_SIGMA = {"f": np.inf, "aspect": 0.01, "cx": 0.03, "cy": 0.03}
"""Standard deviations of the priors of `PINHOLE_TERMS`: about the spread of ordinary cameras, cx and cy in units of the
longer side, none for f. Those of a lens's terms are its own."""

GIVEN_TERMS = 10.0
"""Error of a given lens's distortion and aspect, over that of ordinary lenses, over the error of f, over itself: where
two people fitted the same photographs, f agrees to a fraction of a per cent, and k1 to some hundredths."""


def intrinsics_prior_sigma(camera: Camera) -> Float64[np.ndarray, " intrinsics"]:
    """Standard deviations of the priors of `Camera.intrinsics`, infinite for f."""
    longer = max(camera.width, camera.height)
    scale = {"cx": longer, "cy": longer}
    pinhole = [PRIOR_SIGMA[name] * scale.get(name, 1) for name in PINHOLE_TERMS]
    return np.array([*pinhole, *camera.lens.prior_sigma])


def given_prior_sigma(camera: Camera, lens_sigma: float) -> Float64[np.ndarray, " intrinsics"]:
    """Standard deviations of the priors of a given lens's `Camera.intrinsics`.

    f is known to `lens_sigma` over itself, the principal point to as many pixels, as it mostly is where lenses are
    calibrated, and no term less well than that of an ordinary lens.
    """
    ordinary = intrinsics_prior_sigma(camera)
    f = lens_sigma * camera.K[0, 0]
    terms = GIVEN_TERMS * lens_sigma * ordinary
    return np.minimum(np.array([f, terms[1], f, f, *terms[len(PINHOLE_TERMS) :]]), ordinary)
