"""Splat files against trimesh's reader and the layout of the reference implementation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh

from pipeline.base.color import srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.rendering.splat_ply import Splats, read_splats, write_splats

REFERENCE = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]
"""`construct_list_of_attributes` of graphdeco-inria/gaussian-splatting, scene/gaussian_model.py, for SH degree 0."""


def some_splats(count: int = 7) -> Splats:
    generator = torch.Generator().manual_seed(0)
    means, normals, quaternions = (torch.randn(count, n, generator=generator) for n in (3, 3, 4))
    rgb, scales = torch.rand(count, 3, generator=generator), 10 ** (-3 * torch.rand(count, 3, generator=generator) - 1)
    opacities = torch.linspace(0.05, 0.95, count)
    return Splats(means, normals, rgb, opacities, scales, quaternions / quaternions.norm(dim=1, keepdim=True))


def test_layout_is_the_references(tmp_path) -> None:
    write_splats(tmp_path / "a.ply", some_splats())
    header, _, body = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 7"]
    assert lines[3:] == [f"property float {name}" for name in REFERENCE]
    assert len(body) == 7 * 4 * len(REFERENCE)


def test_another_reader_finds_the_activations_undone(tmp_path) -> None:
    splats = some_splats()
    write_splats(tmp_path / "a.ply", splats)
    vertex = trimesh.load(tmp_path / "a.ply").metadata["_ply_raw"]["vertex"]["data"]
    column = {name: np.asarray(vertex[name], np.float64).reshape(-1) for name in REFERENCE}
    means, rgb, scales, quaternions = (
        np.stack([column[f"{name}{axis}"] for axis in axes], 1)
        for name, axes in [("", "xyz"), ("f_dc_", "012"), ("scale_", "012"), ("rot_", "0123")]
    )
    np.testing.assert_array_equal(means, splats.means.double())
    np.testing.assert_allclose(0.28209479177387814 * rgb + 0.5, srgb_from_linear(splats.rgb_linear), atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-column["opacity"])), splats.opacities, rtol=1e-6)
    np.testing.assert_allclose(np.exp(scales), splats.scales, rtol=1e-6)
    np.testing.assert_allclose(quaternions, splats.quaternions, atol=1e-7)


def test_values_come_back(tmp_path) -> None:
    splats = some_splats()
    write_splats(tmp_path / "a.ply", splats)
    found = read_splats(tmp_path / "a.ply")
    for name in ("means", "normals", "rgb_linear", "opacities", "scales", "quaternions"):
        torch.testing.assert_close(getattr(found, name), getattr(splats, name), rtol=2e-6, atol=1e-6)


def test_extremes_stay_finite_and_colours_in_range(tmp_path) -> None:
    two = torch.zeros(2, 3)
    splats = Splats(
        two, two, torch.tensor([[-1.0, 0, 1], [2, math.inf, 0]]), torch.tensor([0.0, 1]), two, torch.zeros(2, 4)
    )
    write_splats(tmp_path / "a.ply", splats)
    found = read_splats(tmp_path / "a.ply")
    assert all(torch.isfinite(getattr(found, name)).all() for name in ("opacities", "scales", "quaternions"))
    torch.testing.assert_close(found.rgb_linear, torch.tensor([[0.0, 0, 1], [1, 1, 0]]), atol=1e-6, rtol=0)
    torch.testing.assert_close(found.opacities, torch.tensor([0.0, 1]), atol=2e-6, rtol=0)


def test_other_files_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="absent"):
        read_splats(tmp_path / "absent.ply")
    trimesh.creation.icosphere(1).export(tmp_path / "mesh.ply")
    with pytest.raises(InputError, match="float properties"):
        read_splats(tmp_path / "mesh.ply")
