"""Our bundle adjustment of a rig against cv2.calibrateMultiview and pycolmap: one JSON line per data set and method.

    python -m benchmarks.bench_bundle_adjustment [--capture CAPTURE] [--results RESULTS] [--repeats 3]

Data sets: the corners detected in the capture's images; the same corners as the true cameras see them, with Gaussian
noise; and those with gross errors. All methods estimate f, principal point and distortion; the errors are against the
capture's truth, centres after a rigid motion. pycolmap has no start of its own and gets ours; cv2.calibrateMultiview
(5.0) diverges on boards of which some corners are not seen, so it gets whole boards only, beside ours on the same.
Seconds are medians over repeats that take the methods in turn, and include the start.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import cv2
import numpy as np
import scipy.optimize
import scipy.spatial.transform

from benchmarks.bundle_adjusters import LOSS_PX, METHODS
from pipeline.base.conventions import PIXEL_CENTER
from pipeline.base.files import read_json
from pipeline.calibration.cameras.board_search import find_boards
from pipeline.calibration.cameras.board_views import BoardViews, gather_views
from pipeline.calibration.cameras.declared_boards import boards_from_index
from pipeline.calibration.cameras.rig import adjust_rig
from pipeline.calibration.cameras.rig_inputs import Observations
from pipeline.calibration.cameras.rig_start import start_rig
from pipeline.geometry.cameras import Camera, read_cameras

NOISE_PX, GROSS_SHARE, GROSS_PX = 0.05, 0.03, 20.0


def read_corners(capture: Path, results: Path) -> tuple[BoardViews, list[str], list[Camera]]:
    """What the capture's images show, and its true cameras."""
    calibration = read_json(results / "index/calibration_cameras.json")
    truth = read_cameras(capture / "truth/cameras.json")
    names, boards = sorted(truth), boards_from_index(calibration)
    sizes = {name: (truth[name].width, truth[name].height) for name in names}
    detections = find_boards(capture, calibration["views"], sizes, boards, 2).detections
    return gather_views(detections, calibration["views"], names, boards), names, [truth[name] for name in names]


def reproject(found: BoardViews, truth: list[Camera], gross: float) -> BoardViews:
    """The same corners seen by the true cameras, boards where the images put them; noise, a share of gross errors."""
    seen, rng = found.observations, np.random.default_rng(0)
    boards = adjust_true_boards(found, truth)
    points = np.einsum("nij,nj->ni", boards[seen.view, :3, :3], found.corners_m[seen.corner]) + boards[seen.view, :3, 3]
    pixels = np.empty_like(seen.pixel)
    for c, camera in enumerate(truth):
        mine = seen.camera == c
        turn = cv2.Rodrigues(camera.R)[0]
        projected = cv2.projectPoints(points[mine], turn, camera.t, camera.opencv_K(), camera.dist)[0]
        pixels[mine] = projected.reshape(-1, 2) + PIXEL_CENTER
    pixels += rng.normal(0, NOISE_PX, pixels.shape)
    wrong = rng.random(len(pixels)) < gross
    pixels[wrong] += rng.uniform(-GROSS_PX, GROSS_PX, (wrong.sum(), 2))
    observations = Observations(seen.camera, seen.view, seen.corner, pixels)
    return BoardViews(observations, found.corners_m, found.shot, found.board)


def adjust_true_boards(found: BoardViews, truth: list[Camera]) -> np.ndarray:
    """Poses of the boards before the true cameras: those of the adjusted rig, moved onto them."""
    sizes = [(camera.width, camera.height) for camera in truth]
    start = start_rig(found.observations, found.corners_m, sizes)
    rig = adjust_rig(found.observations, found.corners_m, start.cameras, start.rig_from_board, 5)
    turn, shift = align(rig.cameras, truth)
    moved = np.tile(np.eye(4), (len(rig.rig_from_board), 1, 1))
    moved[:, :3, :3] = turn @ rig.rig_from_board[:, :3, :3]
    moved[:, :3, 3] = rig.rig_from_board[:, :3, 3] @ turn.T + shift
    return moved


def align(cameras: list[Camera], truth: list[Camera]) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation that move the cameras' centres onto the true ones."""
    a, b = (np.stack([camera.center for camera in each]) for each in (cameras, truth))
    turn = scipy.spatial.transform.Rotation.align_vectors(b - b.mean(0), a - a.mean(0))[0].as_matrix()
    return turn, b.mean(0) - turn @ a.mean(0)


def errors(cameras: list[Camera], truth: list[Camera]) -> dict[str, float]:
    turn, shift = align(cameras, truth)
    away = np.stack([turn @ c.center + shift - t.center for c, t in zip(cameras, truth, strict=True)])
    focal = np.array([c.K[0, 0] / t.K[0, 0] - 1 for c, t in zip(cameras, truth, strict=True)])
    return {
        "center_error_mm": round(1e3 * float(np.sqrt((away**2).sum(1).mean())), 3),
        "focal_error_percent": round(1e2 * float(np.sqrt((focal**2).mean())), 4),
    }


def reprojection_rms(found: BoardViews, cameras: list[Camera]) -> tuple[float, float]:
    """Root mean square and median over all corners, boards placed anew for these cameras (which do not move), px."""
    seen, lengths = found.observations, []
    for v in range(len(found.shot)):
        rows = [seen.select((seen.view == v) & (seen.camera == c)) for c in range(len(cameras))]
        lengths.append(place_board(found.corners_m, cameras, rows))
    length = np.concatenate(lengths)
    return float(np.sqrt((length**2).mean())), float(np.median(length))


def place_board(points: np.ndarray, cameras: list[Camera], rows: list[Observations]) -> np.ndarray:
    """Distance of each corner from where the best pose of the board puts it."""
    seeing = [(camera, row) for camera, row in zip(cameras, rows, strict=True) if len(row.corner)]
    best, row = max(seeing, key=lambda pair: len(pair[1].corner))
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points[row.corner], best.undistort(row.pixel), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )

    def apart(x: np.ndarray) -> np.ndarray:
        placed = points @ scipy.spatial.transform.Rotation.from_rotvec(x[:3]).as_matrix().T + x[3:]
        return np.concatenate([camera.project(placed[row.corner])[0] - row.pixel for camera, row in seeing]).ravel()

    fits = []
    for turn, shift in zip(turns, shifts, strict=True):
        R = best.R.T @ cv2.Rodrigues(turn)[0]
        start = np.concatenate([cv2.Rodrigues(R)[0].ravel(), best.R.T @ (shift.ravel() - best.t)])
        fits.append(scipy.optimize.least_squares(apart, start, loss="cauchy", f_scale=LOSS_PX))
    fit = min(fits, key=lambda result: result.cost)
    return np.linalg.norm(apart(fit.x).reshape(-1, 2), axis=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path, default=Path("captures/subjectA"))
    parser.add_argument("--results", type=Path, default=Path("results/subjectA"))
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    found, _, truth = read_corners(options.capture, options.results)
    sizes = [(camera.width, camera.height) for camera in truth]
    data = {
        "detected": found,
        f"projected, noise {NOISE_PX} px": reproject(found, truth, 0.0),
        f"projected, {GROSS_SHARE:.0%} gross errors": reproject(found, truth, GROSS_SHARE),
    }
    for name, views in data.items():
        seconds, cameras = {method: [] for method in METHODS}, {}
        for _ in range(options.repeats):
            for method, solve in METHODS.items():
                start = time.perf_counter()
                cameras[method] = solve(views, sizes)
                seconds[method].append(time.perf_counter() - start)
        reference = statistics.median(seconds["ours, 5 coefficients"])
        for method in METHODS:
            rms, median = reprojection_rms(views, cameras[method])
            taken = statistics.median(seconds[method])
            print(json.dumps({
                "data": name, "method": method, **errors(cameras[method], truth), "rms_px": round(rms, 4),
                "median_px": round(median, 4), "seconds": round(taken, 3), "times_ours": round(taken / reference, 2),
            }))  # fmt: skip


if __name__ == "__main__":
    main()
