"""A hard case along what makes it hard: ours, the naive formula and the truth, as curves of a picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Numbers = Float64[np.ndarray, " points"]


@dataclass(frozen=True)
class Curves:
    """One hard case along what makes it hard.

    Attributes:
        title: of the picture.
        across, up: labels of the axes, with units.
        at: along the axis.
        ours, naive, truth: values there; NaN or infinite where a formula has none.
        shown: values from and to which the picture goes; a naive curve may leave it.
        scales: of the axes, as matplotlib names them.
    """

    title: str
    across: str
    up: str
    at: Numbers
    ours: Numbers
    naive: Numbers
    truth: Numbers
    shown: tuple[float, float]
    scales: tuple[str, str] = ("linear", "linear")
