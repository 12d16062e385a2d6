"""The seam of lens models: project directions to the image plane and back, with derivatives.

A lens takes points in camera coordinates to distorted coordinates, which the intrinsic matrix turns into pixels. It is
stateless: its coefficients are an argument, because a bundle adjustment varies those of many cameras at once. Those
that there are stand in `pipeline.geometry.lenses`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float64

Points = Float[np.ndarray, "*points 3"]
"""In camera coordinates."""

Coefficients = Float64[np.ndarray, "*_ terms"]
"""Of one lens, or of one lens per point."""

LensJacobian = tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, "n 2 3"], Float64[np.ndarray, "n 2 terms"]]


class Lens(ABC):
    """A lens model.

    Attributes:
        name: what cameras.json and capture.yaml call it.
        terms: its coefficients in OpenCV's order, each zero where a lens has no faults.
        prior_sigma: of each term, about the spread of ordinary lenses: the prior's standard deviation.
        term_counts: numbers of leading terms that make a model of their own; the last one is all of them.
        perspective: whether an undistorted image is a pinhole's; otherwise directions at 90 degrees from the optical
            axis and beyond may be imaged, too.
    """

    name: ClassVar[str]
    terms: ClassVar[tuple[str, ...]]
    prior_sigma: ClassVar[tuple[float, ...]]
    term_counts: ClassVar[tuple[int, ...]]
    perspective: ClassVar[bool]

    @abstractmethod
    def distort(self, points: Points, coefficients: Coefficients) -> Float[np.ndarray, "*points 2"]:
        """Distorted coordinates of points; `sees` says for which they mean something."""

    @abstractmethod
    def jacobian(
        self, points: Float64[np.ndarray, "n 3"], coefficients: Coefficients, focal: Float64[np.ndarray, "n 2"]
    ) -> LensJacobian:
        """Distorted coordinates, and the derivatives of `focal` times them.

        By the point and by the coefficients.
        """

    @abstractmethod
    def undistort(
        self, pixels: Float[np.ndarray, "n 2"], K: Float64[np.ndarray, "3 3"], coefficients: Coefficients
    ) -> Float64[np.ndarray, "n 3"]:
        """Rays (of any length) in camera coordinates through pixels; NaN where nothing is imaged."""

    @abstractmethod
    def sees(self, points: Points, coefficients: Coefficients) -> Bool[np.ndarray, "*points"]:
        """Mask of the points that are imaged: in front of the lens, or in its field of view."""

    def no_distortion(self) -> Float64[np.ndarray, " terms"]:
        """The coefficients of a lens without faults."""
        return np.zeros(len(self.terms))
