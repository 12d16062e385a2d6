"""Writing a recording of a head in Goliath's layout.

The set's own loader and this project's reader take it. Images become 8-bit linear AVIF with the set's white balance
undone and its black level added, at half the resolution that the cameras are given at; masks become part labels half
as large again; the rest is of `goliath_motion` and `goliath_patterns`. Frames per second, test cameras and names of
lights, which the layout has no place for, stand in a file beside it (`pipeline.datasets.goliath_beside`), and in the
log where other readers will take others. What cannot be said is refused: lenses other than k1 k2 p1 p2 k3, lights that
change colour.
"""

from __future__ import annotations

import io
import logging
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Float32, UInt8
from PIL import Image

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.errors import InputError, listed
from pipeline.base.files import write_json
from pipeline.base.progress import progress
from pipeline.datasets.goliath import BLACK_LEVEL, SUBJECT_LABELS, WHITE_BALANCE
from pipeline.datasets.goliath_beside import GoliathBeside, write_beside
from pipeline.datasets.goliath_cameras import DOWNSAMPLE, METRES_PER_UNIT, MODELS
from pipeline.datasets.goliath_frames import TEST_CAMERAS
from pipeline.datasets.goliath_kinds import FPS, HEAD
from pipeline.export.archives import write_zip
from pipeline.export.goliath_motion import write_motion
from pipeline.export.goliath_patterns import write_patterns
from pipeline.export.recording import Recording
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY
from pipeline.geometry.skin import Template

log = logging.getLogger(__name__)

FOLDER_END = "--Head"
"""Captures of heads are told by the name of their folder."""

LABEL = SUBJECT_LABELS[1]
"""Part label of all that is the subject: body. A mask knows no parts."""

AVIF_QUALITY = 100
"""At 4:4:4 a photograph then changes by at most 2 counts of 255, which its conversion to YUV costs; at 95 by 11."""

SUBJECT_SHARE = 127.5
"""Mean of a mask, 0..255, above which a pixel of half its resolution is the subject."""


def write_goliath_folder(
    folder: Path, recording: Recording, exposure: float, subject: str, lights: pd.DataFrame, patterns: pd.DataFrame,
    tracked: dict[str, np.ndarray], template: Template,
) -> None:  # fmt: skip
    """Write the capture to `SUBJECT--Head` in a folder.

    Args:
        lights: light, x, y, z.
        patterns: frame, light, intensity_r, intensity_g, intensity_b, a row for each lit light.
        tracked: frames, root_rotation, root_translation, vertices, of frames whose mesh is no interpolation.
        template: at rest.

    Raises:
        InputError: naming what the layout cannot say.
    """
    if recording.facts["kind"] != "head":
        raise InputError(
            f"layout goliath: expected a capture of kind head, found {recording.facts['kind']}; the set's captures of "
            "bodies have no light patterns: export colmap or nerfstudio"
        )
    root = folder / f"{subject}{FOLDER_END}"
    write_json(root / "camera_calibration.json", {"KRT": _entries(recording)})
    write_patterns(root / "lights", lights, patterns, recording.frames.frame.tolist())
    write_motion(root, recording.frames.frame.tolist(), tracked, template)
    _write_lists(root, recording)
    names = tuple(lights.light.astype(str).sort_values())
    write_beside(root, GoliathBeside(float(recording.facts["fps"]), tuple(recording.test_cameras), names))
    for camera, rows in progress(list(recording.images.groupby("camera")), "cameras"):
        name = str(camera)
        images = ((f"cam{name}/{row.frame:06d}.avif", _avif(exposure * recording.linear(name, row.path, row.frame)))
                  for row in rows.itertuples())  # fmt: skip
        write_zip(root / f"image/cam{camera}.zip", images)
        masked = rows[rows.mask_path.notna()]
        masks = ((f"cam{camera}/{row.frame:06d}.png", _labels(recording.mask(str(camera), row.mask_path)))
                 for row in masked.itertuples())  # fmt: skip
        write_zip(root / f"segmentation_parts/cam{camera}.zip", masks)


def _entries(recording: Recording) -> list[dict]:
    """KRT: K and T transposed, of images twice as large, millimetres, pixels counted from their centres."""
    sizes = {name: (camera.width, camera.height) for name, camera in recording.cameras.items()}
    odd = [name for name, size in sizes.items() if any(side % DOWNSAMPLE for side in size)]
    if odd:
        raise InputError(
            f"layout goliath: expected images of even width and height, for part labels of half their size, found "
            f"others of {listed(odd)}; export colmap or nerfstudio"
        )
    return [_entry(name, camera) for name, camera in recording.cameras.items()]


def _entry(name: str, camera: Camera) -> dict:
    if camera.lens is not BROWN_CONRADY:
        raise InputError(f"layout goliath: camera {name}: expected a perspective lens, found {camera.lens.name}")
    K = camera.K * np.array([[DOWNSAMPLE], [DOWNSAMPLE], [1.0]])
    K[:2, 2] -= PIXEL_CENTER
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = camera.R, camera.t / METRES_PER_UNIT
    dist = camera.dist[: 4 if camera.dist[4] == 0 else 5].tolist()
    return {"cameraId": name, **MODELS, "K": K.T.tolist(), "T": T.T.tolist(), "distortion": dist}


def _write_lists(root: Path, recording: Recording) -> None:
    frames = recording.frames
    splits = [f"{row.frame},{'test' if row.test else 'train'}" for row in frames.itertuples()]
    (root / "frame_splits_list.csv").write_text("\n".join(["frame,split", *splits]) + "\n")
    segments = [f"{row.segment},{row.frame}" for row in frames.itertuples()]
    (root / "frame_segments_list.csv").write_text("\n".join(["segment_name,frame", *segments]) + "\n")
    steps = frames.groupby("segment").frame.diff().dropna()
    fps = FPS[HEAD.word] * (int(steps.mode().iloc[0]) if len(steps) else 1)
    if fps != recording.facts["fps"]:
        log.warning("the layout has no frames per second: other readers will take %g, not %g", fps,
                    recording.facts["fps"])  # fmt: skip
    example = sorted(set(recording.cameras) & set(TEST_CAMERAS))
    if example != list(recording.test_cameras):
        told = [listed(names) or "none" for names in (example, recording.test_cameras)]
        log.warning("the layout names no test cameras: other readers will take %s, not %s", *told)


def _avif(linear: Float32[np.ndarray, "h w 3"]) -> bytes:
    counts = np.round(255 * linear / np.array(WHITE_BALANCE) + np.array(BLACK_LEVEL))
    file = io.BytesIO()
    image = Image.fromarray(np.clip(counts, 0, 255).astype(np.uint8))
    image.save(file, "AVIF", quality=AVIF_QUALITY, subsampling="4:4:4")
    return file.getvalue()


def _labels(mask: UInt8[np.ndarray, "h w"]) -> bytes:
    rows, columns = (side // DOWNSAMPLE for side in mask.shape)
    share = mask.reshape(rows, DOWNSAMPLE, columns, DOWNSAMPLE).mean((1, 3))
    return cv2.imencode(".png", np.where(share > SUBJECT_SHARE, LABEL, 0).astype(np.uint8))[1].tobytes()
