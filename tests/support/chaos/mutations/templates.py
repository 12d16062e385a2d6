"""Changes to the template mesh: its JSON and its numbers."""

from __future__ import annotations

import copy
import json
import random
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tests.support.chaos.mutations.mutation import Meaning, Mutation, replace

FILE = "template/template.glb"
BROKEN, SAME, OTHER = Meaning.BROKEN, Meaning.SAME, Meaning.OTHER

TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

Content = dict[str, Any]
Change = Callable[[Content, bytearray], object]

WRONG = (None, -1, 10**9, 4.5, "text", [], {}, True, 1e308)
"""Values that are put in place of what stands in the JSON."""


def mutations(root: Path, rng: random.Random, values: int = 60) -> Iterator[Mutation]:
    """Changes to single values of the JSON, drawn, and to the numbers of vertices, faces, joints and weights."""
    content, _ = _parts(root / FILE)
    places = [place for place in _places(content) if place[0] not in ("asset", "extras")]
    for _ in range(values):
        place, value = rng.choice(places), rng.choice(WRONG)
        what = f"{'.'.join(map(str, place))} is {value!r}"
        # Names, extras and default values may be anything.
        yield _glb(what, OTHER, partial(_set, place, value))
    for _ in range(values // 4):
        place = rng.choice(places)
        yield _glb(f"{'.'.join(map(str, place))} is gone", OTHER, partial(_delete, place))
    yield from _numbers()
    yield from _nodes()


def _numbers() -> Iterator[Mutation]:
    """Changes to the arrays of the mesh; the first of POSITION and so on."""
    for name in ("POSITION", "WEIGHTS_0"):
        for value in (np.nan, np.inf, 1e30):
            yield _array(f"a number of {name} is {value}", BROKEN, name, partial(_fill_one, value))
        yield _array(f"all of {name} are 0", BROKEN, name, lambda array: np.zeros_like(array))
    yield _array("weights are negative", BROKEN, "WEIGHTS_0", lambda array: -array)
    yield _array("weights are twice as large", OTHER, "WEIGHTS_0", lambda array: 2 * array)
    yield _array("joints are 200", BROKEN, "JOINTS_0", lambda array: np.full_like(array, 200))
    yield _array("joints are all the first", BROKEN, "JOINTS_0", lambda array: np.zeros_like(array))
    yield _array("faces beyond the vertices", BROKEN, "indices", lambda array: array + np.array(60_000, array.dtype))
    yield _array("faces of one vertex", BROKEN, "indices", lambda array: np.zeros_like(array))
    yield _array(
        "faces that look inwards", BROKEN, "indices", lambda array: array.reshape(-1, 3)[:, ::-1].reshape(array.shape)
    )
    for axis, factor in ((0, -1.0), (1, -1.0), (1, 2.0), (2, 0.0)):
        yield _array(f"axis {axis} times {factor:g}", BROKEN, "POSITION", partial(_scale_axis, axis, factor))
    for factor in (1e-3, 0.1, 2.54, 100.0):
        yield _array(f"vertices times {factor:g}", BROKEN, "POSITION", partial(np.multiply, np.float32(factor)))
    for value in (np.nan, 0.0):
        yield _array(
            f"bind matrices are {value}",
            BROKEN,
            "inverseBindMatrices",
            lambda array, value=value: np.full_like(array, value),
        )


def _nodes() -> Iterator[Mutation]:
    yield _glb("a circle of nodes", BROKEN, lambda content, _: content["nodes"][-1].update(children=[_parent(content)]))
    yield _glb(
        "a node twice a child",
        BROKEN,
        lambda content, _: _joint(content).update(children=[len(content["nodes"]) - 1] * 2),
    )
    yield _glb("a node of NaN", BROKEN, lambda content, _: _joint(content).update(translation=[float("nan")] * 3))
    yield _glb("a scale of 0", BROKEN, lambda content, _: _joint(content).update(scale=[0, 0, 0]))
    yield _glb("a rotation of no length", BROKEN, lambda content, _: _joint(content).update(rotation=[0, 0, 0, 0]))
    yield _glb("two skins", BROKEN, lambda content, _: content["skins"].append(content["skins"][0]))
    yield _glb("no skin", OTHER, lambda content, _: content.pop("skins"))
    yield _glb(
        "a joint twice",
        BROKEN,
        lambda content, _: content["skins"][0]["joints"].__setitem__(0, content["skins"][0]["joints"][-1]),
    )
    yield _glb(
        "an extension that is required",
        BROKEN,
        lambda content, _: content.update(extensionsRequired=["KHR_draco_mesh_compression"]),
    )
    yield _glb(
        "lines in place of triangles", BROKEN, lambda content, _: content["meshes"][0]["primitives"][0].update(mode=1)
    )


def _joint(content: Content) -> Content:
    return content["nodes"][content["skins"][0]["joints"][0]]


def _parent(content: Content) -> int:
    """A node that has children, as the last one may be below it."""
    return next(place for place, node in enumerate(content["nodes"]) if node.get("children"))


def _parts(path: Path) -> tuple[Content, bytearray]:
    """The JSON and the binary chunk of a .glb file (glTF 2.0, section 4.4)."""
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length]), bytearray(data[28 + length :])


def _glb(what: str, meaning: Meaning, change: Change) -> Mutation:
    def apply(root: Path) -> None:
        content, binary = _parts(root / FILE)
        content = copy.deepcopy(content)
        change(content, binary)
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        replace(root / FILE, struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)

    return Mutation(FILE, what, meaning, apply)


def _array(what: str, meaning: Meaning, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Mutation:
    def edit(content: Content, binary: bytearray) -> None:
        accessor = content["accessors"][_accessor(content, name)]
        view = content["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        shape = (accessor["count"], WIDTHS[accessor["type"]])
        array = np.frombuffer(binary, TYPES[accessor["componentType"]], shape[0] * shape[1], start).reshape(shape)
        changed = np.ascontiguousarray(change(array)).astype(array.dtype).tobytes()
        binary[start : start + len(changed)] = changed

    return _glb(what, meaning, edit)


def _accessor(content: Content, name: str) -> int:
    if name == "inverseBindMatrices":
        return content["skins"][0][name]
    primitive = content["meshes"][0]["primitives"][0]
    return primitive[name] if name == "indices" else primitive["attributes"][name]


def _fill_one(value: float, array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[len(array) // 2, 0] = value
    return array


def _scale_axis(axis: int, factor: float, array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[:, axis] *= factor
    return array


def _places(content: Any, place: tuple = ()) -> Iterator[tuple]:
    items = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    for key, value in items:
        yield (*place, key)
        yield from _places(value, (*place, key))


def _set(place: tuple, value: Any, content: Content, binary: bytearray) -> None:
    _dig(content, place[:-1])[place[-1]] = value


def _delete(place: tuple, content: Content, binary: bytearray) -> None:
    del _dig(content, place[:-1])[place[-1]]


def _dig(content: Any, place: tuple) -> Any:
    for key in place:
        content = content[key]
    return content
