"""Glints of an avatar whose eyes are turned: where they are rendered, and where the true eye would show them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pandas as pd
import torch
from scipy.spatial.transform import Rotation

from benchmarks.mirror_glints import centroid
from benchmarks.true_eyes import TrueEyes
from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.model import Avatar
from pipeline.avatar.relighting.driving_signal import from_record
from pipeline.avatar.relighting.film import Relighter
from pipeline.capture.records import FrameRecord
from pipeline.geometry.cameras import Camera
from pipeline.lighting.frame_lights import FrameLights

BEYOND_EYE_PX = 2.0
"""Pixels beyond the outline of an eye in which a glint is looked for."""

SHOWN = 1e-3
"""Peak of a glint over the brightest of the run below which nothing shows: four digits of float32 are noise."""


COLUMNS = [
    "frame", "segment", "yaw", "pitch", "light", "camera", "eye", "status", "sphere", "expected_x", "expected_y",
    "found_x", "found_y", "peak", "error_px", "still_px",
]  # fmt: skip


@dataclass(frozen=True)
class Scene:
    """An avatar with the calibration that it knows, and the truth.

    Attributes:
        cameras: calibrated, at sensor resolution.
        lights: calibrated positions, metres.
        sensor_per_pixel: sensor pixels per pixel of the capture.
        zoom: rendered pixels per pixel of the capture.
    """

    relighter: Relighter
    truth: TrueEyes
    cameras: dict[str, Camera]
    lights: dict[str, np.ndarray]
    sensor_per_pixel: float
    zoom: float = 1.0

    def pixel_m(self, eye: str, frame: int, camera: str) -> float:
        """Width of a pixel of the capture at an eye, metres."""
        center, sensor = self.truth.placed(eye, frame, self.truth.looks(frame))[0], self.truth.cameras[camera]
        return float(np.linalg.norm(center - sensor.center)) * self.sensor_per_pixel / sensor.K[0, 0]

    def around_eyes(self, frame: int, camera: str) -> Camera:
        """The calibrated camera without distortion, cut to the eyes of a frame."""
        truth, sensor, scale = self.truth, self.cameras[camera], self.zoom / self.sensor_per_pixel
        K = sensor.K * [[scale], [scale], [1.0]]
        margin = self.zoom * (self.eye_px(frame, camera) + 2 * BEYOND_EYE_PX)
        centers = (truth.placed(eye, frame, truth.looks(frame))[0] for eye in truth.centers)
        places = [(K @ truth.image_point(center, camera, sensor))[:2] for center in centers]
        low, high = np.floor(np.min(places, 0) - margin), np.ceil(np.max(places, 0) + margin)
        K[:2, 2] -= low
        return Camera(sensor.R, sensor.t, K, np.zeros(5), *(high - low).astype(int).tolist())

    def corner(self, view: Camera, camera: str) -> np.ndarray:
        """Where a cut view begins, in pixels of the capture's whole undistorted picture."""
        return self.cameras[camera].K[:2, 2] / self.sensor_per_pixel - view.K[:2, 2] / self.zoom

    def eye_px(self, frame: int, camera: str) -> float:
        """Radius of the larger eye in pixels of the capture."""
        return max(shape.radius_m / self.pixel_m(eye, frame, camera) for eye, shape in self.truth.shapes.items())


def direction(yaw: float, pitch: float) -> np.ndarray:
    """Unit direction in the head's frame, degrees to its left and up."""
    return Rotation.from_euler("YX", [yaw, -pitch], degrees=True).apply([0.0, 0.0, 1.0])


@contextmanager
def without_mirrors(avatar: Avatar) -> Iterator[None]:
    """The avatar with eyes that mirror nothing."""
    strength = avatar.visibility if avatar.spec.lobe else avatar.log_gloss
    kept = strength.detach().clone()
    with torch.no_grad():
        strength[avatar.eyes.chosen] = -torch.inf
        yield
        strength.copy_(kept)


def measure_glints(
    scene: Scene, records: Sequence[FrameRecord], cameras: Sequence[str], lights: Sequence[str],
    gazes: Sequence[tuple[float, float]],
) -> pd.DataFrame:  # fmt: skip
    """A row per frame, gaze (degrees), light, camera and eye: where the glint is and where it should be, in pixels of
    the capture's whole undistorted picture, and how far apart they are."""
    rows = []
    for record, (yaw, pitch), light in product(records, gazes, lights):
        looks, seen = direction(yaw, pitch), []
        for camera, eye in product(cameras, scene.truth.centers):
            pixel_m = scene.pixel_m(eye, record.frame, camera)
            status, point = scene.truth.glint(eye, record.frame, looks, camera, light, pixel_m)
            on_cornea = point is not None and scene.truth.on_cornea(point, eye, record.frame, looks)
            sphere = None if point is None else "cornea" if on_cornea else "eyeball"
            seen.append({
                "frame": record.frame, "segment": record.segment, "yaw": yaw, "pitch": pitch, "light": light,
                "camera": camera, "eye": eye, "status": status, "sphere": sphere, "point": point,
            })  # fmt: skip
        if any(row["point"] is not None for row in seen):
            look_for(scene, record, looks, light, seen)
        rows += seen
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.loc[table.peak < SHOWN * table.peak.max(), "error_px"] = np.inf  # what does not show is as far off as can be
    return table


def look_for(scene: Scene, record: FrameRecord, looks: np.ndarray, light: str, rows: list[dict]) -> None:
    """Render a frame under a light and add to the rows whose glint is seen what is found."""
    prepared, seen = prepare(scene, record, looks, light), [row for row in rows if row["point"] is not None]
    for camera in dict.fromkeys(row["camera"] for row in seen):
        view = scene.around_eyes(record.frame, camera)
        mirrored = mirrored_light(scene, prepared, view)
        for row in seen:
            if row["camera"] == camera:
                row |= compare(scene, record, view, mirrored, light, row)


def prepare(scene: Scene, record: FrameRecord, looks: np.ndarray, light: str) -> PreparedFrame:
    """The avatar as tracked in a frame, with another gaze, under one light."""
    driver = from_record(record)
    driver = replace(driver, gaze=np.tile(looks, (len(driver.gaze), 1)).astype(np.float32))
    return scene.relighter.under_lights(driver, FrameLights(scene.lights[light][None], np.full((1, 3), 2.0)))


def mirrored_light(scene: Scene, prepared: PreparedFrame, view: Camera) -> np.ndarray:
    """What of a picture [h, w] eyes mirror."""
    whole = scene.relighter.view(prepared, view)[0]
    with without_mirrors(scene.relighter.avatar):
        return (whole - scene.relighter.view(prepared, view)[0]).mean(-1).numpy().astype(np.float64)


def compare(
    scene: Scene, record: FrameRecord, view: Camera, mirrored: np.ndarray, light: str, row: dict
) -> dict[str, float]:
    """Where the glint of a row is expected and found, and where it would be had the eye not turned."""
    truth, frame, camera, eye = scene.truth, record.frame, row["camera"], row["eye"]

    def place(point: np.ndarray) -> np.ndarray:
        return (view.K @ truth.image_point(point, camera, scene.cameras[camera]))[:2]

    # Looked for all over the eye, not around the expected place: that would draw what is found towards it.
    middle = place(truth.placed(eye, frame, truth.looks(frame))[0])
    within = scene.zoom * (truth.shapes[eye].radius_m / scene.pixel_m(eye, frame, camera) + BEYOND_EYE_PX)
    y, x = np.mgrid[: mirrored.shape[0], : mirrored.shape[1]] + 0.5
    peak = mirrored[np.hypot(x - middle[0], y - middle[1]) < within].max()
    expected, found = place(row["point"]), centroid(mirrored, middle, within)
    still = truth.glint(eye, frame, truth.looks(frame), camera, light, 0.0)[1]
    turned = np.nan if still is None else np.hypot(*(place(still) - expected)) / scene.zoom
    places = np.concatenate([scene.corner(view, camera) + place / scene.zoom for place in (expected, found)])
    names = ("expected_x", "expected_y", "found_x", "found_y")
    error = np.hypot(*(found - expected)) / scene.zoom
    return dict(zip(names, places, strict=True)) | {"peak": peak, "error_px": error, "still_px": turned}
