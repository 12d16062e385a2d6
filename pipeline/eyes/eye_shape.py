"""The explicit eye: eyeball and cornea, two spheres that overlap (RGCA section 3.4).

The eyeball's centre c_e is the origin here. Its surface is that of the union of a ball of radius r_e and a ball of
radius r_c around d g, where g is the eye's axis. Seen from c_e it has one point in every direction, so that a texel of
the eye is a direction, whatever the radii are. NumPy and torch alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from jaxtyping import Bool, Float

from pipeline.base.array_module import Array, array_module
from pipeline.geometry.mesh import unit_or
from pipeline.geometry.rotations import matrix_from_quaternion

CORNEA_PER_EYE = 0.65
"""Radius of a cornea over that of its eyeball: 7.8 mm (the anterior surface of Gullstrand's eye is 7.7 mm) over 12 mm,
half of an eye's usual length."""

LIMBUS_PER_EYE = 0.49
"""Radius of the circle where cornea and eyeball meet over that of the eyeball: a visible iris of 11.8 mm, halved, over
12 mm."""

SHORTEST_GAZE = 1e-12
"""Added under the root of a gaze's length (squared): keeps the slope at length zero finite."""


@dataclass(frozen=True)
class EyeShape:
    """Two spheres, metres.

    Attributes:
        radius_m: r_e of the eyeball.
        cornea_radius_m: r_c.
        cornea_offset_m: d, from the eyeball's centre to the cornea's along the axis; with d = 0 and r_c = r_e the eye
            is a plain sphere.
    """

    radius_m: float
    cornea_radius_m: float
    cornea_offset_m: float

    @property
    def is_sphere(self) -> bool:
        """True if no cornea stands out."""
        return self.cornea_offset_m + self.cornea_radius_m <= self.radius_m

    @property
    def limbus_angle(self) -> float:
        """Angle from the axis at which the spheres meet, seen from c_e, radians.

        0 for a plain sphere.
        """
        if self.is_sphere:
            return 0.0
        r, c, d = self.radius_m, self.cornea_radius_m, self.cornea_offset_m
        return math.acos(min(1.0, max(-1.0, (r * r + d * d - c * c) / (2 * r * d))))

    def fault(self) -> str:
        """Sentence that says why this is no eye, or nothing."""
        r, c, d = self.radius_m, self.cornea_radius_m, self.cornea_offset_m
        if not (all(map(math.isfinite, (r, c, d))) and r > 0 and c > 0 and d >= 0):
            return f"expected positive radii and an offset of at least 0, found {r:g}, {c:g} and {d:g} m"
        if not self.is_sphere and c >= r:
            return f"expected a cornea that is smaller than its eyeball ({1e3 * r:.2f} mm), found {1e3 * c:.2f} mm"
        if not self.is_sphere and d * d > c * c + r * r:
            # Rays from c_e that touch the cornea's sphere do so sqrt(d^2 - r_c^2) away: outside of the eyeball then.
            return f"expected a cornea that sinks into its eyeball, found its centre {1e3 * d:.2f} mm away"
        return ""


def usual_shape(radius_m: float) -> EyeShape:
    """An eyeball of this radius with the cornea that eyes of its size have on average."""
    cornea, limbus = CORNEA_PER_EYE * radius_m, LIMBUS_PER_EYE * radius_m
    offset = math.sqrt(radius_m**2 - limbus**2) - math.sqrt(cornea**2 - limbus**2)
    return EyeShape(radius_m, cornea, offset)


@dataclass(frozen=True)
class EyeSurface:
    """Points of eyes, relative to their centres.

    Attributes:
        points: in the unit of the radii.
        normals: of length one, outwards.
        on_cornea: which of them belong to the cornea's sphere.
    """

    points: Float[Array, "*n 3"]
    normals: Float[Array, "*n 3"]
    on_cornea: Bool[Array, "*n"]


def eye_surface(
    directions: Float[Array, "*n 3"],
    axes: Float[Array, "*#n 3"],
    radius: Float[Array, "*#n"] | float,
    cornea_radius: Float[Array, "*#n"] | float,
    cornea_offset: Float[Array, "*#n"] | float,
) -> EyeSurface:
    """Surface of eyes in unit directions w from c_e.

    It is rho w with rho the larger of r_e and of the far root t of |t w - d g| = r_c, which is
    d u + sqrt(r_c^2 - d^2 (1 - u^2)) with u = w . g.

    Finite, with finite gradients, for all positive radii, also those of no eye (`EyeShape.fault`): where the cornea's
    sphere is not met, the surface is the eyeball's; a cornea that holds the whole eyeball is the whole surface.
    """
    xp = array_module(directions)
    along = (directions * axes).sum(-1)
    below_root = cornea_radius**2 - cornea_offset**2 * (1 - along * along)
    met = below_root > 0
    # Under the root first: its slope at zero would make the gradient NaN, chosen or not.
    root = xp.sqrt(xp.where(met, below_root, xp.ones_like(below_root)))
    cornea = cornea_offset * along + root
    on_cornea = met & (cornea > radius)
    points = xp.where(on_cornea, cornea, radius + 0 * along)[..., None] * directions
    middle = _column(cornea_offset) * axes
    return EyeSurface(
        points, xp.where(on_cornea[..., None], unit_or(points - middle, directions), directions), on_cornea
    )


def _column(values: Array | float) -> Array | float:
    return values if isinstance(values, float) else values[..., None]


def turn_to(axis: Float[Array, "*n 3"], gaze: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Shortest rotation from the unit vectors `axis` to `gaze`, of any length.

    An eye that turns from where it rests does not roll about its axis (Listing's law).

    A gaze of length zero says nothing: the eye rests. So does, for want of one shortest way, the opposite direction.
    """
    xp = array_module(axis)
    length = xp.sqrt((gaze * gaze).sum(-1) + SHORTEST_GAZE**2)
    # |g| (cos, sin) of the angle, halved by adding (|g|, 0).
    half = [(length + (axis * gaze).sum(-1))[..., None], xp.linalg.cross(axis, gaze)]
    return matrix_from_quaternion(xp.concatenate(half, -1))
