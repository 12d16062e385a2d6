"""Cameras, rotations, meshes, skins and texels."""
