"""Rigs with planted truth: cameras, and lights around a subject.

- `cameras`: a rig that sees boards; `camera_files`: two cameras as other programs write them.
- `light_stage`: a figure under a planted log of patterns; `random_lights`: points and lights at random.
"""
