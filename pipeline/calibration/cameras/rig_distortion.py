"""How many distortion coefficients each camera gets: as many as its views support, by Bayes factors.

The simpler models are the full one with some terms exactly zero, so that Savage and Dickey's ratio gives the odds
without fitting them: the posterior density of the excluded terms at zero over their prior density there (Verdinelli
and Wasserman 1995). The posterior is the adjusted rig's, with all other parameters free to follow; the prior is the one
of the adjustment. Each camera decides for itself: one lens of a rig may be wide and another long.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from pipeline.calibration.cameras.projection import INTRINSICS
from pipeline.calibration.cameras.rig import Rig
from pipeline.calibration.cameras.rig_model import DISTORTION_TERMS, intrinsics_prior_sigma

FULL = max(DISTORTION_TERMS)


def distortion_evidence(rig: Rig) -> list[dict[int, float]]:
    """Per camera and number of coefficients: log of the odds of that model against the full one.

    Args:
        rig: adjusted with the full model for every camera.
    """
    evidence = []
    for camera, covariance in zip(rig.cameras, rig.intrinsics_covariance, strict=True):
        prior = np.diag(intrinsics_prior_sigma(camera)[4:] ** 2)
        log_odds = {}
        for number, terms in DISTORTION_TERMS.items():
            out = np.flatnonzero([name not in terms for name in INTRINSICS[4:]])
            posterior = covariance[4:, 4:][np.ix_(out, out)]
            at_zero = _log_density(camera.dist[out], posterior) - _log_density(np.zeros(len(out)), prior[out][:, out])
            log_odds[number] = at_zero
        evidence.append(log_odds)
    return evidence


def choose_distortion(evidence: list[dict[int, float]]) -> list[int]:
    """The most probable number of coefficients of each camera; of equals the smallest."""
    return [max(odds, key=lambda number: (odds[number], -number)) for odds in evidence]


def _log_density(value: Float64[np.ndarray, " terms"], covariance: Float64[np.ndarray, "terms terms"]) -> float:
    """Log of the normal density of mean zero."""
    _, log_determinant = np.linalg.slogdet(2 * np.pi * covariance)
    return float(-0.5 * (log_determinant + value @ np.linalg.solve(covariance, value)))
