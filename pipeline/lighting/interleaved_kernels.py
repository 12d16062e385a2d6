"""Sums over the shadow rays of each texel's neighbours.

The loops of `pipeline.lighting.interleaved_sampling`.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.lighting.ray_kernels import ray_kernel

BLOCKED, CLEAR, BELOW_HORIZON = 0, 1, 2
"""What a shadow ray met; the light was below the horizon of those that were not cast."""


@ray_kernel
@no_type_check
def gather(
    points, normals, face_normals, lights, luminances, distant, least2, number, texel, chart, steps, shares, chosen,
    state, certainty, values, cosine_visibility, error,
):  # fmt: skip
    """Fill the three maps; see the module's docstring.

    Args:
        lights: x, then y, then z [3, lights].
        number: texel at each row and column of the map, or -1.
        steps, shares: rows and columns to each neighbour, and its weight.
        chosen, state: light of each draw and texel, and what its ray met.
        certainty: P_j of each light after 0, 1, ... draws [draws, lights].
    """
    m, side = lights.shape[1], number.shape[0]
    asked, clear, squares = np.zeros(m), np.zeros(m), np.zeros(m)
    light, fall = np.empty(m), np.empty(m)
    for i in range(points.shape[0]):
        draws = 0
        for s in range(steps.shape[0]):
            row, column = texel[i, 0] + steps[s, 0], texel[i, 1] + steps[s, 1]
            if row < 0 or column < 0 or row >= side or column >= side:
                continue
            k = number[row, column]
            if k < 0 or chart[k] != chart[i]:
                continue
            draws += chosen.shape[0]
            for d in range(chosen.shape[0]):
                if state[d, k] != BELOW_HORIZON:
                    j = chosen[d, k]
                    asked[j] += shares[s]
                    squares[j] += shares[s] * shares[s]
                    clear[j] += shares[s] * state[d, k]
        sent, above, fallen, fallen_above = strengths(
            points[i], normals[i], face_normals[i], lights, luminances, distant, least2, light, fall
        )
        seen, known, seen_fall, known_fall = 0.0, 0.0, 0.0, 0.0
        noise, mixed, missing = 0.0, 0.0, 0.0
        for j in range(m):
            if asked[j] == 0:
                continue
            share, several = clear[j] / asked[j], asked[j] * asked[j] / squares[j]
            asked[j], clear[j], squares[j] = 0.0, 0.0, 0.0
            drawn = certainty[draws, j]
            weight = light[j] / drawn
            seen += weight * share
            known += weight
            seen_fall += fall[j] / drawn * share
            known_fall += fall[j] / drawn
            if several > 1:  # the unbiased variance of the mean; what one draw found varies in no way that it shows
                noise += weight * weight * share * (1 - share) / (several - 1)
            lost = (1 - drawn) * weight * weight
            noise += lost * share * share
            mixed += lost * share
            missing += lost
        # Where no ray says anything, nothing is known to be in the way.
        ratio = seen / known if known > 0 else 1.0
        values[i] = ratio * above / sent
        cosine_visibility[i] = (
            (seen_fall / known_fall if known_fall > 0 else ratio) * fallen_above / fallen if fallen > 0 else 0.0
        )
        variance = max(noise - 2 * ratio * mixed + ratio * ratio * missing, 0.0)
        error[i] = np.sqrt(variance) / known * above / sent if known > 0 else 0.0


@ray_kernel
@no_type_check
def strengths(point, normal, face_normal, lights, luminances, distant, least2, light, fall):
    """L_j and L_j max(0, n . w_j) of every light, 0 below the face's horizon.

    Returns the sums of L_j over all lights and over those above the horizon, then both of the other.

    Without branches, so that four lights are computed at a time.
    """
    sent, above, fallen, fallen_above = 0.0, 0.0, 0.0, 0.0
    for j in range(luminances.shape[0]):
        dx, dy, dz, strength, inverse = lights[0, j], lights[1, j], lights[2, j], luminances[j], 1.0
        if not distant:
            dx, dy, dz = dx - point[0], dy - point[1], dz - point[2]
            squared = dx * dx + dy * dy + dz * dz
            inverse = 1.0 / np.sqrt(squared if squared > least2 else least2)
            strength *= inverse * inverse
        cosine = (dx * normal[0] + dy * normal[1] + dz * normal[2]) * inverse
        falls = strength * cosine if cosine > 0 else 0.0
        over = 1.0 if dx * face_normal[0] + dy * face_normal[1] + dz * face_normal[2] > 0 else 0.0
        light[j], fall[j] = over * strength, over * falls
        sent += strength
        fallen += falls
        above += over * strength
        fallen_above += over * falls
    return sent, above, fallen, fallen_above
