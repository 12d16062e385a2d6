"""Show an avatar in new light.

It takes what drives the avatar, a camera path, and an environment map or point lights.

In: an avatar; tracked chunks, or of a head also latent codes, and gaze (see
`pipeline.avatar.relighting.driving_sequence`); and one light: a panorama (.hdr, .exr), which may turn, or a list of
point lights (.csv, .json), which may move. Out, in one folder: film.mp4, stills/{picture}.png and .exr,
splats/{picture}.ply (standard 3DGS files, without view-dependent parts), pictures.parquet, which says what each picture
shows, and of a head codes.csv: its latent codes, to be edited and given back as --codes.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from torch import Tensor

from pipeline.avatar.relighting.captured_panel import CapturedPanel
from pipeline.avatar.relighting.driving_sequence import DrivingSequence, read_poses
from pipeline.avatar.relighting.driving_tables import code_table
from pipeline.avatar.relighting.film import Relighter, splats_of
from pipeline.avatar.relighting.light_sources import ListedLights, TurningSky
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.color import srgb_from_linear
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError, listed
from pipeline.base.exr import write_exr
from pipeline.base.files import write_table
from pipeline.base.progress import progress
from pipeline.base.whole_files import written_folder
from pipeline.capture.images import write_png
from pipeline.capture.video import write_video
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.camera_paths import orbit, through_cameras, through_keyframes
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.lighting.changing_light import require_changing_light
from pipeline.lighting.environment import read_environment
from pipeline.lighting.light_lists import read_light_list
from pipeline.rendering.splat_ply import write_splats

log = logging.getLogger("relight_avatar")


def run(
    *,
    atlas: Path,
    avatar: Path,
    out: Path,
    tracking: tuple[Path, ...] = (),
    textures: tuple[Path, ...] = (),
    index: Path | None = None,
    estimated_gaze: Path | None = None,
    environment: Path | None = None,
    lights: Path | None = None,
    cameras: Path | None = None,
    keyframes: Path | None = None,
    shards: Path | None = None,
    settings: RelightAvatar = RelightAvatar(),
) -> None:
    """Render an avatar under new light.

    So many arguments because a command line names each file that it reads.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        avatar: folder of train_avatar.
        out: folder for film, stills and splats.
        tracking: chunks of track_mesh, in order.
        textures: of the same chunks, by bake_textures, for heads; without, those of an average frame are taken.
        index: folder of index_capture, for --segment and for the gaze that was captured; without, eyes look as tracked.
            A capture under constant light is refused.
        estimated_gaze: gaze.parquet of estimate_gaze, where the capture declares none.
        environment: panorama that lights the avatar.
        lights: point lights instead: columns light, x, y, z [m], r, g, b and, if they move, picture.
        cameras: calibration/cameras.json, for --camera-names.
        keyframes: camera path as JSON: {"keyframes": [{picture, eye, target, fov_y_degrees}, ...]}.
        shards: folder of pack_shards, for --beside-captured.
        settings: see the flags below.
    """
    if (environment is None) == (lights is None):
        raise InputError("expected either --environment or --lights, found both or neither; name one light")
    require_changing_light(index)
    relighter = Relighter(load_avatar(avatar, atlas), TraceIrradiance(samples=settings.shadow_samples))
    poses = read_poses(relighter, tracking, textures, index, settings, estimated_gaze)
    sequence = DrivingSequence(relighter, poses, settings)
    path, codes = camera_path(sequence, cameras, keyframes, settings), []
    beside = captured_panel(shards, settings)
    if settings.exr_layers and settings.stills not in ("exr", "both"):
        raise InputError(f"--exr-layers: expected --stills exr or both, found {settings.stills}")
    has_splats = not relighter.avatar.spec.volumes
    if settings.splats != "none" and not has_splats:
        log.info("no splats: the avatar's geometry is volumes")
    if environment is None:
        middle = sequence.middle() if settings.light_turns else np.zeros(3)
        light = ListedLights(relighter, read_light_list(lights), middle, settings.light_turns, sequence.pictures)
    else:
        light = TurningSky(relighter, read_environment(environment), settings, sequence.pictures)

    def show() -> Iterator[np.ndarray]:
        driven, shaded = None, None
        for picture in progress(range(sequence.pictures), "pictures"):
            signal = sequence.at(picture)
            codes.append(signal.code)
            if signal is not driven or not light.still:
                driven, shaded = signal, light.frame(signal, picture)
            if has_splats and (settings.splats == "all" or (settings.splats == "first" and picture == 0)):
                write_splats(folder / f"splats/{picture:06d}.ply", splats_of(shaded, settings.exposure))
            camera = path[picture]
            rgb, alpha = (tensor.cpu().numpy() for tensor in relighter.view(shaded, camera))
            if settings.stills in ("exr", "both"):
                layers = relighter.render_layers(shaded, camera) if settings.exr_layers else {}
                write_exr_still(folder / f"stills/{picture:06d}.exr", rgb, alpha, layers)
            shown = as_shown(rgb, alpha, light.behind(camera, picture), settings.exposure)
            if beside is not None:
                captured = beside.at(int(sequence.frames[sequence.pose_of(picture)]), camera)
                shown = np.concatenate([captured, shown], 1)
            if settings.stills in ("png", "both"):
                write_png(folder / f"stills/{picture:06d}.png", shown)
            yield shown

    with written_folder(out, "relight_avatar") as folder:
        write_video(folder / "film.mp4", show(), settings.fps)
        write_table(folder / "pictures.parquet", picture_table(sequence, path))
        if relighter.avatar.spec.head:
            write_table(folder / "codes.csv", code_table(np.stack(codes)))
    log.info("%d pictures of %d tracked frames in %s", sequence.pictures, len(sequence.frames), out)


def camera_path(
    sequence: DrivingSequence, cameras: Path | None, keyframes: Path | None, settings: RelightAvatar
) -> list[Camera]:
    """One camera per picture: through keyframes or calibrated cameras, or around the subject.

    Raises:
        InputError: for two paths at once, unknown cameras, or a centre that is no point.
    """
    if keyframes is not None and settings.camera_names:
        raise InputError("expected either --keyframes or --camera-names, found both; name one path")
    if keyframes is not None:
        return through_keyframes(keyframes, settings.width, settings.height, sequence.pictures)
    if settings.camera_names:
        known = read_cameras(cameras) if cameras is not None else {}
        unknown = [name for name in settings.camera_names if name not in known]
        if unknown:
            raise InputError(f"--camera-names: expected cameras of {cameras}: {listed(known)}; found {listed(unknown)}")
        return through_cameras([known[name] for name in settings.camera_names], settings.height, sequence.pictures)
    if len(settings.orbit_center) not in (0, 3):
        raise InputError(f"--orbit-center: expected three numbers, found {settings.orbit_center}")
    center = np.array(settings.orbit_center, np.float64) if settings.orbit_center else sequence.middle()
    return orbit(
        center, settings.orbit_radius, settings.orbit_rise, settings.orbit_turns, settings.fov_y_degrees,
        settings.width, settings.height, sequence.pictures,
    )  # fmt: skip


def captured_panel(shards: Path | None, settings: RelightAvatar) -> CapturedPanel | None:
    """Captured pictures, if they are asked for.

    Raises:
        InputError: without shards, without tracked frames, or unless one camera stands where it stood.
    """
    if not settings.beside_captured:
        return None
    if shards is None or len(settings.camera_names) != 1:
        found = f"--camera-names {' '.join(settings.camera_names) or '(none)'}, --shards {shards}"
        raise InputError(f"--beside-captured: expected one of --camera-names, and --shards, found {found}")
    return CapturedPanel(shards, settings.camera_names[0])


def write_exr_still(path: Path, rgb: np.ndarray, alpha: np.ndarray, layers: Mapping[str, Tensor]) -> None:
    """Write linear light over black, A, and layers."""
    planes = dict(zip("RGBA", [*np.moveaxis(rgb, 2, 0), alpha], strict=True))
    write_exr(path, planes | {name: layer.cpu().numpy() for name, layer in layers.items()})


def as_shown(rgb: np.ndarray, alpha: np.ndarray, behind: np.ndarray, exposure: float) -> np.ndarray:
    """The picture before what is behind it, in sRGB of 8 bits."""
    shown = exposure * (rgb + (1 - alpha)[..., None] * behind)
    return np.round(np.clip(srgb_from_linear(shown), 0, 1) * 255).astype(np.uint8)


def picture_table(sequence: DrivingSequence, path: list[Camera]) -> pd.DataFrame:
    """Picture, its tracked frame if there are any, and the camera's centre in metres."""
    shown = [sequence.pose_of(picture) for picture in range(sequence.pictures)]
    frames = {"frame": sequence.frames[shown]} if len(sequence.frames) else {}
    centers = np.stack([camera.center for camera in path])
    return pd.DataFrame({"picture": np.arange(len(path)), **frames, **dict(zip("xyz", centers.T, strict=True))})


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
