"""Cameras and lights of the stage as USD, text. Metres, y up.

Principal points are aperture offsets. USD itself has no distortion: it stands in the attributes of NVIDIA's schemas
OmniLensDistortionOpenCvPinholeAPI and OmniLensDistortionOpenCvFisheyeAPI (docs.omniverse.nvidia.com,
omni.usd.schema.omni_lens_distortion), which everything but Omniverse leaves alone.

A light is a sphere seen as a point: USD divides its intensity by the sphere's area, 4 pi r^2, and a sphere of radiance
L sends L pi r^2 into each direction, so the radiant intensity times four is written.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.files import written_whole
from pipeline.export.stage_gltf import FAR_M, NEAR_M, split_intensity, world_from_gl_camera
from pipeline.geometry.cameras import Camera
from pipeline.lighting.named_lights import NamedLights

APERTURE = 0.36
"""Width of a picture on the film, 36 mm: USD counts tenths of the scene's unit, here tenths of a metre."""

DISTORTION = {
    "brown_conrady": ("OmniLensDistortionOpenCvPinholeAPI", "opencvPinhole"),
    "fisheye": ("OmniLensDistortionOpenCvFisheyeAPI", "opencvFisheye"),
}
"""Schema, and word in its attributes, of a lens: these are OpenCV's two, with its equations and names of terms."""

AREA_OVER_DISC = 4.0
"""A sphere's area over that of the disc that it shows."""


def require_usd() -> Any:
    """The package pxr.

    Raises:
        InputError: if it is not installed.
    """
    try:
        import pxr
    except ImportError as error:
        raise InputError(
            "--formats: usd: expected the package usd-core, found none; pip install usd-core, or leave usd out"
        ) from error
    return pxr


def write_stage_usd(path: Path, cameras: Mapping[str, Camera], lights: NamedLights) -> None:
    """Write a .usda with a prim for each camera and light, their own names as display names.

    Raises:
        InputError: if usd-core is not installed.
    """
    require_usd()
    from pxr import Gf, Tf, Usd, UsdGeom, UsdLux

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.LinearUnits.meters)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/stage").GetPrim())
    for group in ("cameras", "lights"):
        UsdGeom.Scope.Define(stage, f"/stage/{group}")
    for (name, camera), word in zip(cameras.items(), unique_words(map(Tf.MakeValidIdentifier, cameras)), strict=True):
        prim = UsdGeom.Camera.Define(stage, f"/stage/cameras/{word}")
        prim.GetPrim().SetDisplayName(name)
        placed = np.eye(4)
        placed[:3, :3], placed[3, :3] = world_from_gl_camera(camera).T, camera.center  # USD's vectors are rows
        prim.AddTransformOp().Set(Gf.Matrix4d(*placed.ravel().tolist()))
        for attribute, value in lens_attributes(camera).items():
            prim.GetPrim().GetAttribute(attribute).Set(value)
        prim.CreateClippingRangeAttr(Gf.Vec2f(NEAR_M, FAR_M))
        add_distortion(prim.GetPrim(), camera)
    words = unique_words(map(Tf.MakeValidIdentifier, lights.names))
    for name, word, position, rgb in zip(lights.names, words, lights.positions, lights.intensities, strict=True):
        strength, color = split_intensity(rgb)
        light = UsdLux.SphereLight.Define(stage, f"/stage/lights/{word}")
        light.GetPrim().SetDisplayName(name)
        light.AddTranslateOp().Set(Gf.Vec3d(*position.tolist()))
        light.CreateIntensityAttr(AREA_OVER_DISC * strength)
        light.CreateColorAttr(Gf.Vec3f(*color.tolist()))
        light.CreateNormalizeAttr(True)
        light.CreateTreatAsPointAttr(True)
    with written_whole(path) as temporary:
        temporary.write_text(stage.GetRootLayer().ExportToString(), "utf-8")


def lens_attributes(camera: Camera) -> dict[str, float]:
    """Focal length, apertures and their offsets: the frustum's edges are those of the picture."""
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    focal = APERTURE * fx / camera.width
    return {
        "focalLength": focal, "horizontalAperture": APERTURE, "verticalAperture": focal * camera.height / fy,
        "horizontalApertureOffset": focal * (camera.width / 2 - cx) / fx,
        "verticalApertureOffset": focal * (cy - camera.height / 2) / fy,
    }  # fmt: skip


def add_distortion(prim: Any, camera: Camera) -> None:
    """Add the lens to a camera's prim.

    Its model, intrinsics in pixels counted from the corner, and coefficients.
    """
    from pxr import Gf, Sdf

    schema, word = DISTORTION[camera.lens.name]
    prim.AddAppliedSchema(schema)
    types, prefix = Sdf.ValueTypeNames, "omni:lensdistortion"
    prim.CreateAttribute(f"{prefix}:model", types.Token, False, Sdf.VariabilityUniform).Set(word)
    size = prim.CreateAttribute(f"{prefix}:{word}:imageSize", types.Int2, False)
    size.Set(Gf.Vec2i(camera.width, camera.height))
    (fx, _, cx), (_, fy, cy), _ = camera.K.tolist()
    numbers = {"fx": fx, "fy": fy, "cx": cx, "cy": cy} | dict(zip(camera.lens.terms, camera.dist.tolist(), strict=True))
    for name, value in numbers.items():
        prim.CreateAttribute(f"{prefix}:{word}:{name}", types.Float, False).Set(value)


def unique_words(words: Iterable[str]) -> list[str]:
    """Words, a number behind each that was there before."""
    found: list[str] = []
    for word in words:
        count = 1
        unique = word
        while unique in found:
            count += 1
            unique = f"{word}_{count}"
        found.append(unique)
    return found
