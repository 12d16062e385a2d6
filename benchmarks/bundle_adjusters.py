"""Ways to calibrate a rig from the same corners, for bench_bundle_adjustment: ours, OpenCV's and COLMAP's."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pycolmap

from pipeline.base.conventions import PIXEL_CENTER
from pipeline.calibration.cameras.board_views import BoardViews
from pipeline.calibration.cameras.rig_calibration import calibrate_rig
from pipeline.calibration.cameras.rig_start import Start, start_rig
from pipeline.geometry.cameras import Camera

LOSS_PX = 0.12
"""Scale of pycolmap's Cauchy loss: 2.4 times the noise of good corners. Ours measures the noise itself."""

Method = Callable[[BoardViews, list[tuple[int, int]]], list[Camera]]


def ours(found: BoardViews, sizes: list[tuple[int, int]]) -> list[Camera]:
    return calibrate_rig(found.observations, found.corners_m, sizes, "auto").rig.cameras


def ours_five(found: BoardViews, sizes: list[tuple[int, int]]) -> list[Camera]:
    return calibrate_rig(found.observations, found.corners_m, sizes, 5).rig.cameras


def whole_boards(found: BoardViews) -> BoardViews:
    """Without the sightings in which a corner is missing."""
    seen = found.observations
    count = np.zeros((seen.camera.max() + 1, len(found.shot)), int)
    np.add.at(count, (seen.camera, seen.view), 1)
    whole = seen.select(count[seen.camera, seen.view] == len(found.corners_m))
    return BoardViews(whole, found.corners_m, found.shot, found.board).for_cameras(range(len(count)))


def opencv(found: BoardViews, sizes: list[tuple[int, int]]) -> list[Camera]:
    found = whole_boards(found)
    seen, views, count = found.observations, len(found.shot), len(sizes)
    pixels = np.full((count, views, len(found.corners_m), 2), -1, np.float32)
    pixels[seen.camera, seen.view, seen.corner] = seen.pixel - PIXEL_CENTER
    mask = np.zeros((count, views), np.uint8)
    mask[seen.camera, seen.view] = 1
    points = [found.corners_m.astype(np.float32)] * views
    images = [[pixels[c, v] for v in range(views)] for c in range(count)]
    models = np.full(count, cv2.CALIB_MODEL_PINHOLE, np.uint8)
    _, Ks, distortions, Rs, ts = cv2.calibrateMultiview(points, images, sizes, mask, models, None, None, None, None)
    cameras = []
    for K, dist, turn, t, size in zip(Ks, distortions, Rs, ts, sizes, strict=True):
        K = np.array(K, np.float64)
        K[:2, 2] += PIXEL_CENTER
        R = cv2.Rodrigues(np.asarray(turn, np.float64))[0] if np.size(turn) == 3 else np.asarray(turn, np.float64)
        cameras.append(Camera(R, np.ravel(t).astype(np.float64), K, np.ravel(dist)[:5].astype(np.float64), *size))
    return cameras


def colmap(found: BoardViews, sizes: list[tuple[int, int]], loss: str = "CAUCHY") -> list[Camera]:
    start = start_rig(found.observations, found.corners_m, sizes)
    return adjust_with_colmap(found, start, loss)[0]


def adjust_with_colmap(
    found: BoardViews, start: Start, loss: str = "CAUCHY", bars: bool = False, scale_px: float = LOSS_PX
) -> tuple[list[Camera], np.ndarray]:
    """A rig of sensors before one board per frame: the board is the world, its corners are constant points.

    Also the relative standard deviations of the focal lengths, if `bars`: pycolmap's covariance, which is for a noise
    of one pixel, times the noise that the residuals have.
    """
    seen, sizes = found.observations, [(camera.width, camera.height) for camera in start.cameras]
    scene, rig = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1)
    root = _rigid(start.cameras[0])
    for c, camera in enumerate(start.cameras):
        K, (k1, k2, p1, p2, _) = camera.K, camera.dist
        parameters = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], k1, k2, p1, p2]
        scene.add_camera(pycolmap.Camera(
            camera_id=c + 1, model="OPENCV", width=camera.width, height=camera.height, params=parameters
        ))  # fmt: skip
        sensor = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, c + 1)
        if c == 0:
            rig.add_ref_sensor(sensor)
        else:
            rig.add_sensor(sensor, _rigid(camera) * root.inverse())
    scene.add_rig(rig)
    for k, point in enumerate(found.corners_m):
        scene.add_point3D_with_id(k + 1, pycolmap.Point3D(xyz=point))
    config, image_id = pycolmap.BundleAdjustmentConfig(), 0
    for v, board in enumerate(start.rig_from_board):
        pose = root * pycolmap.Rigid3d(board[:3])
        frame = pycolmap.Frame(frame_id=v + 1, rig_id=1, rig_from_world=pose)
        images = []
        for c in np.unique(seen.camera[seen.view == v]):
            image_id += 1
            mine = (seen.view == v) & (seen.camera == c)
            image = pycolmap.Image(
                name=str(image_id), keypoints=seen.pixel[mine], camera_id=int(c) + 1, image_id=image_id
            )
            image.frame_id = v + 1
            frame.add_data_id(image.data_id)
            images.append((image, seen.corner[mine]))
        scene.add_frame(frame)
        for image, corners in images:
            scene.add_image(image)
            for k, corner in enumerate(corners):
                scene.add_observation(int(corner) + 1, pycolmap.TrackElement(image.image_id, k))
            config.add_image(image.image_id)
        scene.register_frame(v + 1)
    for k in range(len(found.corners_m)):
        if scene.point3D(k + 1).track.length():
            config.add_constant_point(k + 1)
    options = pycolmap.BundleAdjustmentOptions(refine_principal_point=True, print_summary=False)
    options.ceres.loss_function_type = getattr(pycolmap.LossFunctionType, loss)
    options.ceres.loss_function_scale = scale_px
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(options, config, scene)
    adjuster.solve()
    sigma = np.full(len(sizes), np.nan)
    if bars:
        sigma = _focal_bars(scene, adjuster, len(sizes))
    cameras = []
    for c, size in enumerate(sizes):
        fx, fy, cx, cy, *dist = scene.camera(c + 1).params
        pose = pycolmap.Rigid3d() if c == 0 else scene.rig(1).sensor_from_rig(
            pycolmap.sensor_t(pycolmap.SensorType.CAMERA, c + 1)
        )  # fmt: skip
        R, t = pose.rotation.matrix(), np.asarray(pose.translation)
        K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        cameras.append(Camera(R, t, K, np.array([*dist, 0.0]), *size))
    return cameras, sigma


def _focal_bars(
    scene: pycolmap.Reconstruction, adjuster: pycolmap.CeresBundleAdjuster, count: int
) -> np.ndarray:  # fmt: skip
    """Relative deviations of focal lengths; NaN where pycolmap has no covariance, as of rigs (4.2.1 refuses them)."""
    try:
        covariance = pycolmap.estimate_ba_covariance(pycolmap.BACovarianceOptions(), scene, adjuster)
    except ValueError as error:
        print(f"pycolmap {pycolmap.__version__}: no covariance: {error}", flush=True)
        return np.full(count, np.nan)
    lenses = [scene.camera(c + 1).params for c in range(count)]
    return _noise_px(scene) * np.array([np.sqrt(covariance.get_other_params_cov(p)[0, 0]) / p[0] for p in lenses])


def _noise_px(scene: pycolmap.Reconstruction) -> float:
    """Standard deviation of one coordinate of a corner, by the median residual, which gross errors do not move."""
    lengths = []
    for image in scene.images.values():
        corners = [point for point in image.points2D if point.has_point3D()]
        for point in corners:
            pixel = image.project_point(scene.point3D(point.point3D_id).xyz)
            lengths.append(np.linalg.norm(pixel - point.xy))
    # The median of Rayleigh's distribution over its scale.
    return float(np.median(lengths) / np.sqrt(2 * np.log(2)))


def _rigid(camera: Camera) -> pycolmap.Rigid3d:
    return pycolmap.Rigid3d(np.concatenate([camera.R, camera.t[:, None]], 1))


METHODS: dict[str, Method] = {
    "ours, auto distortion": ours,
    "ours, 5 coefficients": ours_five,
    "ours, 5 coefficients, whole boards": lambda found, sizes: ours_five(whole_boards(found), sizes),
    "cv2.calibrateMultiview, 5 coefficients, whole boards": opencv,
    "pycolmap, Cauchy, 4 coefficients": colmap,
    "pycolmap, least squares, 4 coefficients": lambda found, sizes: colmap(found, sizes, "TRIVIAL"),
}
