"""Avatars small enough to train in a test, with planted truth.

- `sheet`: a flat sheet under lights; `sheet_subject`: its shards in files; `variants`: settings of avatars of it.
- `heads`: a folded sheet as a head; `eyeballs`: a template of two eyes.
- `splat_viewer`: draws the .ply of splats without code of the project.
"""
