"""A FaceOLAT capture in the exact layout of the set, with its traps.

Images are light to the power of 1 / 2.2, half as bright as other captures' (expression 2, subjects 88 to 116), and are
numbered from 1; the list of patterns counts from 0, and which image its entry 0 is differs; durations have fractions.
Cameras are Metashape's: principal points from the image's middle, p1 and p2 in the other order, world-from-camera in a
chunk of its own scale, turn and place; one camera is not aligned. Calibrations lie beside the folders of cameras, as in
the set's programs, which have their lights in millimetres. There are no masks, and meshes lie elsewhere.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.support.datasets.turning_head import TurningHead, dome_of_lights, ring_of_cameras

CAPTURE, OTHER_CAPTURE, CALIBRATION = "ID20090", "ID30090", "090"
CAMERAS = [f"Cam{number:02d}" for number in range(1, 6)]
TEST_CAMERA = "Cam05"
BLIND_CAMERA = "Cam06"
"""Has images and no pose."""

LIGHTS = 17
FULL = (0, 5, 11, 17, 21)
"""Entries of the list with all lights on: the first gap is shorter than the others."""

FRAMES = range(FULL[-1] + 1)
DURATION, FULL_DURATION = 331, 321.55
DARKER = 2.0
CHUNK_SCALE, CHUNK_SHIFT = 0.37, np.array([0.8, -1.9, 2.6])
CHUNK_TURN = Rotation.from_euler("xyz", [0.4, 1.3, -0.7]).as_matrix()
"""X_world = CHUNK_SCALE CHUNK_TURN X_chunk + CHUNK_SHIFT."""


def pattern_of(frame: int) -> int:
    """Number of the light pattern of an entry: 0, or one more than its light."""
    return 0 if frame in FULL else 1 + sum(earlier not in FULL for earlier in range(frame))


def light_pattern(number: int) -> list[list[float]]:
    """The set's list of lights and durations."""
    if number == 0:
        return [[light, FULL_DURATION] for light in range(LIGHTS)]
    return [[number - 1, DURATION]]


def true_head(image: tuple[int, int] = (32, 48)) -> TurningHead:
    """The truth, whose frames are the entries of the list; images are as large as the sensor."""
    frames = {n: {light: d / DURATION for light, d in light_pattern(pattern_of(n))} for n in FRAMES}
    return TurningHead(ring_of_cameras([*CAMERAS, BLIND_CAMERA], image), 1, dome_of_lights(LIGHTS), frames, FULL)


def write_faceolat(folder: Path, truth: TurningHead, first: int = 1) -> Path:
    """Write the capture below a folder, entry 0 being image `first`; returns the folder of the cameras' folders.

    Images without an entry, before it or after it, show all lights.
    """
    root = folder / "FaceOLAT"
    for name in truth.cameras:
        for number in range(1, len(FRAMES) + 1):
            shown = min(number - first, FRAMES[-1])
            image = Image.fromarray(stored(truth.image(name, shown)))
            _write(root / f"{name}/{CAPTURE}/{CAPTURE}.{number:06d}.avif", avif(image))
    _write(root / f"{CAMERAS[0]}/{OTHER_CAPTURE}/{OTHER_CAPTURE}.000001.avif", avif(Image.new("RGB", (8, 8))))
    _write(root / f"calibration/cameras/{CALIBRATION}.xml", cameras_xml(truth).encode())
    _write(root / "color-calibration/colorcalib_exr.mat", b"1.3 -0.2 0 0.01\n0 1.2 0 0.01\n0 -0.1 1.1 0.01\n0 0 0 1\n")
    patterns = [{"name": f"pattern_{n}", "light_index_durations": light_pattern(n)} for n in range(LIGHTS + 1)]
    content = {"light_positions": (1000 * truth.lights_m).tolist(), "light_patterns": patterns}
    _write(root / "relighting/lights/light_pattern_metadata.json", json.dumps(content).encode())
    per_frame = json.dumps([[frame, pattern_of(frame)] for frame in FRAMES])
    _write(root / "relighting/lights/light_pattern_per_frame.json", per_frame.encode())
    return root


def write_meshes(folder: Path, truth: TurningHead, first: int = 1) -> Path:
    """Write a mesh of each fully lit image, as another program would make them, in metres; returns their folder."""
    place = folder / "reconstructed"
    for frame in FULL:
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in truth.vertices(frame).tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in truth.faces + 1]
        _write(place / f"{frame + first:06d}.obj", "\n".join(lines).encode())
    return place


def settings(folder: Path, truth: TurningHead) -> str:
    """Settings of import_capture as YAML; writes the meshes that they name."""
    return f"{{segments: [{CAPTURE}], mesh: {write_meshes(folder, truth)}}}"


def stored(linear: np.ndarray) -> np.ndarray:
    """Counts of linear light, a plain power; recorded darker than other captures."""
    return np.clip(np.clip(linear / DARKER, 0, None) ** (1 / 2.2) * 255, 0, 255).astype(np.uint8)


def avif(image: Image.Image) -> bytes:
    """An AVIF file."""
    file = io.BytesIO()
    image.save(file, "AVIF", quality=95, subsampling="4:4:4")
    return file.getvalue()


def cameras_xml(truth: TurningHead) -> str:
    """The cameras as Metashape exports them, with the transform of the chunk."""
    sensors, poses = "", ""
    for number, (name, camera) in enumerate(truth.cameras.items()):
        size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
        k1, k2, p1, p2, k3 = camera.dist
        # Pixel centres at 0.5; B1 is what the focal length in x has more.
        values = {
            "f": camera.K[1, 1], "cx": camera.K[0, 2] + 0.5 - camera.width / 2,
            "cy": camera.K[1, 2] + 0.5 - camera.height / 2, "b1": camera.K[0, 0] - camera.K[1, 1],
            "k1": k1, "k2": k2, "k3": k3, "p1": p2, "p2": p1,
        }  # fmt: skip
        lens = "".join(f"<{key}>{float(value)!r}</{key}>" for key, value in values.items())
        sensors += (
            f'<sensor id="{number}" label="{name}" type="frame">{size}<property name="layer_index" value="0"/>'
            f'<calibration type="frame" class="adjusted">{size}{lens}</calibration>'
            f"<covariance><params>f cx</params><coeffs>1 0 0 1</coeffs></covariance></sensor>"
        )
        pose = np.eye(4)
        pose[:3, :3] = CHUNK_TURN.T @ camera.R.T
        pose[:3, 3] = CHUNK_TURN.T @ (-camera.R.T @ camera.t - CHUNK_SHIFT) / CHUNK_SCALE
        aligned = "" if name == BLIND_CAMERA else f"<transform>{_numbers(pose)}</transform>"
        poses += f'<camera id="{number}" sensor_id="{number}" component_id="0" label="{name}">{aligned}</camera>'
    world = (
        f'<transform><rotation locked="false">{_numbers(CHUNK_TURN)}</rotation><translation locked="false">'
        f'{_numbers(CHUNK_SHIFT)}</translation><scale locked="false">{CHUNK_SCALE!r}</scale></transform>'
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="Chunk 1" enabled="true">'
        f'<sensors next_id="9">{sensors}</sensors><components next_id="1" active_id="0">'
        f'<component id="0" label="Component 1"/></components><cameras next_id="9" next_group_id="0">{poses}</cameras>'
        f'{world}<reference>LOCAL_CS["Local CS",LOCAL_DATUM["Local Datum",0],UNIT["meters",1]]</reference>'
        "</chunk></document>"
    )


def _numbers(matrix: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(matrix))


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
