"""Meshes in Embree (Wald et al. 2014), by its own C interface.

The library is that of embreex's wheel. embreex itself reads a mesh number by number through Python, and holds the
interpreter's lock until the tree is built: threads that trace other frames wait. Here arrays are handed over as they
are, and no lock is held. The values below are those of embree4/rtcore_*.h, which stay as they are in all versions 4.
"""

from __future__ import annotations

import ctypes
import weakref
from ctypes import c_char_p, c_int, c_size_t, c_uint, c_void_p
from ctypes.util import find_library
from importlib import metadata
from pathlib import Path

import embreex.rtcore_scene  # noqa: F401  loads what its library needs
import numpy as np
from jaxtyping import Float, Int
from llvmlite.binding import load_library_permanently

from pipeline.lighting.embree_kernels import find_nearest, find_occluded

TRIANGLES, INDICES, VERTICES, THREE_INTEGERS, THREE_FLOATS = 0, 0, 1, 0x5003, 0x9003
"""RTC_GEOMETRY_TYPE_TRIANGLE, RTC_BUFFER_TYPE_INDEX, RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_UINT3, RTC_FORMAT_FLOAT3."""

ROBUST = 4
"""RTC_SCENE_FLAG_ROBUST: no ray slips between two faces that share an edge."""

FUNCTIONS: dict[str, tuple[type | None, list[type]]] = {
    "rtcNewDevice": (c_void_p, [c_char_p]),
    "rtcReleaseDevice": (None, [c_void_p]),
    "rtcGetDeviceError": (c_int, [c_void_p]),
    "rtcNewScene": (c_void_p, [c_void_p]),
    "rtcSetSceneFlags": (None, [c_void_p, c_int]),
    "rtcCommitScene": (None, [c_void_p]),
    "rtcReleaseScene": (None, [c_void_p]),
    "rtcNewGeometry": (c_void_p, [c_void_p, c_int]),
    "rtcSetSharedGeometryBuffer": (None, [c_void_p, c_int, c_uint, c_int, c_void_p, c_size_t, c_size_t, c_size_t]),
    "rtcCommitGeometry": (None, [c_void_p]),
    "rtcAttachGeometry": (c_uint, [c_void_p, c_void_p]),
    "rtcReleaseGeometry": (None, [c_void_p]),
}
"""What each function returns and takes."""


def library_path() -> str:
    """Find Embree 4 in embreex's wheel, or in the system.

    Raises:
        ImportError: if it is in neither.
    """
    for file in metadata.files("embreex") or ():
        if "embree4" in file.name and {".so", ".dylib", ".dll"} & set(Path(file.name).suffixes):
            return str(file.locate())
    found = find_library("embree4")
    if found is None:
        raise ImportError("expected Embree 4 in embreex's wheel or in the system, found neither: reinstall embreex")
    return found


def _load(path: str) -> ctypes.CDLL:
    """The library; also made known to compiled kernels, which call it by name."""
    load_library_permanently(path)
    library = ctypes.CDLL(path)
    for name, (returned, taken) in FUNCTIONS.items():
        function = getattr(library, name)
        function.restype, function.argtypes = returned, taken
    return library


EMBREE = _load(library_path())


class EmbreeMesh:
    """A triangle mesh with its tree, for rays in its vertices' frame.

    Attributes:
        handle: the scene, as kernels take it; of no use when the mesh is gone.
    """

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        """Build the tree.

        Args:
            faces: rows of `vertices`.

        Raises:
            RuntimeError: if Embree cannot.
        """
        # Embree goes on reading these arrays, and sixteen bytes where a vertex starts.
        self._corners, self._faces = np.zeros((len(vertices), 4), np.float32), np.array(faces, np.uint32, order="C")
        self._corners[:, :3] = vertices
        device = EMBREE.rtcNewDevice(None)
        _check(device)
        self.handle: int = EMBREE.rtcNewScene(device)
        self._release = weakref.finalize(self, _release, self.handle, device)
        EMBREE.rtcSetSceneFlags(self.handle, ROBUST)
        geometry = EMBREE.rtcNewGeometry(device, TRIANGLES)
        for kind, layout, array in (VERTICES, THREE_FLOATS, self._corners), (INDICES, THREE_INTEGERS, self._faces):
            EMBREE.rtcSetSharedGeometryBuffer(
                geometry, kind, 0, layout, array.ctypes.data, 0, array.strides[0], len(array)
            )
        EMBREE.rtcCommitGeometry(geometry)
        EMBREE.rtcAttachGeometry(self.handle, geometry)
        EMBREE.rtcReleaseGeometry(geometry)
        _check(device)  # Without its arrays, a tree is not built but the process killed.
        EMBREE.rtcCommitScene(self.handle)
        _check(device)

    def occluded(
        self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"], lengths: Float[np.ndarray, " r"]
    ) -> Int[np.ndarray, " r"]:
        """Tell for each ray whether it meets a face on its length, 0, or nothing, -1."""
        hits = np.empty(len(lengths), np.int32)
        find_occluded(self.handle, origins, directions, lengths, hits)
        return hits

    def nearest(
        self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"], lengths: Float[np.ndarray, " r"]
    ) -> tuple[Int[np.ndarray, " r"], Float[np.ndarray, " r"], Float[np.ndarray, "r 2"]]:
        """The first face on each ray, how far it is, and where it is hit.

        The last is the weights of the face's second and third corner. Where nothing is met: -1, the ray's length, 0.
        """
        face, distance = np.empty(len(lengths), np.int32), np.empty(len(lengths), np.float32)
        barycentric = np.zeros((len(lengths), 2), np.float32)
        find_nearest(self.handle, origins, directions, lengths, face, distance, barycentric)
        return face, distance, barycentric


def _check(device: int | None) -> None:
    """Raise RuntimeError if Embree has failed since this was last asked."""
    error = EMBREE.rtcGetDeviceError(device)
    if error:
        meaning = {4: "out of memory", 5: "this processor is too old"}.get(error, "see embree4/rtcore_common.h")
        raise RuntimeError(f"Embree could not build a tree: its error {error}, {meaning}")


def _release(scene: int, device: int) -> None:
    """Give back a scene and the device it was made on."""
    EMBREE.rtcReleaseScene(scene)
    EMBREE.rtcReleaseDevice(device)
