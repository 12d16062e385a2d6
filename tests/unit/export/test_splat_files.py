"""Gaussians in the formats of other programs: what independent readers find is what was written."""

from __future__ import annotations

import csv
import gzip
import io
import json
import shutil
import struct
import subprocess
import zipfile

import numpy as np
import pyarrow
import pygltflib
import pytest
import torch
import trimesh
from PIL import Image

from pipeline.base.color import srgb_from_linear
from pipeline.export.gaussian_gltf import write_gaussian_glb
from pipeline.export.sog import write_sog
from pipeline.export.spz import write_spz
from pipeline.rendering.splat_ply import SH_0, Splats, stored_splats, write_splats

SPLAT_TRANSFORM = shutil.which("splat-transform")
WRITERS = {"ply": write_splats, "spz": write_spz, "sog": write_sog, "glb": write_gaussian_glb}
NEWER_SPZ = "4.spz"

ROUNDING = {
    "ply": {"means": 0, "scales": 1e-6, "opacities": 1e-6, "srgb": 1e-6, "degrees": 1e-4},
    "spz": {"means": 0.5 / 4096, "scales": 0.032, "opacities": 0.5 / 255, "srgb": 0.0038, "degrees": 0.28},
    "sog": {"means": 5.1e-5, "scales": 0.01, "opacities": 0.5 / 255, "srgb": 0.002, "degrees": 1.1},
    "glb": {"means": 0, "scales": 1e-6, "opacities": 0, "srgb": 1e-6, "degrees": 1e-4},
}
"""Largest errors: metres, share of a scale, opacity, sRGB, angle. Of spz, half of 1/4096 m, of 1/16 of e and of 0.28 /
(0.15 x 255); of sog, half of 1/65535 of 2 ln 3, times 3, and of 1/255 of the spans drawn here. A
quaternion of three components that are off by d is off by 2 sqrt(3) d at most, and its angle by twice as much."""


@pytest.fixture(scope="module")
def splats():
    rng = np.random.default_rng(4)
    count = 500
    quaternions = rng.normal(size=(count, 4))
    quaternions[:8] = [*np.eye(4), *-np.eye(4)]  # the largest component in each place, with both signs
    normals = rng.normal(size=(count, 3))
    arrays = (
        rng.uniform(-2, 2, (count, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True),
        rng.random((count, 3)), rng.uniform(0.02, 0.98, count), np.exp(rng.uniform(-8, -4, (count, 3))),
        2.5 * quaternions,
    )  # fmt: skip
    return Splats(*(torch.tensor(array, dtype=torch.float32) for array in arrays))


@pytest.fixture(scope="module")
def folder(splats, tmp_path_factory):
    made = tmp_path_factory.mktemp("splats")
    for name, write in WRITERS.items():
        write(made / f"frame.{name}", splats)
    write_spz(made / f"frame.{NEWER_SPZ}", splats, version=4)
    return made


def assert_same(found, splats, name):
    """Columns by their names in a .ply, degrees of freedom and all, against what was written."""
    allowed = ROUNDING[name]
    stack = lambda *names: np.stack([found[each] for each in names], 1)  # noqa: E731
    np.testing.assert_allclose(stack(*"xyz"), splats.means.numpy(), rtol=0, atol=allowed["means"] + 1e-6)
    scales = np.exp(stack("scale_0", "scale_1", "scale_2"))
    np.testing.assert_allclose(scales, splats.scales.numpy(), rtol=allowed["scales"] + 1e-5)
    opacities = 1 / (1 + np.exp(-found["opacity"]))
    np.testing.assert_allclose(opacities, splats.opacities.numpy(), atol=allowed["opacities"] + 1e-5)
    srgb = SH_0 * stack("f_dc_0", "f_dc_1", "f_dc_2") + 0.5
    expected = srgb_from_linear(splats.rgb_linear).numpy()
    np.testing.assert_allclose(srgb, expected, atol=allowed["srgb"] + 1e-5)
    turns, quaternions = stack("rot_0", "rot_1", "rot_2", "rot_3"), splats.quaternions.numpy().astype(np.float64)
    one, other = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (turns, quaternions))
    chords = np.minimum(np.linalg.norm(one - other, axis=1), np.linalg.norm(one + other, axis=1))
    assert 4 * np.degrees(np.arcsin(chords / 2)).max() < allowed["degrees"]


@pytest.mark.parametrize("name", ["ply", "spz", NEWER_SPZ, "sog"])
def test_splat_transform_reads_what_was_written(splats, folder, name):
    if SPLAT_TRANSFORM is None:
        pytest.skip("no splat-transform: npm install -g @playcanvas/splat-transform")
    table = folder / f"{name}.csv"
    subprocess.run([SPLAT_TRANSFORM, "-q", "-w", folder / f"frame.{name}", table], check=True, capture_output=True)
    with open(table) as file:
        rows = list(csv.DictReader(file))
    found = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}
    if name.endswith("spz"):  # whose y and z it turns round to those of COLMAP's scenes, in positions and in axes
        found |= {key: -found[key] for key in ("y", "z", "rot_2", "rot_3")}
    assert_same(found, splats, name.rpartition(".")[2])


def test_ply_is_a_cloud_of_points_to_trimesh(splats, folder):
    cloud = trimesh.load(folder / "frame.ply")
    np.testing.assert_array_equal(cloud.vertices, splats.means.numpy())
    rows = cloud.metadata["_ply_raw"]["vertex"]["data"]
    assert_same({name: np.asarray(rows[name], np.float64).reshape(-1) for name in rows.dtype.names}, splats, "ply")


def test_spz_holds_what_its_layout_says(splats, folder):
    """By a reader of its own, from the format's description: bytes of columns, one column after the other."""
    content = gzip.decompress((folder / "frame.spz").read_bytes())
    magic, version, count, degree, bits, flags, _ = struct.unpack_from("<4sIIBBBB", content)
    assert (magic, version, count, degree, bits, flags) == (b"NGSP", 3, 500, 0, 12, 0)
    parts = np.split(np.frombuffer(content, np.uint8, offset=16), np.cumsum([9, 1, 3, 3]) * count)
    low, middle, high = parts[0].reshape(count, 3, 3).astype(np.int64).transpose(2, 0, 1)
    means = (low + 256 * middle + 65536 * high + 2**23) % 2**24 - 2**23
    found = dict(zip("xyz", means.T / 2**bits, strict=True))
    opacities = parts[1].astype(np.float64).clip(1, 254) / 255
    found["opacity"] = np.log(opacities / (1 - opacities))
    coefficients = (parts[2].reshape(count, 3) / 255 - 0.5) / 0.15
    scales = parts[3].reshape(count, 3) / 16 - 10.0
    found |= {f"f_dc_{k}": coefficients[:, k] for k in range(3)} | {f"scale_{k}": scales[:, k] for k in range(3)}
    xyzw = np.zeros((count, 4))
    for row, word in enumerate(parts[4].view("<u4").tolist()):
        largest = word >> 30
        for place in reversed([k for k in range(4) if k != largest]):
            sign = -1 if word >> 9 & 1 else 1
            xyzw[row, place] = sign * (word & 511) / 511 / np.sqrt(2)
            word >>= 10
        xyzw[row, largest] = np.sqrt(1 - np.square(xyzw[row]).sum())
    found |= {f"rot_{k}": xyzw[:, (k - 1) % 4] for k in range(4)}
    assert_same(found, splats, "spz")


def test_streams_of_newer_spz_are_the_content_of_the_older(folder):
    """By the table of sizes behind the header, and by Zstandard's own bytes at the head of each stream."""
    older, newer = gzip.decompress((folder / "frame.spz").read_bytes()), (folder / f"frame.{NEWER_SPZ}").read_bytes()
    header = struct.unpack_from("<4sIIBBBBI12s", newer)
    assert header == (b"NGSP", 4, 500, 0, 12, 0, 5, 32, bytes(12))
    sizes = np.frombuffer(newer, "<u8", 10, 32).reshape(5, 2)
    assert sizes[:, 1].tolist() == [500 * each for each in (9, 1, 3, 3, 4)]
    ends = 32 + 16 * 5 + np.cumsum(sizes[:, 0])
    assert ends[-1] == len(newer)
    streams = [newer[end - size : end] for end, size in zip(ends.tolist(), sizes[:, 0].tolist(), strict=True)]
    assert all(stream.startswith(bytes.fromhex("28b52ffd")) for stream in streams)
    full = [
        pyarrow.decompress(stream, size, "zstd", asbytes=True)
        for stream, size in zip(streams, sizes[:, 1], strict=True)
    ]
    assert b"".join(full) == older[16:]


def test_spz_refuses_what_lies_beyond_its_numbers(splats, tmp_path):
    far = Splats(1e4 * splats.means, *(getattr(splats, name) for name in list(vars(splats))[1:]))
    with pytest.raises(ValueError, match="less than 2048 m"):
        write_spz(tmp_path / "far.spz", far)


def test_sog_holds_what_its_layout_says(splats, folder):
    """By a reader of its own, from the format's description: pictures of bytes, and tables that they look up in."""
    with zipfile.ZipFile(folder / "frame.sog") as archive:
        meta = json.loads(archive.read("meta.json"))
        count = meta["count"]

        def texels(name):
            picture = Image.open(io.BytesIO(archive.read(name)))
            return np.asarray(picture.convert("RGBA")).reshape(-1, 4)[:count].astype(np.int64)

        assert (meta["version"], count) == (2, 500)
        low, high = (texels(name)[:, :3] for name in meta["means"]["files"])
        lows, highs = (np.array(meta["means"][name]) for name in ("mins", "maxs"))
        logs = lows + (highs - lows) * (low + 256 * high) / 65535
        found = dict(zip("xyz", (np.sign(logs) * np.expm1(np.abs(logs))).T, strict=True))
        scales = np.array(meta["scales"]["codebook"])[texels(meta["scales"]["files"][0])[:, :3]]
        colors = texels(meta["sh0"]["files"][0])
        coefficients = np.array(meta["sh0"]["codebook"])[colors[:, :3]]
        turns = texels(meta["quats"]["files"][0])
    opacities = colors[:, 3].clip(1, 254) / 255
    found["opacity"] = np.log(opacities / (1 - opacities))
    found |= {f"f_dc_{k}": coefficients[:, k] for k in range(3)} | {f"scale_{k}": scales[:, k] for k in range(3)}
    quaternions = np.zeros((count, 4))
    for row, (a, b, c, tag) in enumerate(turns):
        places = [k for k in range(4) if k != tag - 252]
        quaternions[row, places] = (np.array([a, b, c]) / 255 * 2 - 1) / np.sqrt(2)
        quaternions[row, tag - 252] = np.sqrt(max(0, 1 - np.square(quaternions[row]).sum()))
    found |= {f"rot_{k}": quaternions[:, k] for k in range(4)}
    assert_same(found, splats, "sog")


def test_gltf_has_the_attributes_of_the_extension(splats, folder):
    document = pygltflib.GLTF2().load(str(folder / "frame.glb"))
    assert document.extensionsUsed == ["KHR_gaussian_splatting"]
    (primitive,) = document.meshes[0].primitives
    assert primitive.mode == pygltflib.POINTS
    described = primitive.extensions["KHR_gaussian_splatting"]
    assert (described["kernel"], described["colorSpace"]) == ("ellipse", "srgb_rec709_display")
    blob = document.binary_blob()

    def column(name):
        accessor = document.accessors[getattr(primitive.attributes, name)]
        view = document.bufferViews[accessor.bufferView]
        return np.frombuffer(blob, "<f4", view.byteLength // 4, view.byteOffset).reshape(accessor.count, -1)

    extension = "KHR_gaussian_splatting:"
    opacities = column(f"{extension}OPACITY")[:, 0].astype(np.float64)
    found = {"opacity": np.log(opacities / (1 - opacities))}
    for names, values in (
        ("xyz", column("POSITION")),
        ([f"scale_{k}" for k in range(3)], np.log(column(f"{extension}SCALE"))),
        ([f"f_dc_{k}" for k in range(3)], column(f"{extension}SH_DEGREE_0_COEF_0")),
        (["rot_1", "rot_2", "rot_3", "rot_0"], column(f"{extension}ROTATION")),
    ):
        found |= dict(zip(names, values.T, strict=True))
    assert_same(found, splats, "glb")
    np.testing.assert_allclose(np.linalg.norm(column(f"{extension}ROTATION"), axis=1), 1, atol=1e-6)
    # What knows no splats shows points, and takes their colour as linear.
    (cloud,) = trimesh.load(folder / "frame.glb").geometry.values()
    np.testing.assert_array_equal(cloud.vertices, splats.means.numpy())
    np.testing.assert_allclose(column("COLOR_0")[:, :3], splats.rgb_linear.numpy(), atol=1e-5)


def test_an_empty_scale_keeps_a_finite_logarithm(splats):
    flat = Splats(*(getattr(splats, name) if name != "scales" else 0 * splats.scales for name in vars(splats)))
    assert np.isfinite(stored_splats(flat).log_scales).all()
