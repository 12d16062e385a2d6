"""Colours made from known albedo, light and camera responses are taken apart again, highlights or not."""

from __future__ import annotations

import numpy as np

from pipeline.tracking.point_colors import AMBIENT, fit_point_colors


def test_planted_colours_are_explained() -> None:
    random = np.random.default_rng(0)
    albedo, light = random.uniform(0.1, 0.9, (300, 3)), random.uniform(0.5, 2.0, (4, 300))
    responses = np.eye(3) + 0.1 * random.uniform(-1, 1, (5, 3, 3))
    shading = light + AMBIENT * np.median(light, axis=1, keepdims=True)
    clean = np.einsum("cij,pj,fp->cfpi", responses, albedo, shading)
    observed = clean + 0.005 * random.normal(size=clean.shape)
    highlight = random.random(clean.shape[:3]) < 0.1
    observed[highlight] += 0.5
    seen = random.random(clean.shape[:3]) < 0.5
    colors = fit_point_colors(observed, seen, light)
    explained = np.einsum("cij,pj,fp->cfpi", colors.responses, colors.albedo, colors.shading)
    error = np.abs(explained - clean)[seen & ~highlight]
    assert np.median(error) < 0.005
    weight = colors.weight
    assert (weight[~seen] == 0).all()
    assert np.median(weight[seen & highlight]) < 0.05 * np.median(weight[seen & ~highlight])
    # Precision is one over the variance of a channel.
    assert 0.003 < np.median(weight[seen & ~highlight]) ** -0.5 < 0.01


def test_nothing_seen_is_no_error() -> None:
    colors = fit_point_colors(np.zeros((2, 3, 4, 3)), np.zeros((2, 3, 4), bool), np.ones((3, 4)))
    assert np.isfinite(colors.albedo).all()
    assert (colors.weight == 0).all()
