"""Show an avatar in new light: poses of a tracked sequence, a camera path, and an environment map or point lights.

In: an avatar, tracked chunks, and one light: a panorama (.hdr, .exr), which may turn, or a list of point lights (.csv,
.json), which may move. Out, in one folder: film.mp4, stills/{picture}.png and .exr, splats/{picture}.ply (standard
3DGS files, without view-dependent parts) and pictures.parquet, which says what each picture shows.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.avatar.checkpoint import load_avatar
from pipeline.avatar.driving import Driver
from pipeline.avatar.light_sources import ListedLights, TurningSky
from pipeline.avatar.relighting import Relighter, view_independent_color
from pipeline.base.color import srgb_from_linear
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError, listed
from pipeline.base.files import read_arrays, write_table, written_whole
from pipeline.base.progress import progress
from pipeline.capture.head_data import head_motions
from pipeline.capture.images import write_exr, write_png
from pipeline.capture.video import write_video
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.camera_paths import orbit, through_cameras, through_keyframes
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.tracked import read_tracked
from pipeline.lighting.environment import read_environment
from pipeline.lighting.light_lists import read_light_list
from pipeline.rendering.splat_ply import Splats, write_splats

log = logging.getLogger("relight_avatar")


def run(
    *,
    atlas: Path,
    avatar: Path,
    tracking: tuple[Path, ...],
    out: Path,
    environment: Path | None = None,
    lights: Path | None = None,
    cameras: Path | None = None,
    keyframes: Path | None = None,
    settings: RelightAvatar = RelightAvatar(),
) -> None:
    """Render an avatar under new light.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        avatar: folder of train_avatar.
        tracking: chunks of track_mesh, in order.
        out: folder for film, stills and splats.
        environment: panorama that lights the avatar.
        lights: point lights instead: columns light, x, y, z [m], r, g, b and, if they move, picture.
        cameras: calibration/cameras.json, for --camera-names.
        keyframes: camera path as JSON: {"keyframes": [{picture, eye, target, fov_y_degrees}, ...]}.
        settings: see the flags below.
    """
    if (environment is None) == (lights is None):
        raise InputError("expected either --environment or --lights, found both or neither; name one light")
    relighter = Relighter(load_avatar(avatar, atlas), TraceIrradiance(samples=settings.shadow_samples))
    numbers, vertices = read_poses(tracking, len(relighter.atlas.rest_vertices), settings)
    pictures = settings.pictures or len(numbers)
    poses = np.arange(pictures) * len(numbers) // pictures
    motions = motions_of_heads(tracking) if relighter.avatar.spec.head else {}
    path = camera_path(vertices, cameras, keyframes, settings, pictures)
    if environment is None:
        light = ListedLights(relighter, read_light_list(lights))
    else:
        light = TurningSky(relighter, read_environment(environment), settings, pictures)

    def show() -> Iterator[np.ndarray]:
        lit: tuple[int, dict] | None = None
        for picture in progress(range(pictures), "pictures"):
            if lit is None or not light.still or lit[0] != poses[picture]:
                pose = poses[picture]
                driver = Driver(vertices[pose], motions.get(int(numbers[pose])))
                lit = (pose, light.frame(driver, picture))
            if settings.splats == "all" or (settings.splats == "first" and picture == 0):
                write_splats(folder / f"splats/{picture:06d}.ply", splats_of(lit[1], settings.exposure))
            rgb, alpha = (tensor.cpu().numpy() for tensor in relighter.view(lit[1], path[picture]))
            yield write_stills(folder / "stills", picture, rgb, alpha, light.behind(path[picture], picture), settings)

    with written_whole(out) as folder:
        folder.mkdir()
        write_video(folder / "film.mp4", show(), settings.fps)
        write_table(folder / "pictures.parquet", picture_table(numbers[poses], path))
    log.info("%d pictures of %d poses in %s", pictures, len(numbers), out)


def read_poses(tracking: tuple[Path, ...], vertex_count: int, settings: RelightAvatar) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and posed vertices of the frames to show.

    Raises:
        InputError: if there are none.
    """
    chunks = [read_tracked(path, vertex_count) for path in tracking]
    if not chunks:
        raise InputError("--tracking: expected at least one chunk of track_mesh, found none")
    numbers = np.concatenate([chunk.frames for chunk in chunks])
    last = numbers.max() if settings.last_frame is None else settings.last_frame
    shown = (numbers >= settings.first_frame) & (numbers <= last)
    if not shown.any():
        raise InputError(
            f"expected tracked frames from {settings.first_frame} to {last}, found {listed(numbers.tolist())}; "
            "change --first-frame or --last-frame"
        )
    return numbers[shown], np.concatenate([chunk.vertices for chunk in chunks])[shown]


def motions_of_heads(tracking: tuple[Path, ...]) -> dict[int, np.ndarray]:
    """How the head moved in each frame, by which its expression is told from its turns; see `FrameRecord`."""
    return {frame: motion for path in tracking for frame, motion in head_motions(read_arrays(path)).items()}


def camera_path(
    vertices: np.ndarray, cameras: Path | None, keyframes: Path | None, settings: RelightAvatar, pictures: int
) -> list[Camera]:
    """One camera per picture: through keyframes, through calibrated cameras, or around the subject.

    Raises:
        InputError: for two paths at once, unknown cameras, or a centre that is no point.
    """
    if keyframes is not None and settings.camera_names:
        raise InputError("expected either --keyframes or --camera-names, found both; name one path")
    if keyframes is not None:
        return through_keyframes(keyframes, settings.width, settings.height, pictures)
    if settings.camera_names:
        known = read_cameras(cameras) if cameras is not None else {}
        unknown = [name for name in settings.camera_names if name not in known]
        if unknown:
            raise InputError(f"--camera-names: expected cameras of {cameras}: {listed(known)}; found {listed(unknown)}")
        return through_cameras([known[name] for name in settings.camera_names], settings.height, pictures)
    if len(settings.orbit_center) not in (0, 3):
        raise InputError(f"--orbit-center: expected three numbers, found {settings.orbit_center}")
    middle = (vertices.min((0, 1)).astype(np.float64) + vertices.max((0, 1))) / 2
    center = np.array(settings.orbit_center, np.float64) if settings.orbit_center else middle
    return orbit(
        center, settings.orbit_radius, settings.orbit_rise, settings.orbit_turns, settings.fov_y_degrees,
        settings.width, settings.height, pictures,
    )  # fmt: skip


def write_stills(
    folder: Path, picture: int, rgb: np.ndarray, alpha: np.ndarray, behind: np.ndarray, settings: RelightAvatar
) -> np.ndarray:
    """Write what `stills` asks for; returns the picture as it is shown, in sRGB of 8 bits."""
    if settings.stills in ("exr", "both"):
        planes = [*np.moveaxis(rgb, 2, 0), alpha]
        write_exr(folder / f"{picture:06d}.exr", dict(zip("RGBA", planes, strict=True)))
    shown = settings.exposure * (rgb + (1 - alpha)[..., None] * behind)
    shown = np.round(np.clip(srgb_from_linear(shown), 0, 1) * 255).astype(np.uint8)
    if settings.stills in ("png", "both"):
        write_png(folder / f"{picture:06d}.png", shown)
    return shown


def splats_of(frame: dict, exposure: float) -> Splats:
    """The frame's Gaussians with the colour that all sides share."""
    rgb = exposure * view_independent_color(frame)
    names = ("opacities", "scales", "quaternions")
    return Splats(frame["means"], frame["normals"], rgb, *(frame[name] for name in names))


def picture_table(frames: np.ndarray, path: list[Camera]) -> pd.DataFrame:
    """Picture, tracked frame, and the camera's centre in metres."""
    centers = np.stack([camera.center for camera in path])
    return pd.DataFrame({"picture": np.arange(len(path)), "frame": frames, **dict(zip("xyz", centers.T, strict=True))})


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
