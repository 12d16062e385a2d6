"""Points, smooth normals and tangent frames of all texels of a posed mesh in a few passes."""

from __future__ import annotations

from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Float64

from pipeline.geometry.texels import MIN_TANGENT_SINE, Atlas

kernel = numba.njit(nogil=True, cache=True, error_model="numpy")


def texel_surface(
    atlas: Atlas, vertices: Float[np.ndarray, "v 3"]
) -> tuple[Float64[np.ndarray, "t 3"], Float64[np.ndarray, "t 3"], Float64[np.ndarray, "t 3"]]:
    """Point, smooth unit normal and unit normal of the face at each texel.

    The first two as `texel_frames` has them, some thirty times as fast. A face without area has the normal 0.

    Args:
        atlas: NumPy.
        vertices: posed, in the template's vertex order; the points are in their unit.
    """
    vertices, faces = np.ascontiguousarray(vertices, np.float64), atlas.faces
    flat, sums = np.empty((len(faces), 3)), np.zeros((len(vertices), 3))
    _face_normals(vertices, faces, atlas.weld, flat, sums)
    arrays = np.empty((3, atlas.texel_count, 3))
    _interpolate(atlas.face, faces, atlas.barycentric, atlas.weld, vertices, sums, flat, *arrays)
    return arrays[0], arrays[1], arrays[2]


def surface_frames(
    atlas: Atlas, vertices: Float[np.ndarray, "v 3"]
) -> tuple[Float64[np.ndarray, "t 3"], Float64[np.ndarray, "t 3 3"]]:
    """Point and tangent frame of each texel, as `texel_frames` has them, some ten times as fast.

    Args:
        atlas: NumPy.
        vertices: posed, in the template's vertex order; the points are in their unit.
    """
    points, normals, _ = texel_surface(atlas, vertices)
    frames = np.empty((atlas.texel_count, 3, 3))
    corners = np.ascontiguousarray(vertices, np.float64)
    _turn_tangents(atlas.face, atlas.faces, atlas.tangent_weights, corners, normals, MIN_TANGENT_SINE**2, frames)
    return points, frames


@kernel
@no_type_check  # keeps the tests' run-time shape checks out of compiled code
def _unit(x, y, z):
    """The vector at unit length, or 0; the largest component is divided out first, so that no square underflows."""
    largest = max(abs(x), abs(y), abs(z))
    if not largest > 0:
        return 0.0, 0.0, 0.0
    x, y, z = x / largest, y / largest, z / largest
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@kernel
@no_type_check
def _face_normals(vertices, faces, weld, flat, sums):
    """Unit normals per face, and at the vertex that stands for a place the sum of area vectors around it, of unit
    length in the end."""
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


@kernel
@no_type_check
def _interpolate(face, faces, barycentric, weld, vertices, smooth, flat, points, normals, face_normals):
    """Barycentric means per texel; where the normals' mean vanishes, the face's normal, or else +z."""
    for i in range(face.shape[0]):
        f = face[i]
        x, y, z, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(3):
            v, weight = faces[f, k], np.float64(barycentric[i, k])
            w = weld[v]
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


@kernel
@no_type_check
def _across(x, y, z, nx, ny, nz):
    """The part of a vector that is orthogonal to n."""
    along = x * nx + y * ny + z * nz
    return x - along * nx, y - along * ny, z - along * nz


@kernel
@no_type_check
def _turn_tangents(face, faces, tangent_weights, vertices, normals, least_sine2, frames):
    """Frames with columns t, b, n; `texel_frames` says how each is found."""
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
