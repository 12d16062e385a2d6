"""Lens models: OpenCV's perspective lens and its fisheye. Another is another class here, and its line in `LENSES`."""

from __future__ import annotations

import math

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float64

from pipeline.geometry.lens import Coefficients, Lens, LensJacobian, Points

AnyFloat = np.ndarray | np.floating
"""What indexing leaves of an array: of one point, a scalar."""

EXACT_TURNS = 60
"""Bisections that an inversion falls back on at most: each halves an angle of at most pi, and 2^-52 is float64."""


class BrownConrady(Lens):
    """OpenCV's perspective lens: a radial polynomial of the slope and two tangential terms.

    Brown (1966).
    """

    name = "brown_conrady"
    terms = ("k1", "k2", "p1", "p2", "k3")
    prior_sigma = (0.5, 0.5, 0.01, 0.01, 0.5)  # the spread of ordinary lenses from 10 to 90 degrees
    term_counts = (0, 1, 2, 5)
    perspective = True

    def distort(self, points: Points, coefficients: Coefficients) -> Float[np.ndarray, "*points 2"]:
        """Apply the radial and the tangential terms to the slope x / z, y / z."""
        slope = points[..., :2] / points[..., 2:]
        _, _, x, y = self._bend(slope[..., 0], slope[..., 1], coefficients)
        return np.stack([x, y], -1)

    @staticmethod
    def _bend(x: AnyFloat, y: AnyFloat, coefficients: np.ndarray) -> tuple[AnyFloat, ...]:
        """Squared radius, radial factor, distorted x and y of coordinates on the plane z = 1."""
        k1, k2, p1, p2, k3 = np.moveaxis(coefficients, -1, 0) if coefficients.ndim > 1 else coefficients
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return r2, radial, xd, yd

    def jacobian(
        self, points: Float64[np.ndarray, "n 3"], coefficients: Coefficients, focal: Float64[np.ndarray, "n 2"]
    ) -> LensJacobian:
        """Differentiate by hand; exact, also at the centre."""
        depth = points[:, 2]
        x, y = points[:, 0] / depth, points[:, 1] / depth
        r2, radial, xd, yd = self._bend(x, y, coefficients)
        k1, k2, p1, p2, k3 = coefficients.T
        fx, fy = focal.T
        by_terms = np.stack([
            np.stack([fx * x * r2, fx * x * r2**2, 2 * fx * x * y, fx * (r2 + 2 * x * x), fx * x * r2**3], 1),
            np.stack([fy * y * r2, fy * y * r2**2, fy * (r2 + 2 * y * y), 2 * fy * x * y, fy * y * r2**3], 1),
        ], 1)  # fmt: skip
        slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)  # of `radial` by r2
        cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        by_xy = np.stack([
            np.stack([fx * (radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x), fx * cross], -1),
            np.stack([fy * cross, fy * (radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x)], -1),
        ], 1)  # fmt: skip
        by_point = np.concatenate([by_xy, -by_xy @ np.stack([x, y], -1)[..., None]], -1) / depth[:, None, None]
        return np.stack([xd, yd], -1), by_point, by_terms

    def undistort(
        self, pixels: Float[np.ndarray, "n 2"], K: Float64[np.ndarray, "3 3"], coefficients: Coefficients
    ) -> Float64[np.ndarray, "n 3"]:
        """Iterate as OpenCV does.

        Always finite, but no ray of the lens where the polynomial has stopped growing.
        """
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
        # K and the pixels share one convention, so OpenCV's pixel centres cancel out here.
        points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        xy = cv2.undistortPoints(points, K, coefficients, criteria=criteria).reshape(-1, 2)
        return np.concatenate([xy, np.ones((len(xy), 1))], 1)

    def sees(self, points: Points, coefficients: Coefficients) -> Bool[np.ndarray, "*points"]:
        """Mask of the points in front of the camera."""
        return points[..., 2] > 0


class KannalaBrandt(Lens):
    """OpenCV's fisheye: theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

    Distorted coordinates lie at theta_d from the centre for a direction theta from the optical axis (Kannala and Brandt
    2006, equation 6, with the first coefficient in the focal length). The field of view ends where theta_d stops
    growing, or at 180 degrees.
    """

    name = "fisheye"
    terms = ("k1", "k2", "k3", "k4")
    prior_sigma = (1 / 3, 2 / 15, 17 / 315, 62 / 2835)
    """Those of tan theta, a pinhole: no standard projection (stereographic, equisolid, orthographic) is bent more."""
    term_counts = (0, 1, 2, 4)
    perspective = False

    def distort(self, points: Points, coefficients: Coefficients) -> Float[np.ndarray, "*points 2"]:
        """Place points at theta_d from the centre.

        Those exactly behind the camera, which belong anywhere on a circle, at x > 0.
        """
        _, theta, direction = self._polar(points)
        return (theta * self._growth(theta, coefficients))[..., None] * direction

    def jacobian(
        self, points: Float64[np.ndarray, "n 3"], coefficients: Coefficients, focal: Float64[np.ndarray, "n 2"]
    ) -> LensJacobian:
        """Differentiate by hand.

        Finite on the axis, where the quotients of the definition are 0 / 0.
        """
        r, theta, direction = self._polar(points)
        z, distance2 = points[:, 2], r * r + points[:, 2] ** 2
        theta_d = theta * self._growth(theta, coefficients)
        slope = self._slope(theta, coefficients)
        with np.errstate(divide="ignore", invalid="ignore"):  # at the centre of projection nothing has a limit
            along = slope * z / distance2
            inward = slope / distance2
            # theta_d / r is 1 / z on the axis in front; behind, where it has no limit, the point is taken to stay.
            across = np.where(r > 0, theta_d / np.where(r > 0, r, 1), np.where(z > 0, 1 / z, 0))
        outer = direction[:, :, None] * direction[:, None, :]
        by_xy = across[:, None, None] * np.eye(2) + (along - across)[:, None, None] * outer
        by_point = focal[:, :, None] * np.concatenate([by_xy, -(inward[:, None] * points[:, :2])[..., None]], -1)
        odd_powers = theta[:, None] ** np.array([3, 5, 7, 9])
        by_terms = (focal * direction)[:, :, None] * odd_powers[:, None, :]
        return theta_d[:, None] * direction, by_point, by_terms

    def undistort(
        self, pixels: Float[np.ndarray, "n 2"], K: Float64[np.ndarray, "3 3"], coefficients: Coefficients
    ) -> Float64[np.ndarray, "n 3"]:
        """Invert theta_d; NaN beyond the field of view."""
        at = (np.asarray(pixels, np.float64) - K[:2, 2]) / np.diag(K)[:2]
        theta_d, _, direction = self._polar(np.concatenate([at, np.ones((len(at), 1))], 1))
        theta = self._angle(theta_d, coefficients)
        return np.concatenate([np.sin(theta)[:, None] * direction, np.cos(theta)[:, None]], 1)

    def sees(self, points: Points, coefficients: Coefficients) -> Bool[np.ndarray, "*points"]:
        """Mask of the points within the field of view."""
        return self._polar(points)[1] <= self.largest_angle(coefficients)

    def largest_angle(self, coefficients: Float64[np.ndarray, " 4"]) -> float:
        """Angle from the optical axis, radians, up to which theta_d grows; at most pi."""
        roots = np.roots([*(np.array([9, 7, 5, 3]) * coefficients[::-1]), 1.0])  # of d theta_d / d theta, in theta^2
        real = roots.real[(np.abs(roots.imag) == 0) & (roots.real > 0)]
        return min(math.sqrt(real.min()), math.pi) if len(real) else math.pi

    @staticmethod
    def _polar(points: np.ndarray) -> tuple[AnyFloat, AnyFloat, np.ndarray]:
        """Distance from the optical axis, angle with it, and direction around it; on the axis, that of x."""
        r = np.hypot(points[..., 0], points[..., 1])
        direction = np.where(r[..., None] > 0, points[..., :2], [1.0, 0.0]) / np.where(r > 0, r, 1)[..., None]
        return r, np.arctan2(r, points[..., 2]), direction

    @staticmethod
    def _growth(theta: AnyFloat, coefficients: np.ndarray) -> AnyFloat:
        """theta_d / theta."""
        k1, k2, k3, k4 = np.moveaxis(coefficients, -1, 0)
        square = theta * theta
        return 1 + square * (k1 + square * (k2 + square * (k3 + square * k4)))

    def _slope(self, theta: AnyFloat, coefficients: np.ndarray) -> AnyFloat:
        """d theta_d / d theta."""
        return self._growth(theta, coefficients * np.array([3, 5, 7, 9]))

    def _angle(self, theta_d: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        """theta of theta_d by Newton's method, kept within a bisected bracket; NaN outside the field of view."""
        largest = self.largest_angle(coefficients)
        low, high = np.zeros_like(theta_d), np.full_like(theta_d, largest)
        theta = np.minimum(theta_d, largest)
        for _ in range(EXACT_TURNS):
            error = theta * self._growth(theta, coefficients) - theta_d
            low, high = np.where(error < 0, theta, low), np.where(error > 0, theta, high)
            slope = self._slope(theta, coefficients)
            step = theta - error / np.where(slope > 0, slope, np.inf)
            better = np.where((step >= low) & (step <= high) & (slope > 0), step, (low + high) / 2)
            if np.array_equal(better, theta, equal_nan=True):
                break
            theta = np.where(error == 0, theta, better)
        return np.where(theta_d <= largest * self._growth(np.float64(largest), coefficients), theta, np.nan)


BROWN_CONRADY = BrownConrady()
FISHEYE = KannalaBrandt()
LENSES: dict[str, Lens] = {lens.name: lens for lens in (BROWN_CONRADY, FISHEYE)}
"""Every lens, by its name."""
