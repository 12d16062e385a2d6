"""Rig from features of the subject.

COLMAP's mapping, a robust adjustment, and error bars by leaving parts of the points out.
"""

from __future__ import annotations

import copy
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pycolmap
from jaxtyping import Float64

from pipeline.calibration.cameras.feature_matches import SEED
from pipeline.calibration.cameras.image_coverage import cell_numbers
from pipeline.capture.cameras.colmap_cameras import read_image_camera
from pipeline.geometry.cameras import Camera
from pipeline.geometry.rotations import rotation_vector_from_matrix

LOSS_PX = 1.0
"""Scale of the robust loss, image pixels: SIFT is good to half of one, wrong matches to none."""

GROUPS = 10
"""Parts of the points that are left out in turn, for error bars: as many as a jackknife needs to know a deviation to
a quarter, 1 / sqrt(2 (n - 1)). A part is of whole cells of the images: what stands still is seen in the same pixels at
all moments, and is no new evidence at any; and what is wrong with a lens is wrong in a part of its image."""


@dataclass(frozen=True)
class FeatureRig:
    """Cameras that were placed, up to a similarity.

    Attributes:
        cameras: of the images that features were found in, in a unit of their own.
        centers, focals: by part of the points left out, centres laid over the rig's, and focal lengths.
        turns: likewise, about each camera's axes from the rig's, where the first camera stays: rotation vectors.
        residuals: camera, feature (of its image), point, x, y, residual_x, residual_y, image pixels.
    """

    cameras: dict[str, Camera]
    centers: Float64[np.ndarray, "groups cameras 3"]
    focals: Float64[np.ndarray, "groups cameras"]
    turns: Float64[np.ndarray, "groups cameras 3"]
    residuals: pd.DataFrame

    def center_sigma(self) -> Float64[np.ndarray, " cameras"]:
        """Standard deviation of each centre along an axis, in the rig's unit.

        The jackknife's, over the three axes.
        """
        own = np.stack([camera.center for camera in self.cameras.values()])
        return np.sqrt(self._jackknife * ((self.centers - own) ** 2).sum(0).mean(1))

    def pose_covariance(self) -> Float64[np.ndarray, "poses poses"]:
        """Covariance of turns and centres in the rig's unit, the jackknife's.

        Ordered as in `RigModel.pose_jacobian`.
        """
        own = np.stack([camera.center for camera in self.cameras.values()])
        apart = np.concatenate([self.turns, self.centers - own], 2).reshape(len(self.turns), -1)
        return self._jackknife * apart.T @ apart

    def focal_sigma(self) -> Float64[np.ndarray, " cameras"]:
        """Standard deviation of each focal length, over itself."""
        own = np.array([camera.K[0, 0] for camera in self.cameras.values()])
        return np.sqrt(self._jackknife * ((self.focals / own - 1) ** 2).sum(0))

    @property
    def _jackknife(self) -> float:
        """Variance over the sum of the groups' squares."""
        return (len(self.centers) - 1) / len(self.centers)


def map_rig(folder: Path, refine_focal: bool, refine_terms: bool) -> FeatureRig | None:
    """Map what `join_moments` wrote into `folder`; None if no two cameras share enough.

    On one thread, whose sums always come in one order: the same images give the same cameras.

    Args:
        refine_focal, refine_terms: whether focal lengths, and distortion, are found.
    """
    options = pycolmap.IncrementalPipelineOptions(
        num_threads=1, extract_colors=False, multiple_models=False, min_model_size=2, random_seed=SEED,
        ba_refine_focal_length=refine_focal, ba_refine_extra_params=refine_terms,
    )  # fmt: skip
    # COLMAP leaves out what two images alone show: all there is of two cameras, and most of what cameras 30 degrees
    # apart share.
    options.triangulation.ignore_two_view_tracks = False
    (folder / "models").mkdir(exist_ok=True)
    models = pycolmap.incremental_mapping(folder / "rig.db", folder / "images", folder / "models", options)
    if not models:
        return None
    model = max(models.values(), key=lambda each: each.num_reg_images())
    _adjust(model, refine_focal, refine_terms)
    cameras = _cameras(model)
    return FeatureRig(cameras, *_without_parts(model, cameras, refine_focal, refine_terms), _residuals(model))


def _adjust(model: pycolmap.Reconstruction, focal: bool, terms: bool) -> None:
    config = pycolmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        config.add_image(number)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    options = pycolmap.BundleAdjustmentOptions(
        print_summary=False, refine_focal_length=focal, refine_extra_params=terms, refine_principal_point=False
    )
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOSS_PX
    options.ceres.solver_options.num_threads = 1
    pycolmap.create_default_bundle_adjuster(options, config, model).solve()


def _cameras(model: pycolmap.Reconstruction) -> dict[str, Camera]:
    images = sorted((model.image(number) for number in model.reg_image_ids()), key=lambda image: image.name)
    return {image.name: read_image_camera(image, image.cam_from_world()) for image in images}


def _without_parts(
    model: pycolmap.Reconstruction, cameras: Mapping[str, Camera], focal: bool, terms: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, focal lengths and turns when each part of the points is left out."""
    own = np.stack([camera.center for camera in cameras.values()])
    centers, focals, turns, relative = [], [], [], _relative_turns(cameras)
    for left_out in _parts(model):
        rest = copy.deepcopy(model)
        for point in left_out:
            rest.delete_point3D(point)
        _adjust(rest, focal, terms)
        found = _cameras(rest)
        centers.append(fit_similarity(np.stack([found[name].center for name in cameras]), own))
        focals.append([found[name].K[0, 0] for name in cameras])
        moved = _relative_turns({name: found[name] for name in cameras}) @ relative.transpose(0, 2, 1)
        turns.append(rotation_vector_from_matrix(moved))
    return np.stack(centers), np.array(focals), np.stack(turns)


def _parts(model: pycolmap.Reconstruction) -> list[list[int]]:
    """Points in `GROUPS` parts of about one size, those of a cell of their first image together."""
    cells = defaultdict(list)
    for point in sorted(model.point3D_ids()):
        seen = min(model.point3D(point).track.elements, key=lambda element: element.image_id)
        image, camera = model.image(seen.image_id), model.camera(model.image(seen.image_id).camera_id)
        (cell,) = cell_numbers(image.points2D[seen.point2D_idx].xy[None], camera.width, camera.height)
        cells[seen.image_id, int(cell)].append(point)
    parts: list[list[int]] = [[] for _ in range(min(GROUPS, len(cells)))]
    for points in sorted(cells.values(), key=len, reverse=True):
        min(parts, key=len).extend(points)
    return parts


def _relative_turns(cameras: Mapping[str, Camera]) -> Float64[np.ndarray, "cameras 3 3"]:
    R = np.stack([camera.R for camera in cameras.values()])
    return R @ R[0].T


def fit_similarity(
    source: Float64[np.ndarray, "n 3"], target: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Points turned, shifted and scaled to lie over others, by least squares (Umeyama 1991)."""
    a, b = source - source.mean(0), target - target.mean(0)
    U, values, Vt = np.linalg.svd(a.T @ b)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = (values * sign).sum() / max((a**2).sum(), np.finfo(np.float64).tiny)
    return scale * a @ (U * sign) @ Vt + target.mean(0)


def _residuals(model: pycolmap.Reconstruction) -> pd.DataFrame:
    """Features that have a point, and how far from them it projects."""
    rows = []
    for number in model.reg_image_ids():
        image = model.image(number)
        for place, feature in enumerate(image.points2D):
            if feature.has_point3D():
                shown = image.project_point(model.point3D(feature.point3D_id).xyz)
                if shown is not None:
                    rows.append((image.name, place, feature.point3D_id, *feature.xy, *(shown - feature.xy)))
    return pd.DataFrame(rows, columns=["camera", "feature", "point", "x", "y", "residual_x", "residual_y"])
