"""Cameras of EasyMocap's files against projections by OpenCV of the numbers in them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.support.rigs.camera_files import (
    CENTERS,
    POINTS,
    SAME_PX,
    SIZE,
    looking_at_the_stage,
    model,
    read,
    write_model,
)

K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
DIST = np.array([[-0.12, 0.05, 0.002, -0.003, 0.01]])
SIX_DIGITS_PX = 2e-3
"""Half of the last of six digits, 5e-7: of each term of a rotation and a translation (m) of cameras 2 m away, times a
focal length of 510 pixels, 8e-4 with all at their worst; twice that and some for the coefficients."""


def matrix(key, numbers):
    """As EasyMocap's FileStorage writes it: six digits, and lines that end as on Windows."""
    rows, columns = numbers.shape
    data = ", ".join(f"{number:.6f}" for number in numbers.ravel())
    return f"{key}: !!opencv-matrix\r\n  rows: {rows}\r\n  cols: {columns}\r\n  dt: d\r\n  data: [{data}]\r\n"


def head(names=CENTERS):
    return "%YAML:1.0\r\n---\r\nnames:\r\n" + "".join(f'  - "{name}"\r\n' for name in names)


def intrinsics(dist="dist_", size=True, K=K, coefficients=DIST):
    text = head()
    for name in CENTERS:
        text += matrix(f"K_{name}", K) + matrix(f"{dist}{name}", coefficients)
        text += f"H_{name}: 480\r\nW_{name}: 640\r\n" if size else ""
    return text


def extrinsics(vector=True, turned=True):
    text = head()
    for name, center in CENTERS.items():
        R = looking_at_the_stage(center)
        text += matrix(f"R_{name}", cv2.Rodrigues(R)[0]) if vector else ""
        text += matrix(f"Rot_{name}", R if turned else R.T) + matrix(f"T_{name}", (-R @ center)[:, None])
    return text


def read_texts(folder, lenses=None, poses=None, **keys):
    (folder / "rig").mkdir(exist_ok=True)
    (folder / "rig/intri.yml").write_text(intrinsics() if lenses is None else lenses)
    (folder / "rig/extri.yml").write_text(extrinsics() if poses is None else poses)
    return read(folder, **{"format": "easymocap", "path": "rig", **keys})


def written(name):
    """The numbers that six digits leave of a pose."""
    R = looking_at_the_stage(CENTERS[name])
    return cv2.Rodrigues(R)[0].round(6), (-R @ CENTERS[name]).round(6)


@pytest.mark.parametrize("keys", [{}, {"dist": "D_", "size": False}, {"coefficients": DIST[:, :4]}])
def test_projections_are_opencvs(tmp_path, keys):
    cameras, complaints = read_texts(tmp_path, intrinsics(**keys))
    assert not complaints
    for name, center in CENTERS.items():
        coefficients = keys.get("coefficients", DIST)
        pixels, depth = cameras[name].project(POINTS)
        assert (depth > 0).all()
        same = cv2.projectPoints(POINTS, *written(name), K, coefficients)[0][:, 0] + 0.5
        assert np.abs(pixels - same).max() < SAME_PX
        turn = cv2.Rodrigues(looking_at_the_stage(center))[0]
        true = cv2.projectPoints(POINTS, turn, -looking_at_the_stage(center) @ center, K, coefficients)[0][:, 0] + 0.5
        assert np.abs(pixels - true).max() < SIX_DIGITS_PX


def test_rotations_may_be_matrices_alone(tmp_path):
    cameras, complaints = read_texts(tmp_path, poses=extrinsics(vector=False), format="auto")
    assert not complaints
    assert cameras["cam01"].center == pytest.approx(CENTERS["cam01"], abs=1e-5)


BREAKS = {
    "rotation twice": ({"poses": extrinsics(turned=False)}, "R_cam00, Rot_cam00: expected the same rotation twice"),
    "no translation": ({"poses": extrinsics().replace("T_cam01", "t_cam01")}, "camera cam01: T_cam01: expected 3"),
    "missing": (
        {"lenses": intrinsics().replace("cam01", "cam02")},
        "cam01: expected a section of this name",
    ),
    "no names": ({"lenses": intrinsics().replace("names", "cameras")}, "intri.yml: names: expected a list of cameras"),
    "NaN": ({"lenses": intrinsics().replace("500.000000", ".Nan")}, "K_cam00: expected 3 x 3 finite numbers"),
    "half size": ({"lenses": intrinsics(K=K / [[2], [2], [1]], size=False)}, "give K of the sensor's resolution"),
    "other size": ({"lenses": intrinsics().replace("640", "600")}, "width x height: expected the sensor's 640 x 480"),
    "three terms": ({"lenses": intrinsics(coefficients=DIST[:, :3])}, "dist_cam00: expected 4, 5, 8, 12 or 14"),
    "rational": (
        {"lenses": intrinsics(coefficients=np.array([[0, 0, 0, 0, 0, 0.1, 0, 0]]))},
        "distortion: expected k1, k2, p1, p2 and k3 only, found k4 of 0.1",
    ),
    "skew": ({"lenses": intrinsics(K=K + np.eye(3, k=1))}, "K_cam00: expected no skew"),
    "no yaml": ({"poses": "nothing"}, "rig: extri.yml: expected a .yml, .xml or .json of OpenCV's FileStorage"),
}


@pytest.mark.parametrize("name", BREAKS)
def test_what_is_wrong_is_named(tmp_path, name):
    texts, words = BREAKS[name]
    _, complaints = read_texts(tmp_path, **texts)
    assert words in complaints
    assert all(line.startswith("rig") for line in complaints.splitlines())


def test_half_a_folder_is_named(tmp_path):
    read_texts(tmp_path)
    (tmp_path / "rig/extri.yml").unlink()
    assert "found no extri.yml" in read(tmp_path, format="easymocap", path="rig")[1]
    assert "format: expected one that is known" in read(tmp_path, format="auto", path="rig")[1]


def test_a_folder_of_two_formats_is_refused(tmp_path):
    read_texts(tmp_path)
    write_model(tmp_path / "rig", model())
    assert "found what may be colmap or easymocap; say which" in read(tmp_path, format="auto", path="rig")[1]
    assert set(read(tmp_path, format="colmap", path="rig")[0]) == set(dict.fromkeys(CENTERS, SIZE))
