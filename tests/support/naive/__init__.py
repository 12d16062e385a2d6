"""Textbook formulas as they are usually written, which hard cases break; tests and pictures show ours beside them.

- `shading`: highlights, lobes, light on a point, the transfer function.
- `motions`: logarithm and derivative of rotations, quaternions.
- `surfaces`: normals, rays of lenses, shadow rays, footprints of Gaussians.

Splatting and marching as a whole are in `tests.support.avatars`.
"""
