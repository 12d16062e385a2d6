"""A Goliath capture of the real counts, with tiny images that repeat: as many cameras, frames and files as the set has.

The layout is that of `tests/support/datasets/goliath_layout.py`. Every frame of a camera is the same image, so that an
archive is an array of equal records; the head stands still.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.support.datasets import goliath_layout as layout
from tests.support.datasets.turning_head import TrueCamera, TurningHead, dome_of_lights, looking_at

NAME = "m--20230306--0707--AAA000--pilot--ProjectGoliath--Head"
FRAMES_PER_SEGMENT = 500

LOCAL = [("magic", "S4"), ("needed", "<u2"), ("flags", "<u2"), ("method", "<u2"), ("time", "<u2"), ("date", "<u2"),
         ("crc", "<u4"), ("packed", "<u4"), ("size", "<u4"), ("name_length", "<u2"), ("extra", "<u2")]  # fmt: skip
CENTRAL = [("magic", "S4"), ("made", "<u2"), *LOCAL[1:], ("comment", "<u2"), ("disk", "<u2"), ("internal", "<u2"),
           ("external", "<u4"), ("offset", "<u4")]  # fmt: skip
"""Records of a zip archive, PKWARE's APPNOTE 4.3.7 and 4.3.12."""

FIRST_DAY = 0x21
"""1980-01-01, as archives count days."""


@dataclass(frozen=True)
class GoliathSize:
    """Numbers of a capture; the defaults are those of a head of the set."""

    cameras: int = 172
    frames: int = 30_000
    lights: int = 460
    patterns: int = 3_000
    width: int = 16
    height: int = 24


def camera_names(size: GoliathSize) -> list[str]:
    """Names, as the set has them: six digits. The loader's example test cameras are among them."""
    some = list(layout.CAMERAS) + [str(number) for number in range(400_400, 400_400 + size.cameras)]
    return sorted(dict.fromkeys(some[: size.cameras]))


def still_head(size: GoliathSize) -> TurningHead:
    """The truth: cameras all around, a head that does not move."""
    names, cameras = camera_names(size), {}
    places = dome_of_lights(len(names), 1.0)
    middle = places.mean(0)
    for name, place in zip(names, places, strict=True):
        # None looks straight up or down, where a camera has no upright.
        place = place + np.array([0.02, 0.0, 0.01])
        R, t = looking_at(place, middle)
        f = 2.1 * 2 * size.height
        K = np.array([[f, 0, size.width - 0.5], [0, f, size.height - 0.5], [0, 0, 1.0]])
        cameras[name] = TrueCamera(R, t, K, np.zeros(5), 2 * size.width, 2 * size.height)
    lights = dome_of_lights(size.lights)
    lit = dict.fromkeys(range(size.lights), 1.0)
    return TurningHead(cameras, 2, lights, {0: lit}, (0,), still=True)


def write_goliath_size(folder: Path, size: GoliathSize = GoliathSize()) -> Path:
    """Write the capture below a folder; returns its own folder."""
    truth, root = still_head(size), folder / NAME
    for part in ("image", "segmentation_parts", "kinematic_tracking", "head_pose", "lights"):
        (root / part).mkdir(parents=True)
    layout.write_cameras(root, truth)
    _write_lists(root, size, truth)
    numbers = np.arange(size.frames)
    lit = numbers[:: layout.LIT_EVERY]
    for name in truth.cameras:
        image = layout.avif(layout.stored(0.2 * truth.image(name, 0)))
        (root / f"image/cam{name}.zip").write_bytes(repeated_zip(f"cam{name}/", ".avif", numbers, image))
        mask = layout.png(layout.part_labels(truth, name, 0))
        (root / f"segmentation_parts/cam{name}.zip").write_bytes(repeated_zip(f"cam{name}/", ".png", lit, mask))
    mesh, pose = layout.ply(1000 * truth.in_head(0)), layout.pose_text(truth, 0).encode()
    tracking = root / "kinematic_tracking"
    vertices = repeated_zip("registration_vertices/", ".ply", lit, mesh)
    (tracking / "registration_vertices.zip").write_bytes(vertices)
    (root / "head_pose/head_pose.zip").write_bytes(repeated_zip("", ".txt", lit, pose))
    np.save(tracking / "registration_vertices_mean.npy", 1000 * truth.mean_in_head)
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in 1000 * truth.mean_in_head]
    lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
    (tracking / "template_mesh.obj").write_text("\n".join(lines) + "\n")
    return root


def repeated_zip(before: str, after: str, numbers: np.ndarray, content: bytes) -> bytes:
    """A zip archive of members BEFORE000012AFTER, all with the same content, stored as it is."""
    names = np.array([f"{before}{number:06d}{after}" for number in numbers], "S")
    count, length = len(names), names.dtype.itemsize
    stored = np.zeros(count, [*LOCAL, ("name", f"S{length}"), ("content", f"V{len(content)}")])
    entries = np.zeros(count, [*CENTRAL, ("name", f"S{length}")])
    stored["magic"], entries["magic"] = b"PK\3\4", b"PK\1\2"
    for records in (stored, entries):
        records["needed"], records["date"], records["crc"] = 20, FIRST_DAY, zlib.crc32(content)
        records["packed"] = records["size"] = len(content)
        records["name_length"], records["name"] = length, names
    stored["content"] = np.frombuffer(content, f"V{len(content)}")[0]
    entries["made"], entries["offset"] = 20, stored.dtype.itemsize * np.arange(count)
    end = struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, count, count, entries.nbytes, stored.nbytes, 0)
    return stored.tobytes() + entries.tobytes() + end


def _write_lists(root: Path, size: GoliathSize, truth: TurningHead) -> None:
    numbers = range(size.frames)
    names = [f"SEG_{number // FRAMES_PER_SEGMENT:03d}" for number in numbers]
    splits = ["test" if name.endswith("9") else "train" for name in names]
    lists = {
        "frame_splits_list.csv": ["frame,split", *map("{},{}".format, numbers, splits)],
        "frame_segments_list.csv": ["segment_name,frame", *map("{},{}".format, names, numbers)],
    }
    for name, lines in lists.items():
        (root / name).write_text("\n".join(lines) + "\n")
    partly = [1 + number % (size.patterns - 1) for number in numbers]
    per_frame = [[n, 0 if n % layout.LIT_EVERY == 0 else partly[n]] for n in numbers]
    (root / "lights/light_pattern_per_frame.json").write_text(json.dumps(per_frame))
    full = [[light, layout.DURATION] for light in range(size.lights)]
    some = [[[(7 * n + 31 * k) % size.lights, 2 * layout.DURATION] for k in range(layout.PARTLY)]
            for n in range(1, size.patterns)]  # fmt: skip
    patterns = [{"light_index_durations": each} for each in (full, *some)]
    content = {"light_positions": (1000 * truth.lights_m).tolist(), "light_patterns": patterns}
    (root / "lights/light_pattern_metadata.json").write_text(json.dumps(content))
