"""Visibility of subjectA's own figure to its own lights: Mitsuba's shadow rays and ours, pair by pair."""

from __future__ import annotations

from pathlib import Path

import mitsuba
import numpy as np
import trimesh

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.lighting.visibility import Occluders
from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.stage_rig import build_stage_rig
from tests.support.meshes.lit_meshes import random_points

POINTS = 2000
AGREEMENT = 0.995
"""The rest are pairs whose ray passes an edge by less than the two programs' offsets differ."""


def test_shadow_rays_agree(tmp_path: Path) -> None:
    settings = SynthesizeCapture()
    figure = build_figure("subjectA", settings.vertex_spacing_m, 64, settings.gloss_alpha)
    vertices = figure.at(0.7, "a").vertices
    lights = build_stage_rig("subjectA", settings).lights_xyz
    points, normals = random_points(vertices, figure.faces, POINTS)

    occluders = Occluders(vertices, figure.faces)
    ours = np.stack([occluders.visible(points, normals, light)[0] for light in lights])

    mitsuba.set_variant("scalar_rgb")
    trimesh.Trimesh(vertices, figure.faces, process=False).export(tmp_path / "figure.ply")
    shape = {"type": "ply", "filename": str(tmp_path / "figure.ply"), "face_normals": True}
    scene = mitsuba.load_dict({"type": "scene", "figure": shape})
    theirs = np.zeros_like(ours)
    for i, (point, normal) in enumerate(zip(points, normals, strict=True)):
        # The point on the surface as Mitsuba has it, so that it chooses its own offset.
        hit = scene.ray_intersect(mitsuba.Ray3f(mitsuba.Point3f(point + 1e-4 * normal), mitsuba.Vector3f(-normal)))
        for j, light in enumerate(lights):
            above = float(np.dot(light - point, normal)) > 0
            theirs[j, i] = above and not scene.ray_test(hit.spawn_ray_to(mitsuba.Point3f(light)))
    assert 0.2 < ours.mean() < 0.6
    assert (ours == theirs).mean() >= AGREEMENT
