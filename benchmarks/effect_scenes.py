"""Six small scenes that call for different effects, path-traced by Mitsuba, as the files that plan_effects reads.

Cameras, lights, tracking and atlas are the truth: what differs between two avatars is what was simulated, and nothing
else. A scene takes seconds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.base.exr import save_exr
from pipeline.base.files import write_arrays, write_json, write_table
from pipeline.base.seeds import generator_for, seed_for
from pipeline.base.splits import VALIDATION_FLAGS
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.atlas import sampled_atlas
from pipeline.geometry.cameras import write_cameras
from pipeline.geometry.texels import Atlas, write_atlas
from pipeline.synthesis import mitsuba_scenes as mitsuba
from pipeline.synthesis.appearance import Unwrapped, bake, mottle, unwrap
from pipeline.synthesis.capture_files import held_out
from pipeline.synthesis.figure import build_figure
from pipeline.synthesis.head_shape import head_mesh
from pipeline.synthesis.lens import view_points
from pipeline.synthesis.sensor_model import SensorModel, write_8bit
from pipeline.synthesis.stage_rig import StageRig, build_stage_rig, light_patterns, segment_for
from pipeline.synthesis.subject import vertex_normals

FAR_M = 40.0
"""Lights so far away that they shine within 1 % alike on a subject of 0.2 m."""

BRIGHTNESS = 6.0
"""Sum of radiant intensity over squared distance: a white subject then is about half of full scale."""

TEXTURE_SIZE = 128
BALL_RADIUS_M = 0.15

IDEAL = {"distortion": 0.0, "color_spread": 0.0}
SMALL = {
    "cameras": 7, "test_cameras": 1, "lights": 16, "partial_lights_min": 3, "partial_lights_max": 6, "frames": 15,
    "frames_b": 3, "test_frames": 2, "width": 80, "height": 80, "downsample_from_sensor": 1, "spp": 16,
    "spp_fully_lit": 16, "supersampling": 2, "max_depth": 4, "camera_distance_m": 1.2, "framed_height_m": 0.4,
}  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """A mesh, its texture, and its vertices (and local joint rotations, if it has joints) over time.

    Attributes:
        matte: faces that have no gloss, whatever the others have; the template names them.
    """

    faces: np.ndarray
    unwrapped: Unwrapped
    texture: np.ndarray
    at: Callable[[float, str], tuple[np.ndarray, np.ndarray | None]]
    matte: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))


@dataclass(frozen=True)
class Scene:
    """What is photographed, how wide the lobe of its gloss is (None: matte), and in what stage."""

    shape: Callable[[], Shape]
    gloss_alpha: float | None
    settings: SynthesizeCapture


def turning(name: str, vertices: np.ndarray, faces: np.ndarray) -> Shape:
    """A rigid thing that turns and shifts as a whole, of mottled colour."""
    unwrapped = unwrap(vertices, faces, TEXTURE_SIZE)

    def albedo(corners: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        points = np.einsum("kc,kcd->kd", barycentric, vertices[corners])
        return (np.array([0.55, 0.4, 0.3]) * mottle(points, name, 0.06, 0.16)[:, None]).clip(0.02, 0.9)

    def at(time_s: float, segment: str) -> tuple[np.ndarray, None]:
        turn = Rotation.from_euler("yx", [40 * np.sin(2 * time_s + (segment == "b")), 10 * np.cos(3 * time_s)], True)
        return turn.apply(vertices) + np.array([0.01 * np.sin(time_s), 0, 0]), None

    return Shape(faces, unwrapped, bake(unwrapped, TEXTURE_SIZE, albedo), at)


def ball() -> Shape:
    """A sphere."""
    sphere = trimesh.creation.icosphere(3, BALL_RADIUS_M)
    return turning("ball", np.array(sphere.vertices), np.array(sphere.faces, np.int64))


def halves() -> Shape:
    """A sphere whose lower half has no gloss."""
    whole = ball()
    middles = whole.at(0.0, "a")[0][whole.faces].mean(1)
    return replace(whole, matte=np.flatnonzero(middles[:, 1] < 0))


def bust() -> Shape:
    """The procedural head's skin, which keeps its face."""
    return turning("bust", *head_mesh(0.012))


def body() -> Shape:
    """The procedural figure, which walks."""
    figure = build_figure("body", 0.06, 256, 0.25)

    def at(time_s: float, segment: str) -> tuple[np.ndarray, np.ndarray]:
        moment = figure.at(time_s, segment)
        return moment.vertices, moment.truth["joint_rotations"]

    return Shape(figure.faces, figure.unwrapped, figure.texture, at)


def stage(light_distance_m: float, **changes: object) -> SynthesizeCapture:
    """A small stage whose lights shine as brightly from any distance."""
    total = BRIGHTNESS * light_distance_m**2
    keys = {**SMALL, **IDEAL, "light_distance_m": light_distance_m, "total_intensity": total, **changes}
    return SynthesizeCapture(**keys)


SCENES = {
    "diffuse": Scene(ball, None, stage(FAR_M)),
    "glossy": Scene(ball, 0.15, stage(FAR_M)),
    "bust": Scene(bust, None, stage(FAR_M)),
    "body": Scene(
        body, 0.25, stage(2.2, distortion=1.0, color_spread=0.035, camera_distance_m=2.5, framed_height_m=2.05)
    ),
    "near": Scene(ball, None, stage(1.01)),
    "halves": Scene(halves, 0.15, stage(FAR_M)),
}
"""By name."""


def make_scene(
    folder: Path, name: str, atlas_size: int = 48, draw: str = "", **changes: object
) -> dict[str, Path]:  # fmt: skip
    """Photograph a scene and write what the stages before plan_effects would.

    Args:
        folder: everything goes there.
        name: of `SCENES`.
        atlas_size: texels per side of the map.
        draw: another one draws other cameras, lights, patterns and noise: images that no setting was chosen by.
        changes: to the settings of its stage.

    Returns:
        The files by the name of what they are.
    """
    settings = SynthesizeCapture(**{**SCENES[name].settings.model_dump(), **changes})
    scene = replace(SCENES[name], settings=settings)
    shape, drawn = scene.shape(), name + draw
    rig = build_stage_rig(drawn, settings)
    patterns = light_patterns(drawn, rig, settings)
    powers = patterns.pivot(index="frame", columns="light", values="intensity").fillna(0.0)
    powers = powers.reindex(columns=list(rig.light_positions), fill_value=0.0).to_numpy()
    moments = [
        shape.at(time_s, segment) for segment, time_s in (segment_for(f, settings) for f in range(settings.frames))
    ]
    for frame, (vertices, _) in enumerate(moments):
        photograph(folder, drawn, scene, shape, rig, frame, vertices, powers[frame])
    return write_stage_files(folder, drawn, shape, rig, patterns, moments, settings, atlas_size)


def photograph(
    folder: Path, name: str, scene: Scene, shape: Shape, rig: StageRig, frame: int, vertices: np.ndarray,
    powers: np.ndarray,
) -> None:  # fmt: skip
    """All cameras' images and masks of a frame."""
    settings, cut = scene.settings, shape.unwrapped
    normals = vertex_normals(vertices, shape.faces)
    points, turned, everywhere = vertices[cut.source], normals[cut.source], np.arange(len(cut.faces))
    matte = everywhere if scene.gloss_alpha is None else shape.matte
    meshes, shiny = [], np.setdiff1d(everywhere, matte)
    if len(matte):
        diffuse = {"type": "diffuse", "reflectance": mitsuba.bitmap_texture(shape.texture, "bilinear")}
        meshes.append(mitsuba.triangle_mesh(diffuse, points, cut.faces[matte], cut.uv, turned))
    if len(shiny):
        meshes.append(
            mitsuba.coated_mesh(shape.texture, scene.gloss_alpha, points, turned, cut.faces[shiny], cut.uv)
        )  # fmt: skip
    lit = powers > 0
    world = mitsuba.lit_scene(meshes, rig.lights_xyz[lit], powers[lit], settings.max_depth)
    sensor = SensorModel(settings.shot_gain, settings.read_noise, settings.saturation, settings.black_level)
    for camera_name, camera in rig.cameras.items():
        view = view_points(camera, vertices, settings.supersampling)
        samples = max(1, round(settings.spp / settings.supersampling**2))
        developed = view.develop(mitsuba.render(world, view, samples, seed_for(name, camera_name, frame) % 2**31))
        random = generator_for(name, "sensor", camera_name, frame)
        raw = sensor.expose(developed[..., :3], rig.raw_from_true[camera_name], random)
        save_exr(folder / f"images/{camera_name}/{frame:06d}.exr", raw)
        mask = np.where(developed[..., 3] >= 0.5, 255, 0).astype(np.uint8)
        write_8bit(folder / f"masks/{camera_name}/{frame:06d}.png", mask)


def write_stage_files(
    folder: Path, name: str, shape: Shape, rig: StageRig, patterns: pd.DataFrame, moments: list, settings:
    SynthesizeCapture, atlas_size: int,
) -> dict[str, Path]:  # fmt: skip
    """The index, the calibration, the books, the tracking and the atlas, all of them true."""
    calibration, splits = folder / "calibration", held_out(rig, settings)
    write_json(
        folder / "index/capture.json",
        {
            "subject": name, "kind": "body",
            "images": {"transfer": "linear", "black_level": 0.0, "downsample_from_sensor": 1},
        },
    )  # fmt: skip
    write_table(folder / "index/gaze.parquet", pd.DataFrame(columns=["frame", "eye", "x", "y", "z"]))
    rows = pd.DataFrame([(c, f) for c in rig.cameras for f in range(settings.frames)], columns=["camera", "frame"])
    at = [f"{row.camera}/{row.frame:06d}" for row in rows.itertuples()]
    segments = [segment_for(frame, settings)[0] for frame in range(settings.frames)]
    held = {
        "test_camera": rows.camera.isin(splits["test_cameras"]), "test_frame": rows.frame.isin(splits["test_frames"]),
        "test_segment": rows.frame.map(dict(enumerate(segments))).isin(splits["test_segments"]), "test_pattern": False,
    }  # fmt: skip
    paths = {"path": [f"images/{x}.exr" for x in at], "mask_path": [f"masks/{x}.png" for x in at]}
    held |= dict.fromkeys(VALIDATION_FLAGS, False)
    write_table(folder / "index/images.parquet", rows.assign(**paths, **held))
    lit = patterns.groupby("frame").light.count()
    booked = pd.DataFrame({"frame": lit.index, "segment": segments, "fully_lit": lit.to_numpy() == settings.lights})
    write_table(folder / "index/frames.parquet", booked[["frame", "segment"]])
    test = booked.frame.isin(splits["test_frames"]) | booked.segment.isin(splits["test_segments"])
    split = np.where(test, "test_frames", "train")
    write_table(folder / "frames.parquet", booked.assign(test_pattern=False, validation=False, split=split))
    channels = {f"intensity_{c}": patterns.intensity for c in "rgb"}
    write_table(folder / "patterns.parquet", patterns.assign(**channels))
    write_cameras(calibration / "cameras.json", rig.cameras)
    inverse = {camera: np.linalg.inv(matrix).tolist() for camera, matrix in rig.raw_from_true.items()}
    write_json(calibration / "color.json", {"cameras": inverse})
    lights = pd.DataFrame(rig.lights_xyz, columns=["x", "y", "z"])
    write_table(calibration / "lights.parquet", lights.assign(light=list(rig.light_positions)))
    vertices = np.stack([moment[0][shape.unwrapped.source] for moment in moments]).astype(np.float32)
    tracked = {"frames": np.arange(len(moments)), "vertices": vertices}
    if moments[0][1] is not None:
        tracked["joint_rotations"] = np.stack([moment[1] for moment in moments]).astype(np.float32)
    write_arrays(folder / "tracking/0000.safetensors", tracked)
    regions = {"matte": np.unique(shape.unwrapped.faces[shape.matte])} if len(shape.matte) else {}
    atlas = replace(make_atlas(shape.unwrapped, vertices[0], atlas_size), regions=regions)
    write_atlas(folder / "atlas.safetensors", atlas)
    return {
        "capture": folder, "index": folder / "index", "atlas": folder / "atlas.safetensors",
        "tracking": folder / "tracking/0000.safetensors", "patterns": folder / "patterns.parquet",
        "frames": folder / "frames.parquet", "lights": calibration / "lights.parquet",
        "cameras": calibration / "cameras.json", "color": calibration / "color.json",
    }  # fmt: skip


def make_atlas(unwrapped: Unwrapped, rest: np.ndarray, size: int) -> Atlas:
    """The charts of the texture, on a smaller map."""
    uv = unwrapped.uv[unwrapped.faces].astype(np.float32)
    first = {vertex: index for index, vertex in reversed(list(enumerate(unwrapped.source.tolist())))}
    weld = np.array([first[vertex] for vertex in unwrapped.source.tolist()], np.int32)
    return sampled_atlas(rest, unwrapped.faces, uv, weld, size)
