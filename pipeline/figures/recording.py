"""The tracked capture as a recording for rerun's viewer.

It has cameras, lights, images, keypoints and the moving mesh. Images are undistorted, so that the viewer, whose cameras
are pinholes, lays the mesh over them where it belongs. Its pixels count from the image's upper left corner, as ours do.

Entities: stage/mesh, stage/lights, stage/keypoints/tracked and .../triangulated; stage/cameras/{camera} with image,
image/detected and image/tracked below; errors/keypoints_px, errors/overlap. Timelines: frame, time.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pipeline.base.color import srgb_from_linear
from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.spread import evenly
from pipeline.capture.reduced_images import reduction
from pipeline.capture.undistortion import Box, distorted_positions
from pipeline.config.review_tracking import ReviewTracking
from pipeline.figures.tracked_capture import TrackedCapture
from pipeline.geometry.cameras import Camera
from pipeline.geometry.mesh import vertex_normals, weld_vertices
from pipeline.lighting.frame_lights import CHANNELS

DETECTED, TRACKED, SKIN = (86, 180, 233), (240, 228, 66), (190, 180, 172)

UNLIT = 45
"""Grey of a light that is off."""

WHITE_PERCENTILE, WHITE_LEVEL = 99.5, 0.8
"""Percentile of a camera's fully lit image, and the linear brightness that it is shown with.

All images of the camera keep that exposure.
"""

FRUSTUM_M, LIGHT_M, KEYPOINT_M = 0.15, 0.03, 0.012
KEYPOINT_PT = 2.5

SHOWN_CAMERAS = 4
"""Cameras with a view of their own when the recording is opened."""


@dataclass(frozen=True)
class _Shown:
    """A camera of the recording.

    Attributes:
        distorted: at the size of the recording's images.
        factor: image pixels per pixel of these.
        exposure: shown over corrected linear colour.
    """

    name: str
    distorted: Camera
    factor: int
    exposure: float

    @property
    def pinhole(self) -> Camera:
        """The same without distortion."""
        return self.distorted.pinhole()

    @property
    def entity(self) -> str:
        """Its place in the recording."""
        return f"stage/cameras/{self.name}"


def write_recording(path: Path, found: TrackedCapture, settings: ReviewTracking, pool: Executor) -> None:
    """Write an .rrd file of about `settings.recording_mb` at most.

    Of more frames than fit, evenly chosen ones.
    """
    names = evenly(list(found.cameras), settings.recording_cameras)
    shown = list(pool.map(lambda name: _shown_camera(found, name, settings.recording_size_px), names))
    weld = weld_vertices(found.template.vertices_rest, found.template.faces)
    # No properties and no wall-clock time: they would differ from run to run.
    stream = rr.RecordingStream("review_tracking", recording_id=f"tracking of {found.subject}", send_properties=False)
    stream.set_log_time_enabled(False)
    stream.save(path, default_blueprint=_blueprint(shown))
    stream.log("stage", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    mesh = rr.Mesh3D.from_fields(triangle_indices=found.template.faces.astype(np.uint32), albedo_factor=SKIN)
    stream.log("stage/mesh", mesh, static=True)
    for one in shown:
        _log_camera(stream, one)
    rows, kept = range(len(found.frames)), None
    for row in rows:
        _set_time(stream, found, row)
        _log_errors(stream, found, row)
        if kept is None or row in kept:
            images = list(pool.map(lambda one, row=row: _jpeg(found, one, row, settings.recording_jpeg_quality), shown))
            if kept is None:
                # The first frame tells how large the others get; positions and normals hardly compress.
                size = sum(map(len, images)) + 2 * found.vertices[row].nbytes
                kept = set(evenly(rows, max(1, int(settings.recording_mb * 1e6 / size))))
            _log_images(stream, found, shown, images, row)
            _log_stage(stream, found, row, weld)
    stream.disconnect()


def _blueprint(shown: Sequence[_Shown]) -> rrb.Blueprint:
    views = [
        rrb.Spatial2DView(origin=f"{one.entity}/image", name=one.name, contents=["$origin/**"])
        for one in evenly(shown, SHOWN_CAMERAS)
    ]
    errors = rrb.TimeSeriesView(origin="errors", name="error per frame")
    stage = rrb.Spatial3DView(origin="stage", name="stage")
    left = rrb.Vertical(stage, errors, row_shares=[3, 1])
    return rrb.Blueprint(rrb.Horizontal(left, rrb.Grid(*views), column_shares=[3, 2]), collapse_panels=True)


def _shown_camera(found: TrackedCapture, name: str, longest_px: int) -> _Shown:
    factor = reduction(found.cameras[name], longest_px)
    lit = np.flatnonzero(found.frames.fully_lit) if found.frames.fully_lit.any() else np.arange(len(found.frames))
    row = int(lit[len(lit) // 2])
    image, mask = found.image(name, row, factor), found.mask(name, row, factor)
    white = 1.0
    if image is not None:
        subject = image if mask is None or not (mask > 0.5).any() else image[mask > 0.5]
        white = max(float(np.percentile(subject, WHITE_PERCENTILE)), 1e-6)
    return _Shown(name, found.cameras[name].downsampled(float(factor)), factor, WHITE_LEVEL / white)


def _log_camera(stream: rr.RecordingStream, one: _Shown) -> None:
    camera = one.pinhole
    stream.log(one.entity, rr.Transform3D(translation=camera.center, mat3x3=camera.R.T), static=True)
    pinhole = rr.Pinhole(
        image_from_camera=camera.K, resolution=[camera.width, camera.height], camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=FRUSTUM_M,
    )  # fmt: skip
    stream.log(f"{one.entity}/image", pinhole, static=True)


def _set_time(stream: rr.RecordingStream, found: TrackedCapture, row: int) -> None:
    stream.set_time("frame", sequence=int(found.frames.frame.iloc[row]))
    stream.set_time("time", duration=float(found.frames.timestamp_s.iloc[row]))


def _jpeg(found: TrackedCapture, one: _Shown, row: int, quality: int) -> bytes:
    """The undistorted image, encoded; empty if the camera has none."""
    image = found.image(one.name, row, one.factor)
    if image is None:
        return b""
    camera = one.distorted
    places = distorted_positions(camera, Box(0, 0, camera.width, camera.height)) - PIXEL_CENTER
    straight = cv2.remap(image, places.astype(np.float32), None, cv2.INTER_LINEAR)
    shown = np.round(255 * np.clip(srgb_from_linear(straight * np.float32(one.exposure)), 0, 1)).astype(np.uint8)
    return cv2.imencode(".jpg", shown[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _log_images(
    stream: rr.RecordingStream, found: TrackedCapture, shown: Sequence[_Shown], images: Sequence[bytes], row: int
) -> None:
    for one, content in zip(shown, images, strict=True):
        entity = f"{one.entity}/image"
        if content:
            stream.log(entity, rr.EncodedImage(contents=content, media_type="image/jpeg"))
        else:
            stream.log(entity, rr.EncodedImage.cleared())
        detected = found.detected[list(found.cameras).index(one.name), row] / one.factor
        straight, seen = np.full_like(detected, np.nan), np.isfinite(detected).all(1)
        if seen.any():
            straight[seen] = one.distorted.undistort(detected[seen])
        seen = np.isfinite(straight).all(1)  # a fisheye also shows what no pinhole does
        tracked, depth = one.pinhole.project(found.keypoints_m[row])
        sets = {
            "detected": (straight[seen] @ one.pinhole.K[:2, :2].T + one.pinhole.K[:2, 2], seen, DETECTED),
            "tracked": (tracked[depth > 0], depth > 0, TRACKED),
        }
        for name, (pixels, which, color) in sets.items():
            labels = [label for label, there in zip(found.keypoint_names, which, strict=True) if there]
            points = rr.Points2D(
                pixels, colors=color, labels=labels, show_labels=False, radii=rr.Radius.ui_points(KEYPOINT_PT)
            )
            stream.log(f"{entity}/{name}", points)


def _log_stage(stream: rr.RecordingStream, found: TrackedCapture, row: int, weld: np.ndarray) -> None:
    vertices = found.vertices[row]
    normals = vertex_normals(vertices.astype(np.float64), found.template.faces, weld).astype(np.float32)
    stream.log("stage/mesh", rr.Mesh3D.from_fields(vertex_positions=vertices, vertex_normals=normals))
    sets = {"tracked": (found.keypoints_m[row], TRACKED), "triangulated": (found.triangulated_m[row], DETECTED)}
    for name, (places, color) in sets.items():
        known = np.isfinite(places).all(1)
        labels = [label for label, there in zip(found.keypoint_names, known, strict=True) if there]
        points = rr.Points3D(places[known], colors=color, labels=labels, show_labels=False, radii=KEYPOINT_M)
        stream.log(f"stage/keypoints/{name}", points)
    lights = found.lights[np.isfinite(found.lights[["x", "y", "z"]]).all(axis=1)]
    colors = np.full((len(lights), 3), UNLIT, np.uint8)
    on = found.patterns[found.patterns.frame == found.frames.frame.iloc[row]].set_index("light")[CHANNELS]
    lit = lights.light.isin(on.index).to_numpy()
    power = on.loc[lights.light[lit]].to_numpy(np.float64)
    share = power / max(float(found.patterns[CHANNELS].to_numpy().max()), 1e-12)
    colors[lit] = np.round(UNLIT + (255 - UNLIT) * np.clip(srgb_from_linear(share), 0, 1))
    places = lights[["x", "y", "z"]].to_numpy(np.float64)
    stream.log("stage/lights", rr.Points3D(places, colors=colors, labels=list(lights.light), show_labels=False,
                                           radii=LIGHT_M))  # fmt: skip


def _log_errors(stream: rr.RecordingStream, found: TrackedCapture, row: int) -> None:
    for name, column in (("keypoints_px", "rms_px"), ("overlap", "silhouette_iou")):
        value = float(found.frames[column].iloc[row])
        if np.isfinite(value):
            stream.log(f"errors/{name}", rr.Scalars(value))
