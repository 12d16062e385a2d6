"""Sound and broken trackings and images of a walking figure, for the verdicts on tracking and of indexing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import cv2
import numpy as np
import pandas as pd

from benchmarks.verdict import Judged
from pipeline.capture.index.exchanged_images import SIDE_PX, correlations, exchanged, turned
from pipeline.config.track_mesh import TrackMesh
from pipeline.figures.tracking_verdicts import camera_verdicts, frame_verdicts
from pipeline.geometry.cameras import Camera
from pipeline.geometry.signed_distance import silhouette_overlap, view_from_masks
from pipeline.tracking.fit_verdicts import fit_verdicts
from tests.support.captures.walking import NOISE_PX, OUTLIER_PX, OUTLIERS
from tests.support.figures.walking import Motion, draw_mask, ring_of_cameras, walk

FRAMES, CAMERAS, DOWNSAMPLE = 12, 6, 8.0
TRACKED_M = 0.008
"""Standard deviation of a tracked vertex, common to a frame: what tracking leaves at a centimetre per pixel."""


@cache
def motion(number: int) -> Motion:
    """One of five walks."""
    return walk(FRAMES, turn=0.5 * number, stride=0.1 + 0.1 * number)


@cache
def cameras() -> dict[str, Camera]:
    """A ring of cameras at image resolution."""
    return {name: camera.downsampled(DOWNSAMPLE) for name, camera in ring_of_cameras(CAMERAS).items()}


@cache
def mask(number: int, camera: str, frame: int) -> np.ndarray:
    """Coverage 0..255 of the figure in one image."""
    return draw_mask(cameras()[camera], motion(number).vertices[frame], motion(number).faces)


def detected(number: int, rng: np.random.Generator) -> np.ndarray:
    """Keypoints [cameras, frames, points, 2] as a detector gives them: noise, and one in thirty anywhere."""
    points = np.stack([camera.project(motion(number).joints)[0] for camera in cameras().values()])
    pixels = points + rng.normal(0, NOISE_PX, points.shape)
    wrong = rng.random(points.shape[:3]) < OUTLIERS
    pixels[wrong] += rng.normal(0, OUTLIER_PX, (wrong.sum(), 2))
    return pixels


AXES, NAMES = "x and y of keypoints exchanged", "cameras of keypoints in another order"


def keypoint_alarm(fault: str | None, seed: int) -> bool:
    """Detections against a template that is tracked to some millimetres."""
    rng, number = np.random.default_rng(seed), seed % 5
    pixels = detected(number, rng)
    pixels = pixels[..., ::-1] if fault == AXES else np.roll(pixels, 1, 0) if fault == NAMES else pixels
    joints = motion(number).joints + rng.normal(0, TRACKED_M, (FRAMES, 1, 3))
    there = np.stack([camera.project(joints)[0] for camera in cameras().values()])
    inliers = int((np.linalg.norm(pixels - there, axis=-1) < TrackMesh().inlier_px).sum())
    return any(verdict.grade != "good" for verdict in fit_verdicts(inliers, pixels[..., 0].size, {}))


INVERTED, WHITE, ELSEWHERE = "masks inverted", "masks white", "masks of the next camera"


def mask_alarm(fault: str | None, seed: int) -> bool:
    """Three frames' masks of a figure that is tracked to some millimetres; those of cam00 are broken."""
    rng, number = np.random.default_rng(seed), seed % 5
    frames = np.sort(rng.choice(FRAMES, 3, replace=False))
    tracked = motion(number).vertices[frames] + rng.normal(0, TRACKED_M, (3, 1, 3))
    overlaps = {}
    for name, camera in cameras().items():
        masks = [mask(number, name, frame) for frame in frames]
        if name == "cam00" and fault is not None:
            other = [mask(number, "cam01", frame) for frame in frames]
            masks = {INVERTED: [255 - m for m in masks], WHITE: [m | 255 for m in masks], ELSEWHERE: other}[fault]
        overlaps[name] = silhouette_overlap([view_from_masks(camera, masks)], tracked, motion(number).faces)
    verdicts = fit_verdicts(1, 1, overlaps)
    return any(v.grade != "good" for v in verdicts if v.kind == "masks" and (fault is None or v.name == "cam00"))


SLIPPED, WRONG, LIMB = "frame slipped by 8 cm", "half of a frame's keypoints elsewhere", "a limb off in a frame"


def frame_alarm(fault: str | None, seed: int, size: float = 0.08) -> bool:
    """Numbers of twelve tracked frames, as they vary from frame to frame; one in the middle is broken.

    One that slipped did by `size`, metres.
    """
    rng, number, frame = np.random.default_rng(seed), seed % 5, 3 + seed % 6
    table = pd.DataFrame({
        "frame": np.arange(FRAMES), "segment": "a", "status": "tracked", "observations": 100,
        "rms_px": rng.normal(0.5, 0.04, FRAMES), "inliers": rng.binomial(100, 1 - OUTLIERS, FRAMES),
        "silhouette_iou": rng.normal(0.965, 0.003, FRAMES),
    })  # fmt: skip
    vertices = motion(number).vertices + rng.normal(0, 0.001, (FRAMES, 1, 3))
    if fault == SLIPPED:
        vertices[frame] += [0, size, 0]
    if fault == WRONG:
        table.loc[frame, "inliers"] = 50
    if fault == LIMB:
        table.loc[frame, "silhouette_iou"] = 0.88
    verdicts = frame_verdicts(SimpleNamespace(frames=table, vertices=vertices))
    return any(v.grade != "good" for v in verdicts if fault is None or v.name == str(frame))


KNOCKED, TURNED = "camera knocked by 3 cm after calibration", "calibration of another camera"


def tracked_camera_alarm(fault: str | None, seed: int, size: float = 0.03) -> bool:
    """Residuals of six cameras' keypoints; cam00 is broken: knocked by `size`, metres."""
    rng, number = np.random.default_rng(seed), seed % 5
    rig = dict(cameras())
    if fault == KNOCKED:
        rig["cam00"] = replace(rig["cam00"], t=rig["cam00"].t + np.array([size, 0, 0]))
    if fault == TURNED:
        rig["cam00"] = rig["cam01"]
    joints = motion(number).joints + rng.normal(0, TRACKED_M / 4, (FRAMES, 1, 3))
    there = np.stack([camera.project(joints)[0] for camera in rig.values()])
    residual = np.linalg.norm(detected(number, rng) - there, axis=-1)
    found = SimpleNamespace(cameras=rig, residual_px=residual, held_out=frozenset())
    return any(v.grade != "good" for v in camera_verdicts(found) if fault is None or v.name == "cam00")


PAIR = "images of two cameras exchanged"
WAYS = {
    "images mirrored": lambda image: image[:, ::-1], "images upside down": lambda image: image[::-1],
    "images half a turn round": lambda image: image[::-1, ::-1], "square images a quarter turn round": np.rot90,
}  # fmt: skip


def image_alarm(fault: str | None, seed: int) -> bool:
    """Four frames of six cameras: the figure lit from a side, textured, before a dim wall; cam00's are broken."""
    rng, number = np.random.default_rng(seed), seed % 5
    frames, names = np.sort(rng.choice(FRAMES, 4, replace=False)), list(cameras())
    shown, given = np.empty((2, len(frames), len(names), SIDE_PX**2))
    for f, frame in enumerate(frames):
        for c, name in enumerate(names):
            own = mask(number, name, frame)[8:88].astype(np.float64) / 255  # 80 x 80: square, with the figure in it
            side = np.linspace(*rng.permutation([0.3, 1.0]), own.shape[1])
            light = own * side * rng.uniform(0.4, 1.0, own.shape) + (1 - own) * rng.uniform(0.0, 0.15)
            if name == names[0] and fault in WAYS:
                light = WAYS[fault](light)
            for store, image in ((shown, np.sqrt(light)), (given, own)):
                small = cv2.resize(np.ascontiguousarray(image), (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA)
                store[f, c] = small.ravel()
    if fault == PAIR:
        shown[:, [0, 2]] = shown[:, [2, 0]]
    pairs = exchanged(correlations(shown, given))
    others = turned(shown, given, quarters=True)
    if fault == PAIR:
        return (0, 2) in pairs
    return bool(pairs or others) if fault is None else any(camera == 0 for camera, _, _ in others)


KEYPOINTS = Judged("fit_verdicts.fit_verdicts, keypoints", (AXES, NAMES), keypoint_alarm)
MASKS = Judged("fit_verdicts.fit_verdicts, masks", (INVERTED, WHITE, ELSEWHERE), mask_alarm)
TRACKED_FRAME = Judged("tracking_verdicts.frame_verdicts", (SLIPPED, WRONG, LIMB), frame_alarm)
TRACKED_CAMERA = Judged("tracking_verdicts.camera_verdicts", (KNOCKED, TURNED), tracked_camera_alarm)
IMAGES = Judged("exchanged_images.exchanged, turned", (PAIR, *WAYS), image_alarm)
