"""Write an avatar as files that other programs open.

In: an avatar, the frames it was trained and scored on, cameras and lights. Out, in one folder: splats/{frame}.ply,
.spz, .sog and .glb, Gaussians in the frame's own light, without what changes with the view; mesh.glb, the posed surface
with its textures, animated over the frames, by the template's joints if it has any; stage.glb and stage.usda, cameras
and lights; open_in_blender.py, which opens these. `docs/export.md` says what each holds, and what it cannot hold.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial
from importlib.resources import files
from pathlib import Path

import torch

from pipeline.avatar.frames.prepared import PreparedFrame
from pipeline.avatar.matter import read_matter
from pipeline.avatar.relighting.film import splats_of
from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.base.progress import progress
from pipeline.base.spread import spread
from pipeline.base.whole_files import written_folder
from pipeline.capture.records import FrameRecord
from pipeline.capture.shards import read_frame_shards
from pipeline.config.export_avatar import ExportAvatar
from pipeline.export.atlas_textures import material_textures
from pipeline.export.gaussian_gltf import write_gaussian_glb
from pipeline.export.posed_mesh import write_posed_mesh
from pipeline.export.rigged_motion import read_rigged_motion
from pipeline.export.skinned_mesh import write_skinned_mesh
from pipeline.export.sog import write_sog
from pipeline.export.spz import write_spz
from pipeline.export.stage_gltf import write_stage_glb
from pipeline.export.stage_usd import require_usd, write_stage_usd
from pipeline.geometry.cameras import read_cameras
from pipeline.lighting.named_lights import read_named_lights
from pipeline.rendering.splat_ply import Splats, write_splats

log = logging.getLogger("export_avatar")

BLENDER_SCRIPT = "open_in_blender.py"


def splat_writers(settings: ExportAvatar) -> dict[str, Callable[[Path, Splats], None]]:
    """Writers of Gaussians, by the end of the file's name, of the formats that are asked for."""
    spz = partial(write_spz, version=settings.spz_version)
    known = {"ply": write_splats, "spz": spz, "sog": write_sog, "glb": write_gaussian_glb}
    return {name: write for name, write in known.items() if name in settings.formats}


def run(
    *,
    atlas: Path,
    avatar: Path,
    shards: Path,
    index: Path,
    cameras: Path,
    lights: Path,
    patterns: Path,
    out: Path,
    frames: Path | None = None,
    capture: Path | None = None,
    tracking: tuple[Path, ...] = (),
    settings: ExportAvatar = ExportAvatar(),
) -> None:
    """Write the files.

    So many arguments because a command line names each file that it reads.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        avatar: folder of train_avatar.
        shards: folder with frames/ of pack_shards.
        index: folder of index_capture, for the frames per second.
        cameras: calibration/cameras.json.
        lights: calibration/lights.parquet.
        patterns: patterns.parquet of book_patterns.
        out: folder to write.
        frames: folder of frame shards, if they are not those in SHARDS/frames.
        capture: folder of the capture, for the joints of its template; without, the mesh moves by morph targets.
        tracking: chunks of track_mesh, in order, for the poses of these joints.
        settings: see the flags below.
    """
    if "usd" in settings.formats:
        require_usd()
    loaded, records = load_avatar(avatar, atlas), read_frame_shards([frames or shards / "frames"])
    splats = sorted(splat_writers(settings))
    if splats and loaded.avatar.spec.volumes:
        raise InputError(
            f"{avatar}/config.json: spec: geometry: expected gaussians for {', '.join(splats)}, found volumes; export "
            "another variant, or set export_avatar.formats to mesh, stage and usd"
        )
    if not len(records):
        raise InputError(f"{shards}/frames: expected at least one frame, found none; run pack_shards again")
    numbers, fps = sorted(records), float(read_json(index / "capture.json")["fps"])
    animated = spread(numbers, settings.animation_frames)
    known, named = read_cameras(cameras), read_named_lights(lights, patterns)
    with written_folder(out, "export_avatar") as folder:
        for number in progress(spread(numbers, settings.splat_frames) if splats else [], "frames"):
            shown = splats_of(prepared(loaded, records[number]), settings.exposure)
            for name, write in splat_writers(settings).items():
                write(folder / f"splats/{number:06d}.{name}", shown)
        if "mesh" in settings.formats:
            surface = prepared(loaded, records[numbers[0]]).surface
            axes, normals = (tensor.cpu().numpy() for tensor in (surface.posed.tangent_frames, surface.bent_normals))
            textures = material_textures(loaded.atlas, read_matter(loaded.avatar), axes, normals)
            rigged = settings.animation == "auto" and capture is not None and tracking
            motion = read_rigged_motion(capture, index, tracking, animated) if rigged else None
            if motion is not None:
                write_skinned_mesh(folder / "mesh.glb", loaded.atlas, textures, motion, fps)
            else:
                poses = {number: records[number].vertices for number in animated}
                write_posed_mesh(folder / "mesh.glb", loaded.atlas, textures, poses, fps)
        if "stage" in settings.formats:
            write_stage_glb(folder / "stage.glb", known, named)
        if "usd" in settings.formats:
            write_stage_usd(folder / "stage.usda", known, named)
        script = files("pipeline.export").joinpath(BLENDER_SCRIPT).read_text("utf-8")
        (folder / BLENDER_SCRIPT).write_text(script, "utf-8")
    log.info("%d Gaussians, %d of %d frames animated", loaded.atlas.texel_count, len(animated), len(numbers))


@torch.no_grad()
def prepared(loaded: LoadedAvatar, record: FrameRecord) -> PreparedFrame:
    """A frame in its own light."""
    return loaded.avatar.prepare(loaded.inputs(record))


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
