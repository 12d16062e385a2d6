"""Cameras and lights in glTF and USD: what independent readers find projects and shines as what was written."""

from __future__ import annotations

import builtins

import cv2
import numpy as np
import pandas as pd
import pygltflib
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import InputError
from pipeline.export.stage_gltf import write_stage_glb
from pipeline.export.stage_usd import DISTORTION, unique_words, write_stage_usd
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES
from pipeline.lighting.named_lights import NamedLights

POINTS = np.random.default_rng(8).uniform(-0.4, 0.4, (20, 3)) + np.array([0.0, 1, 0])

TERMS = {"brown_conrady": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4")}
"""In the order in which OpenCV takes them."""


@pytest.fixture(scope="module")
def cameras():
    """Two upright cameras, the first with its principal point off the middle, the second with a fisheye."""
    found, bent = {}, [(-0.31, 0.12, 1e-3, -2e-3, -0.02), (-0.02, 0.004, -1e-3, 2e-4)]
    for k, (name, lens) in enumerate((("cam-0", BROWN_CONRADY), ("cam 0", FISHEYE))):
        R = Rotation.from_euler("YXZ", [30 + 70 * k, -10, 180], degrees=True).as_matrix().T
        K = np.array([[700.0, 0, 320 + 60 * (k == 0)], [0, 650, 240 - 30 * (k == 0)], [0, 0, 1]])
        center = np.array([0, 1, 0]) - 3 * R[2]
        found[name] = Camera(R, -R @ center, K, np.array(bent[k]), 640, 480, lens)
    return found


@pytest.fixture(scope="module")
def lights():
    positions = np.array([[0.0, 2, 3], [-1, 1, -2]])
    return NamedLights(["L 0", "L_0"], positions, np.array([[4.0, 2, 1], [0, 0, 0]]), pd.DataFrame())


def straight(camera):
    """The same camera with a lens that bends nothing: all that glTF and USD can say themselves."""
    return Camera(camera.R, camera.t, camera.K, BROWN_CONRADY.no_distortion(), camera.width, camera.height)


def bent_by_opencv(camera, model, K, coefficients):
    """Pixels by OpenCV itself. It counts from a pixel's middle, but whatever K counts from, the pixels do, too."""
    inside = (POINTS @ camera.R.T + camera.t)[:, None]
    project = cv2.fisheye.projectPoints if model == "fisheye" else cv2.projectPoints
    pixels, _ = project(inside, np.zeros(3), np.zeros(3), np.array(K), np.array(coefficients))
    return pixels[:, 0]


def test_distortion_stands_in_gltf_extras(cameras, lights, tmp_path):
    write_stage_glb(tmp_path / "stage.glb", cameras, lights)
    for lens, camera in zip(pygltflib.GLTF2().load(str(tmp_path / "stage.glb")).cameras, cameras.values(), strict=True):
        kept = lens.extras
        coefficients = [kept["distortion"][term] for term in TERMS[kept["lens"]]]
        found = bent_by_opencv(camera, kept["lens"], kept["K"], coefficients)
        np.testing.assert_allclose(found, camera.project(POINTS)[0], atol=1e-6)
        assert np.abs(found - straight(camera).project(POINTS)[0]).max() > 0.5  # pixels: it matters here
        assert (kept["width"], kept["height"]) == (640, 480)


def test_distortion_stands_in_usd_attributes(cameras, lights, tmp_path):
    """By the names of NVIDIA's schemas; float32, as they are: a coefficient of 0.3 is good to 1e-5 pixel here."""
    pytest.importorskip("pxr", reason="the Python package usd-core is not installed")
    from pxr import Usd, UsdGeom

    write_stage_usd(tmp_path / "stage.usda", cameras, lights)
    stage = Usd.Stage.Open(str(tmp_path / "stage.usda"))
    prims = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    for prim, camera in zip(prims, cameras.values(), strict=True):
        word = prim.GetAttribute("omni:lensdistortion:model").Get()
        schema = {"opencvPinhole": "OmniLensDistortionOpenCvPinholeAPI"}.get(word, "OmniLensDistortionOpenCvFisheyeAPI")
        assert prim.GetMetadata("apiSchemas").GetAppliedItems() == [schema]
        read = lambda name: prim.GetAttribute(f"omni:lensdistortion:{word}:{name}").Get()  # noqa: B023, E731
        K = [[read("fx"), 0, read("cx")], [0, read("fy"), read("cy")], [0, 0, 1]]
        lens = {"opencvPinhole": "brown_conrady", "opencvFisheye": "fisheye"}[word]
        found = bent_by_opencv(camera, lens, K, [read(term) for term in TERMS[lens]])
        np.testing.assert_allclose(found, camera.project(POINTS)[0], atol=1e-3)
        assert tuple(read("imageSize")) == (640, 480)


def test_every_lens_has_a_schema_of_usd():
    assert set(DISTORTION) == set(LENSES)


def test_usd_cameras_project_as_the_calibrated_ones(cameras, lights, tmp_path):
    pytest.importorskip("pxr", reason="the Python package usd-core is not installed")
    from pxr import Gf, Usd, UsdGeom, UsdLux

    write_stage_usd(tmp_path / "stage.usda", cameras, lights)
    stage = Usd.Stage.Open(str(tmp_path / "stage.usda"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    prims = [UsdGeom.Camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    assert [prim.GetPrim().GetDisplayName() for prim in prims] == list(cameras)
    for prim, camera in zip(prims, cameras.values(), strict=True):
        frustum = prim.GetCamera(Usd.TimeCode.Default()).frustum
        seen = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        shown = np.array([seen.Transform(Gf.Vec3d(*point)) for point in POINTS.tolist()])
        pixels = (np.array([1, -1]) * shown[:, :2] + 1) / 2 * [camera.width, camera.height]
        np.testing.assert_allclose(pixels, straight(camera).project(POINTS)[0], atol=1e-3)
    lamps = [UsdLux.SphereLight(prim) for prim in stage.Traverse() if prim.IsA(UsdLux.SphereLight)]
    for lamp, position, rgb in zip(lamps, lights.positions, lights.intensities, strict=True):
        placed = UsdGeom.Xformable(lamp).ComputeLocalToWorldTransform(0).ExtractTranslation()
        np.testing.assert_allclose(placed, position)
        # A sphere of radiance L shows a disc of pi r^2; normalised, L is the intensity over 4 pi r^2.
        radius = lamp.GetRadiusAttr().Get()
        radiance = lamp.GetIntensityAttr().Get() * np.array(lamp.GetColorAttr().Get()) / (4 * np.pi * radius**2)
        assert lamp.GetNormalizeAttr().Get()
        np.testing.assert_allclose(radiance * np.pi * radius**2, rgb, rtol=1e-5)


def test_gltf_cameras_and_lights(cameras, lights, tmp_path):
    write_stage_glb(tmp_path / "stage.glb", cameras, lights)
    document = pygltflib.GLTF2().load(str(tmp_path / "stage.glb"))
    nodes = {node.name: node for node in document.nodes if node.camera is not None}
    assert list(nodes) == list(cameras)
    for name, camera in cameras.items():
        node, lens = nodes[name], document.cameras[nodes[name].camera]
        world_from_camera = Rotation.from_quat(node.rotation).as_matrix()
        x, y, z = ((POINTS - node.translation) @ world_from_camera).T
        # Section 3.10 of glTF: the picture's half height over the distance is the tangent of half of yfov.
        height = np.tan(lens.perspective.yfov / 2)
        shown = np.stack([x / -z / (height * lens.perspective.aspectRatio), y / -z / height], 1)
        pixels = (np.array([1, -1]) * shown + 1) / 2 * [camera.width, camera.height]
        K = np.array(lens.extras["K"])
        pixels = pixels + K[:2, 2] - [camera.width / 2, camera.height / 2]  # which glTF cannot say
        aspect = K[0, 0] / K[1, 1]  # nor that pixels are no squares
        pixels[:, 0] = K[0, 2] + (pixels[:, 0] - K[0, 2]) * aspect
        np.testing.assert_allclose(pixels, straight(camera).project(POINTS)[0], atol=1e-6)
    described = document.extensions["KHR_lights_punctual"]["lights"]
    placed = [node for node in document.nodes if node.camera is None]
    for node, position, rgb in zip(placed, lights.positions, lights.intensities, strict=True):
        light = described[node.extensions["KHR_lights_punctual"]["light"]]
        assert (light["type"], node.translation) == ("point", position.tolist())
        np.testing.assert_allclose(light["intensity"] * np.array(light["color"]), rgb)
        assert max(light["color"]) == 1


def test_names_stay_apart():
    assert unique_words(["a", "b", "a", "a_2", "a"]) == ["a", "b", "a_2", "a_2_2", "a_3"]


def test_without_usd_core_the_message_says_what_to_do(cameras, lights, tmp_path, monkeypatch):
    own = builtins.__import__

    def absent(name, *rest):
        if name == "pxr":
            raise ImportError(name)
        return own(name, *rest)

    monkeypatch.setattr(builtins, "__import__", absent)
    with pytest.raises(InputError, match=r"--formats: usd: expected the package usd-core, found none; pip install"):
        write_stage_usd(tmp_path / "stage.usda", cameras, lights)
