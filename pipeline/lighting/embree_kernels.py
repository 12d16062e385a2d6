"""Loops that ask Embree for rays: whether anything is in the way, or what comes first.

Its functions are called by name; `pipeline.lighting.embree` makes them known.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import types

from pipeline.base.kernel_cache import kernel_part, unlocked_kernel

WORDS, ALIGNED = 32, 4
"""Words of four bytes that a ray with its hit takes at most (RTCRayHit), and that it has to lie on a multiple of."""

START, WAY, LENGTH, MASK, BARYCENTRIC, FACE = 0, 4, 8, 9, 15, 17
"""Places in RTCRayHit of org, dir, tfar, mask, u and v, and primID."""

EVERYTHING = np.uint32(0xFFFFFFFF)
"""Mask of a ray that meets all geometry; also RTC_INVALID_GEOMETRY_ID."""

_ASK = types.void(types.uintp, types.uintp, types.uintp)
_occluded = types.ExternalFunction("rtcOccluded1", _ASK)
_intersect = types.ExternalFunction("rtcIntersect1", _ASK)


@kernel_part(inline=True)
@no_type_check
def room_for_ray():
    """A ray with its hit, to be written over and over; it meets all geometry."""
    room = np.zeros(WORDS + ALIGNED, np.float32)
    skipped = (-(np.int64(room.ctypes.data) // 4)) % ALIGNED
    ray = room[skipped : skipped + WORDS]
    ray.view(np.uint32)[MASK] = EVERYTHING
    return ray


@kernel_part(inline=True)
@no_type_check
def write_ray(ray, r, origins, directions, length):
    """Write where a ray starts and goes."""
    ray[START], ray[START + 1], ray[START + 2] = origins[r, 0], origins[r, 1], origins[r, 2]
    ray[WAY], ray[WAY + 1], ray[WAY + 2] = directions[r, 0], directions[r, 1], directions[r, 2]
    ray[LENGTH] = length


@kernel_part(inline=True)
@no_type_check
def meets_something(scene, ray, r, origins, directions, length):
    """True if anything is in the way of a ray, which is written to `ray`."""
    write_ray(ray, r, origins, directions, length)
    _occluded(scene, ray.ctypes.data, 0)
    return ray[LENGTH] < 0  # Embree sets the length of a ray that meets something to minus infinity.


@unlocked_kernel
@no_type_check
def find_occluded(scene, origins, directions, lengths, hits):
    """Write -1 for each ray that meets nothing on its length, else 0."""
    ray = room_for_ray()
    for r in range(hits.shape[0]):
        hits[r] = 0 if meets_something(scene, ray, r, origins, directions, lengths[r]) else -1


@unlocked_kernel
@no_type_check
def find_nearest(scene, origins, directions, lengths, faces, distances, barycentric):
    """Write the first face on each ray's length, how far it is, and where it is hit.

    Args:
        faces: -1 where there is none; then `distances` has the length, and `barycentric` what it had before.
        barycentric: weights of a face's second and third corner [., 2].
    """
    ray = room_for_ray()
    words = ray.view(np.uint32)
    for r in range(faces.shape[0]):
        write_ray(ray, r, origins, directions, lengths[r])
        words[FACE : FACE + 4] = EVERYTHING
        _intersect(scene, ray.ctypes.data, 0)
        distances[r], faces[r] = ray[LENGTH], -1
        if words[FACE] != EVERYTHING:
            faces[r] = np.int32(words[FACE])
            barycentric[r, 0], barycentric[r, 1] = ray[BARYCENTRIC], ray[BARYCENTRIC + 1]
