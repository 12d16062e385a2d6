"""Explicit eyes of a head avatar: texels on spheres, reflections, lids, albedo, gaze."""
