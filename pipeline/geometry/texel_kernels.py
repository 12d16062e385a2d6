"""Normals of faces, and what texels interpolate of a posed mesh.

The loops of `pipeline.geometry.texel_surface`.
"""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from pipeline.base.kernel_cache import unlocked_kernel


@unlocked_kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _unit(x, y, z):
    """The vector at unit length, or 0; the largest component is divided out first, so that no square underflows."""
    largest = max(abs(x), abs(y), abs(z))
    if not largest > 0:
        return 0.0, 0.0, 0.0
    x, y, z = x / largest, y / largest, z / largest
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@unlocked_kernel
@no_type_check
def face_and_vertex_normals(vertices, faces, weld, flat, sums):
    """Write the unit normal of each face, and of each place where vertices are welded.

    The latter is along the sum of the area vectors around it, and stands at the vertex that stands for the place.
    """
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = (
            vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        )  # fmt: skip
        vx, vy, vz = (
            vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        )  # fmt: skip
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        flat[f, 0], flat[f, 1], flat[f, 2] = _unit(x, y, z)
        for k in range(3):
            w = weld[faces[f, k]]
            sums[w, 0], sums[w, 1], sums[w, 2] = sums[w, 0] + x, sums[w, 1] + y, sums[w, 2] + z
    for v in range(sums.shape[0]):
        sums[v, 0], sums[v, 1], sums[v, 2] = _unit(sums[v, 0], sums[v, 1], sums[v, 2])


@unlocked_kernel
@no_type_check
def interpolate(face, faces, barycentric, weld, vertices, smooth, flat, points, normals, face_normals):
    """Write barycentric means per texel.

    Where the normals' mean vanishes, the face's normal stands for it, or else +z. Indices are unsigned, since numba
    checks others for being negative.
    """
    for i in range(face.shape[0]):
        f = np.uint32(face[i])
        x, y, z, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            v, weight = np.uint32(faces[f, k]), np.float64(barycentric[i, k])
            w = np.uint32(weld[v])
            x, y, z = x + weight * vertices[v, 0], y + weight * vertices[v, 1], z + weight * vertices[v, 2]
            nx, ny, nz = nx + weight * smooth[w, 0], ny + weight * smooth[w, 1], nz + weight * smooth[w, 2]
        nx, ny, nz = _unit(nx, ny, nz)
        fx, fy, fz = flat[f, 0], flat[f, 1], flat[f, 2]
        if nx == 0 and ny == 0 and nz == 0:
            nx, ny, nz = fx, fy, fz
            if nx == 0 and ny == 0 and nz == 0:
                nz = 1.0
        points[i, 0], points[i, 1], points[i, 2] = x, y, z
        normals[i, 0], normals[i, 1], normals[i, 2] = nx, ny, nz
        face_normals[i, 0], face_normals[i, 1], face_normals[i, 2] = fx, fy, fz


@unlocked_kernel
@no_type_check
def _across(x, y, z, nx, ny, nz):
    """The part of a vector that is orthogonal to n."""
    along = x * nx + y * ny + z * nz
    return x - along * nx, y - along * ny, z - along * nz


@unlocked_kernel
@no_type_check
def turn_tangents(face, faces, tangent_weights, vertices, normals, least_sine2, frames):
    """Write frames with columns t, b, n; `texel_frames` says how each is found."""
    for i in range(face.shape[0]):
        a = faces[face[i], 0]
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        x, y, z = 0.0, 0.0, 0.0
        for k in range(1, 3):
            v, weight = faces[face[i], k], np.float64(tangent_weights[i, k])
            x += weight * (vertices[v, 0] - vertices[a, 0])
            y += weight * (vertices[v, 1] - vertices[a, 1])
            z += weight * (vertices[v, 2] - vertices[a, 2])
        x, y, z = _unit(x, y, z)
        x, y, z = _across(x, y, z, nx, ny, nz)
        if not x * x + y * y + z * z > least_sine2:
            sign = -1.0 if nz < 0 else 1.0
            part = -1 / (sign + nz)
            x, y, z = 1 + sign * nx * nx * part, sign * nx * ny * part, -sign * nx
        x, y, z = _unit(x, y, z)
        x, y, z = _across(x, y, z, nx, ny, nz)
        x, y, z = _unit(x, y, z)
        frames[i, 0, 0], frames[i, 1, 0], frames[i, 2, 0] = x, y, z
        frames[i, 0, 1], frames[i, 1, 1], frames[i, 2, 1] = ny * z - nz * y, nz * x - nx * z, nx * y - ny * x
        frames[i, 0, 2], frames[i, 1, 2], frames[i, 2, 2] = nx, ny, nz
