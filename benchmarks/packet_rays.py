"""The rays of a map asked of Embree eight at a time: what packets could win."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numba import njit, types

from pipeline.lighting.embree import EmbreeMesh
from pipeline.lighting.shadow_rays import Rays

WIDTH, ALIGNED = 8, 8
"""Rays of a packet, and words of four bytes that it has to lie on a multiple of."""

START, WAY, LENGTH, MASK, WORDS = 0, 4, 8, 9, 12
"""Places in RTCRay8 of org, dir, tfar and mask, and how many there are; each has eight values."""

COHERENT = 1 << 16
"""RTC_RAY_QUERY_FLAG_COHERENT: the rays of a packet go about the same way, and are followed together."""

_occluded = types.ExternalFunction("rtcOccluded8", types.void(*[types.uintp] * 4))


@njit(nogil=True)
@no_type_check
def _aligned(count):
    room = np.zeros(count + ALIGNED, np.float32)
    skipped = (-(np.int64(room.ctypes.data) // 4)) % ALIGNED
    return room[skipped : skipped + count]


@njit(nogil=True)
@no_type_check
def _ask(scene, origins, directions, lengths, flags, hits):
    """Write 0 for each ray that meets something, and -1 for the others, as `find_occluded` does."""
    packet, taken, options = _aligned(WORDS * WIDTH), _aligned(WIDTH).view(np.int32), np.zeros(8, np.uint64)
    options.view(np.uint32)[:2] = flags, 0xFFFFFFFF
    packet.view(np.uint32)[MASK * WIDTH : (MASK + 1) * WIDTH] = 0xFFFFFFFF
    for first in range(0, len(hits), WIDTH):
        count = min(WIDTH, len(hits) - first)
        for lane in range(WIDTH):
            r = first + min(lane, count - 1)
            for k in range(3):
                packet[(START + k) * WIDTH + lane] = origins[r, k]
                packet[(WAY + k) * WIDTH + lane] = directions[r, k]
            packet[LENGTH * WIDTH + lane], taken[lane] = lengths[r], -1 if lane < count else 0
        _occluded(taken.ctypes.data, scene, packet.ctypes.data, options.ctypes.data)
        for lane in range(count):
            hits[first + lane] = 0 if packet[LENGTH * WIDTH + lane] < 0 else -1


def packet_answers(mesh: EmbreeMesh, rays: list[Rays], coherent: bool) -> list[np.ndarray]:
    """Whether each ray meets something, 0, or nothing, -1."""
    answers = [np.empty(len(some.rows), np.int32) for some in rays]
    for some, hits in zip(rays, answers, strict=True):
        _ask(mesh.handle, some.origins, some.directions, some.lengths, COHERENT * coherent, hits)
    return answers
