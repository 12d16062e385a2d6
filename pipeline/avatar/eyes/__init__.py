"""Explicit eyes of a head avatar: texels on two spheres, corneal reflections, lids, albedo, gaze."""
