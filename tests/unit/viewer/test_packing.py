"""Numbers of the page: what is read back, by a reader of its own, is what was packed."""

from __future__ import annotations

import base64
import zlib

import numpy as np
import pytest

from pipeline.viewer import packing


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_levels_reach_both_ends_and_are_evenly_spaced():
    levels = packing.quantized(np.array([-1.0, 0.0, 1.0, 7.0]), -1.0, 1.0)
    assert levels.tolist() == [0, 32768, 65535, 65535]
    assert packing.quantized(np.array([2.0]), 2.0, 2.0).tolist() == [0]


def test_octahedral_normals_come_back_within_the_stated_angle(rng):
    normals = rng.normal(size=(5000, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3), [[1, 1, -1e-9], [-1, 0, -1e-9]]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    u, v = packing.octahedral(normals).T / 32767.5 - 1
    z = 1 - np.abs(u) - np.abs(v)
    # Below the horizon both coordinates were mirrored about the edges of the diamond |u| + |v| = 1.
    x = np.where(z < 0, np.copysign(1 - np.abs(v), u), u)
    y = np.where(z < 0, np.copysign(1 - np.abs(u), v), v)
    found = np.stack([x, y, z], 1)
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    sines = np.linalg.norm(np.cross(found, normals), axis=1)
    assert np.degrees(sines.max()) < 0.004
    assert (found * normals).sum(1).min() > 0.99


def test_table_comes_back_from_its_differences(rng):
    table = rng.integers(0, 65536, (100, 8)).astype(np.uint16)
    content = zlib.decompress(base64.b64decode(packing.block(packing.table_bytes(table))))
    low, high = np.frombuffer(content, np.uint8).reshape(2, 8, 100).astype(np.int64)
    np.testing.assert_array_equal(np.cumsum(low + 256 * high, axis=1) % 65536, table.T)


@pytest.mark.parametrize("lights", [1, 32, 45])
def test_visibility_words_have_a_bit_for_each_light(rng, lights):
    seen = rng.random((lights, 77)) < 0.5
    words = np.frombuffer(packing.visibility_words(np.packbits(seen, axis=1), 77), "<u4").reshape(-1, 77)
    assert len(words) == -(-lights // 32)
    for light in range(lights):
        np.testing.assert_array_equal((words[light // 32] >> (light % 32)) & 1, seen[light])


def test_tables_agree_up_to_rounding():
    table = np.full((3, 8), 7, np.uint16)
    assert packing.agree(table, table + np.uint16(1))
    assert not packing.agree(table, table + np.uint16(2))
    assert not packing.agree(np.zeros_like(table), np.full_like(table, 65535))
