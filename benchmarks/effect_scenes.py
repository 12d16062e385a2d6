"""Fifteen small scenes that call for different effects, path-traced by Mitsuba, as the files that plan_effects reads.

Cameras, lights, tracking and atlas are the truth: what differs between two avatars is what was simulated, and nothing
else.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from benchmarks.effect_files import write_stage_files
from benchmarks.effect_shapes import Shape, ball, body, bust, capped, cup, dressed, halves, links, pair, ring
from pipeline.base.exr import save_exr
from pipeline.base.seeds import generator_for, seed_for
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis import mitsuba_scenes as mitsuba
from pipeline.synthesis.lens import view_points
from pipeline.synthesis.sensor_model import SensorModel, write_8bit
from pipeline.synthesis.stage_rig import StageRig, build_stage_rig, light_patterns, segment_for
from pipeline.synthesis.subject import vertex_normals
from pipeline.synthesis.translucency import Medium, translucent_mesh

FAR_M = 40.0
"""Lights so far away that they shine within 1 % alike on a subject of 0.2 m."""

ROOM_M = 8.0
"""Lights as far off as in a hall: they change by about as much as plan_effects starts to simulate."""

BRIGHTNESS = 6.0
"""Sum of radiant intensity over squared distance: a white subject then is about half of full scale."""

IDEAL = {"distortion": 0.0, "color_spread": 0.0}
SMALL = {
    "cameras": 7, "test_cameras": 1, "lights": 16, "partial_lights_min": 3, "partial_lights_max": 6, "frames": 15,
    "frames_b": 3, "test_frames": 2, "width": 80, "height": 80, "downsample_from_sensor": 1, "spp": 16,
    "spp_fully_lit": 16, "supersampling": 2, "max_depth": 4, "camera_distance_m": 1.2, "framed_height_m": 0.4,
}  # fmt: skip

WAX = Medium(0.05, (0.98, 0.95, 0.88))
"""Light goes 5 cm between scatterings, a third of the large ball's radius: from behind it shines through."""

WAX_DEPTH = 32
"""Longest paths through wax. What longer ones would carry is missing from all pictures alike."""


@dataclass(frozen=True)
class Material:
    """What a part is made of.

    Attributes:
        gloss_alpha: width of the coat's GGX lobe; None: no coat.
        wax: a closed part that is filled with `WAX` in place of its texture.
    """

    gloss_alpha: float | None = None
    wax: bool = False


MATTE, SHINY, WAXEN = Material(), Material(0.15), Material(0.3, wax=True)


@dataclass(frozen=True)
class Scene:
    """What is photographed, of which material, and in what stage.

    Attributes:
        parts: materials of those parts that are not of `material`.
    """

    shape: Callable[[], Shape]
    material: Material
    settings: SynthesizeCapture
    parts: Mapping[str, Material] = field(default_factory=dict)

    @property
    def wax(self) -> bool:
        """Whether light enters anything."""
        return any(material.wax for material in (self.material, *self.parts.values()))


def stage(light_distance_m: float, **changes: object) -> SynthesizeCapture:
    """A small stage whose lights shine as brightly from any distance."""
    total = BRIGHTNESS * light_distance_m**2
    keys = {**SMALL, **IDEAL, "light_distance_m": light_distance_m, "total_intensity": total, **changes}
    return SynthesizeCapture(**keys)


WAX_STAGE = {"spp": 32, "spp_fully_lit": 32}
"""Paths that scatter are noisier."""

TALL = {"camera_distance_m": 2.5, "framed_height_m": 2.05}
DISTORTED = {"distortion": 1.0, "color_spread": 0.035}

SCENES = {
    "diffuse": Scene(ball, MATTE, stage(FAR_M)),
    "glossy": Scene(ball, SHINY, stage(FAR_M)),
    "bust": Scene(bust, MATTE, stage(FAR_M)),
    "body": Scene(body, Material(0.25), stage(2.2, **DISTORTED, **TALL)),
    "near": Scene(ball, MATTE, stage(1.01)),
    "halves": Scene(halves, SHINY, stage(FAR_M), {"lower": MATTE}),
    "lens": Scene(ball, MATTE, stage(FAR_M, **DISTORTED)),
    "wax": Scene(ball, WAXEN, stage(FAR_M, **WAX_STAGE, framed_height_m=0.55)),
    "pair": Scene(pair, SHINY, stage(FAR_M), {"left": MATTE}),
    "wax_pair": Scene(pair, MATTE, stage(FAR_M, **WAX_STAGE), {"left": WAXEN}),
    "capped": Scene(capped, SHINY, stage(1.5), {"cap": MATTE}),
    "dressed": Scene(dressed, Material(0.25), stage(2.2, **TALL), {"clothes": MATTE}),
    "ring": Scene(ring, WAXEN, stage(FAR_M, **WAX_STAGE)),
    "links": Scene(links, SHINY, stage(ROOM_M), {"upright": MATTE}),
    "cup": Scene(cup, Material(0.5), stage(1.5)),
}
"""By name. No threshold of plan_effects was set on shapes like the last three's."""


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
    settings, lit = scene.settings, powers > 0
    positions, intensities = rig.lights_xyz[lit], powers[lit]
    one = positions[:1], intensities[:1]
    depth = WAX_DEPTH if scene.wax else settings.max_depth
    world = mitsuba.lit_scene(part_meshes(scene, shape, vertices), *one, depth, integrator(scene))
    # Light may cross wax as if it were not there: what is covered is seen on opaque parts.
    covering = mitsuba.lit_scene(part_meshes(opaque(scene), shape, vertices), *one, 2) if scene.wax else None
    sensor = SensorModel(settings.shot_gain, settings.read_noise, settings.saturation, settings.black_level)
    for camera_name, camera in rig.cameras.items():
        view = view_points(camera, vertices, settings.supersampling)
        samples = max(1, round(settings.spp / settings.supersampling**2 / len(positions)))
        seed = seed_for(name, camera_name, frame) % 2**31
        seen = mitsuba.render_each_light(world, view, positions, intensities, samples, seed)
        if covering is not None:
            seen[..., 3] = mitsuba.render(covering, view, samples, seed)[..., 3]
        developed = view.develop(seen)
        random = generator_for(name, "sensor", camera_name, frame)
        raw = sensor.expose(developed[..., :3], rig.raw_from_true[camera_name], random)
        save_exr(folder / f"images/{camera_name}/{frame:06d}.exr", raw)
        mask = np.where(developed[..., 3] >= 0.5, 255, 0).astype(np.uint8)
        write_8bit(folder / f"masks/{camera_name}/{frame:06d}.png", mask)


def part_meshes(scene: Scene, shape: Shape, vertices: np.ndarray) -> list[Any]:
    """A Mitsuba mesh for each material of a scene."""
    cut, normals = shape.unwrapped, vertex_normals(vertices, shape.faces)
    points, turned = vertices[cut.source], normals[cut.source]
    named = np.concatenate([np.zeros(0, np.int64), *(shape.parts[part] for part in scene.parts)])
    rest = np.setdiff1d(np.arange(len(cut.faces)), named)
    meshes = []
    for material, faces in [(scene.material, rest), *((scene.parts[part], shape.parts[part]) for part in scene.parts)]:
        geometry = (points, turned, cut.faces[faces], cut.uv)
        if material.wax:
            meshes.append(translucent_mesh(WAX, material.gloss_alpha or 1.0, *geometry))
        elif material.gloss_alpha is not None:
            meshes.append(mitsuba.coated_mesh(shape.texture, material.gloss_alpha, *geometry))
        else:
            diffuse = {"type": "diffuse", "reflectance": mitsuba.bitmap_texture(shape.texture, "bilinear")}
            meshes.append(mitsuba.triangle_mesh(diffuse, points, cut.faces[faces], cut.uv, turned))
    return meshes


def opaque(scene: Scene) -> Scene:
    """The same scene without wax."""
    return replace(scene, material=MATTE, parts={})


def integrator(scene: Scene) -> Literal["path", "volpath"]:
    """Mitsuba's, by whether light enters anything."""
    return "volpath" if scene.wax else "path"
