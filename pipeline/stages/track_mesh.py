"""Keypoints and masks in, posed template vertices of every frame out.

Reads the index tables, calibrated cameras and the template; writes `out`/{chunk:04d}.safetensors (frames, vertices,
joint_rotations, root_rotation, root_translation; offsets: of vertices before skinning, metres, already in `vertices`;
keypoints and keypoint_sigma_m: triangulated) and a .parquet of the same name with one row per frame: status
("refined" by the images of a fully lit frame; "carried": a frame between such, with their corrections and its own
keypoints; "tracked" without images; "interpolated" where too few keypoints were seen), rms_px, inliers, ... A rigged
template is posed by a robust least-squares fit of all frames of the chunk together (`pipeline.tracking.mesh_tracker`);
an unrigged one (a head) moves by a root transform and smooth offsets (`pipeline.tracking.surface_tracker`), without
comparing images. Lit or not, every frame is tracked. Held-out cameras take no part unless `use_test_cameras` says so.

Meshes that were tracked elsewhere are taken as they are (`pipeline.tracking.given_meshes`); the status of a frame is
then "given", "between" two of them, or "held" where there is one on one side only.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_arrays, write_table
from pipeline.base.verdicts import Verdict, log_verdicts, verdict_table
from pipeline.config.track_mesh import TrackMesh
from pipeline.geometry.signed_distance import View, silhouette_overlap
from pipeline.geometry.skin import Template
from pipeline.geometry.surface_points import spread_vertices
from pipeline.geometry.template_file import read_template
from pipeline.lighting.frame_lights import read_frame_lights
from pipeline.tracking.chunk_views import ChunkViews, read_chunk
from pipeline.tracking.color_views import read_color_views
from pipeline.tracking.cues import Rounds
from pipeline.tracking.fit_verdicts import complain_of_misfits, fit_verdicts
from pipeline.tracking.given_meshes import GivenTracking, read_given
from pipeline.tracking.hinges import hinge_axes
from pipeline.tracking.keyframe_refinement import KeyframeRefinement
from pipeline.tracking.keypoint_targets import NO_TARGETS, KeypointTargets, read_keypoint_targets
from pipeline.tracking.mask_interpolation import interpolated_views
from pipeline.tracking.mesh_tracker import Tracking, TrackingLimits, track
from pipeline.tracking.motion_prior import MotionPrior
from pipeline.tracking.photometric_refinement import PhotometricSettings, fully_lit_frames, photometric_refinement
from pipeline.tracking.silhouette_cue import SilhouetteCue
from pipeline.tracking.surface_tracker import DeformationPrior, track_surface
from pipeline.tracking.tracking_inputs import detected_pixels, keypoint_observations, keypoint_residuals
from pipeline.tracking.tracking_outputs import frame_table, tracked_arrays, tracked_vertices

LOG = logging.getLogger("track_mesh")

NEAR_SHARE = 0.01
"""Of an image's height: a keypoint that is further from a given mesh's is elsewhere. Networks look for landmarks in
some 256 pixels, and are good to one or two of them; what they found did not place the mesh."""


def run(
    *, capture: Path, index: Path, cameras: Path, chunk: int, out: Path, chunk_size: int = 64,
    patterns: Path | None = None, lights: Path | None = None, settings: TrackMesh = TrackMesh(),
) -> None:  # fmt: skip
    """Pose the template in every frame of one chunk.

    It is fitted to 2D keypoints, masks and fully lit images. So many arguments because a command line names each file
    that it reads.

    Args:
        capture: the capture folder, to which the index's paths are relative.
        index: folder of index tables that index_capture wrote.
        cameras: cameras.json at sensor resolution, in the stage frame.
        chunk: which chunk of sorted frames: [chunk * chunk_size, (chunk + 1) * chunk_size).
        out: folder for {chunk:04d}.safetensors, {chunk:04d}.parquet and verdicts_{chunk:04d}.csv.
        chunk_size: frames per chunk.
        patterns: patterns.parquet of book_patterns: which frames are fully lit; without it, images are not compared.
        lights: lights.parquet of calibrate_lights; needed with `patterns`.
        settings: numbers and modes.
    """
    content = read_json(index / "capture.json")
    frames = read_table(index / "frames.parquet").sort_values("frame", ignore_index=True)
    first, last = chunk * chunk_size, min((chunk + 1) * chunk_size, len(frames))
    if not 0 <= first < last:
        raise InputError(f"chunk: expected 0 to {(len(frames) - 1) // chunk_size}, found {chunk}; {len(frames)} frames")
    mesh = capture / content["template"]["mesh"]
    template = read_template(mesh, float(content["template"]["scale_to_m"]))
    targets = NO_TARGETS
    if content["template"].get("keypoints") is not None:
        targets = read_keypoint_targets(capture / content["template"]["keypoints"], template)
    if "meshes" in content:
        given = read_given(
            capture, read_table(index / "meshes.parquet"), content["meshes"], template, frames, slice(first, last)
        )
        numbers = frames.frame.to_numpy(np.int64)[first:last]
        seen = read_chunk(capture, index, cameras, numbers, settings, masks=True, test_cameras=True)
        write_given(out, chunk, given, seen, template, targets, settings)
        return
    if targets is NO_TARGETS:
        raise InputError("capture.yaml: template.keypoints: expected a csv of keypoints on the template, found none")
    start = max(first - settings.context_frames, 0)
    with_context = frames.iloc[start : last + settings.context_frames]
    numbers = with_context.frame.to_numpy(np.int64)
    seen = read_chunk(
        capture, index, cameras, numbers, settings,
        masks=settings.outline_rounds > 0, test_cameras=settings.use_test_cameras,
    )  # fmt: skip
    observations = keypoint_observations(seen.keypoints, seen.cameras, numbers, targets)
    times_s, takes = with_context.timestamp_s.to_numpy(np.float64), pd.factorize(with_context.segment)[0]
    prior = MotionPrior(
        times_s, settings.rotation_acceleration, settings.translation_acceleration, settings.rest_rotation,
        hinges=hinge_axes(settings.hinges, mesh, template), takes=takes.astype(np.int64),
    )  # fmt: skip
    views, between = list(seen.masked.values()), []
    if settings.mask_gap_frames:
        between = interpolated_views(views, times_s, prior.takes, settings.mask_gap_frames)
    silhouettes = silhouette_cues(views, between, template, settings)
    schedule = [Rounds("silhouettes", silhouettes, settings.outline_rounds)] if silhouettes else []
    limits = TrackingLimits(settings.inlier_px, settings.min_keypoints, settings.max_iterations)
    if template.rigged:
        refinement = None
        if settings.image_rounds and patterns is not None and lights is not None:
            refinement = refine_by_images(seen, template, patterns, lights, silhouettes, settings)
        tracking = track(template, targets, observations, prior, schedule, limits, refinement)
    else:
        deformation = DeformationPrior(
            settings.deformation_modes, settings.deformation_m, settings.deformation_length_m,
            settings.deformation_time_s, settings.deformation_still_m,
        )  # fmt: skip
        tracking = track_surface(template, deformation, targets, observations, prior, schedule, limits)
    LOG.info("keypoint noise %.2f px, misfit %.2f px", tracking.noise_px, tracking.sigma_px)
    LOG.info("bones measure %.3f x the template's", tracking.size_ratio)
    kept = slice(first - start, last - start)
    write_tracked(out, chunk, kept, template, tracking, seen, between, settings)


def silhouette_cues(
    views: list[View], between: list[View], template: Template, settings: TrackMesh
) -> list[SilhouetteCue]:
    """Cues of outlines that were seen, and of those interpolated between them."""
    chosen = spread_vertices(template.vertices_rest, settings.outline_vertices)
    cues = [SilhouetteCue(views, template.faces, chosen, settings.outline_sigma_px)] if views else []
    if any(view.usable.any() for view in between):
        cues.append(SilhouetteCue(between, template.faces, chosen, settings.interpolated_sigma_px))
    return cues


def refine_by_images(
    seen: ChunkViews, template: Template, patterns: Path, lights: Path, silhouettes: list[SilhouetteCue],
    settings: TrackMesh,
) -> KeyframeRefinement:  # fmt: skip
    """Refinement of poses by the colours of fully lit frames."""
    lit = fully_lit_frames(patterns, seen.frames, settings.image_frames)
    colors = read_color_views(
        seen.source, seen.images, seen.cameras, seen.frames, lit, settings.image_cameras, settings.image_size_px
    )
    return photometric_refinement(
        template, colors, read_frame_lights(lights, patterns), seen.frames, lit, silhouettes,
        PhotometricSettings(
            settings.image_rounds, settings.image_points, settings.image_redundancy, settings.offset_m
        ),
    )  # fmt: skip


def write_given(
    out: Path, chunk: int, given: GivenTracking, seen: ChunkViews, template: Template, targets: KeypointTargets,
    settings: TrackMesh,
) -> None:  # fmt: skip
    """Write meshes that were tracked elsewhere, and say which frames lie between them."""
    detected = detected_pixels(seen.keypoints, list(seen.cameras), seen.frames, targets.names)
    away = keypoint_residuals(detected, seen.cameras.values(), given.vertices[:, targets.vertices])
    near_px = max(settings.inlier_px, NEAR_SHARE * max(camera.height for camera in seen.cameras.values()))
    table = given.table(seen.frames, list(seen.masked.values()), template.faces, away, near_px)
    for status, why in (("between", "interpolated between given ones"), ("held", "the nearest given one's")):
        if named := table.frame[table.status == status].tolist():
            LOG.warning("%d frames have no mesh: %s: %s", len(named), why, named)
    overlaps = {name: silhouette_overlap([view], given.vertices, template.faces) for name, view in seen.masked.items()}
    # Whether keypoints and masks fit is said here, and decided when a set is imported.
    inliers, observations = int(table.inliers.sum()), int(table.observations.sum())
    verdicts = fit_verdicts(inliers, observations, overlaps)
    verdicts = [verdict for verdict in verdicts if verdict.kind == "masks" or observations]
    log_verdicts(LOG, verdicts)
    write(out, chunk, table, given.arrays(seen.frames, len(targets.names)), verdicts)


def write_tracked(
    out: Path, chunk: int, kept: slice, template: Template, tracking: Tracking, seen: ChunkViews, between: list[View],
    settings: TrackMesh,
) -> None:  # fmt: skip
    """Write what was found, once it is clear that it is the subject."""
    vertices = tracked_vertices(template, tracking, kept)
    every = np.arange(len(seen.frames))[kept]
    views = {name: view.at(every) for name, view in seen.masked.items()}
    table = frame_table(
        seen.frames, kept, template, tracking, vertices, list(views.values()), [view.at(every) for view in between],
        settings.inlier_px,
    )  # fmt: skip
    log_frames(table, bool(views))
    overlaps = {name: silhouette_overlap([view], vertices, template.faces) for name, view in views.items()}
    verdicts = fit_verdicts(int(table.inliers.sum()), int(table.observations.sum()), overlaps)
    log_verdicts(LOG, verdicts)
    if settings.on_misfit == "error":
        complain_of_misfits(verdicts, f"track_mesh, chunk {chunk}")
    write(out, chunk, table, tracked_arrays(seen.frames, kept, template, tracking, vertices), verdicts)


def log_frames(table: pd.DataFrame, masked: bool) -> None:
    """Log how many frames have which status, and which of them lacked something."""
    if interpolated := table.frame[table.status == "interpolated"].tolist():
        LOG.warning("%d frames had too few keypoints and were interpolated: %s", len(interpolated), interpolated)
    if masked and (unmasked := table.frame[table.masks == 0].tolist()):
        LOG.warning("%d frames have no mask; interpolated poses stand in for silhouettes: %s", len(unmasked), unmasked)
    for status, rows in table.groupby("status"):
        LOG.info("%d frames %s", len(rows), status)


def write(
    out: Path, chunk: int, table: pd.DataFrame, arrays: Mapping[str, np.ndarray], verdicts: list[Verdict]
) -> None:
    """Write all outputs of the stage."""
    write_table(out / f"verdicts_{chunk:04d}.csv", verdict_table(verdicts))
    write_arrays(out / f"{chunk:04d}.safetensors", arrays)
    write_table(out / f"{chunk:04d}.parquet", table)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
