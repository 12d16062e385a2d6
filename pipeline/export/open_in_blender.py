"""Open the files of export_avatar in Blender: animated mesh, textures, cameras, lights.

    blender --python open_in_blender.py

in the folder of the export, or with `-- FOLDER` behind it. Needs Blender 4.2 or later, and nothing of this project.
The scene is Cycles', black around the subject, its film as long as the capture. Blender turns y up into its own z up.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import bpy

MESH, STAGE = "mesh.glb", "stage.glb"

SPHERE = 4 * math.pi
"""Blender's power of a lamp over its radiant intensity; as it reads raw numbers, it takes these for powers."""


def chosen_folder() -> Path:
    """The folder behind `--`, or that of this file."""
    behind = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else []
    return Path(behind[0]) if behind else Path(__file__).parent


def imported(path: Path) -> list[bpy.types.Object]:
    """Objects that a glTF file adds to the scene."""
    before = set(bpy.data.objects)
    bpy.ops.import_scene.gltf(filepath=str(path), export_import_convert_lighting_mode="RAW")
    return [found for found in bpy.data.objects if found not in before]


def look_through(cameras: list[bpy.types.Object]) -> None:
    """Make pictures as the first camera does: its shape, and its principal point off the middle."""
    scene, camera = bpy.context.scene, cameras[0]
    scene.camera = camera
    for each in cameras:
        lens = each.data
        K, width, height = (lens[key] for key in ("K", "width", "height"))
        longer = max(width, height)
        lens.shift_x, lens.shift_y = (width / 2 - K[0][2]) / longer, (K[1][2] - height / 2) / longer
    scene.render.resolution_x, scene.render.resolution_y = camera.data["width"], camera.data["height"]


def main() -> None:
    """Fill an empty scene."""
    folder = chosen_folder()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.world = bpy.data.worlds.new("black")
    scene.world.color = (0, 0, 0)
    scene.view_settings.view_transform = "Standard"
    if (folder / MESH).is_file():
        imported(folder / MESH)
    if (folder / STAGE).is_file():
        found = imported(folder / STAGE)
        for light in (each for each in found if each.type == "LIGHT"):
            light.data.energy *= SPHERE
        if cameras := [each for each in found if each.type == "CAMERA"]:
            look_through(cameras)
    ends = [action.frame_range[1] for action in bpy.data.actions]
    scene.frame_end = round(max(ends, default=1))


if __name__ == "__main__":
    main()
