"""Cameras of Metashape's .xml against the equations of its user manual."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.rigs.camera_files import CENTERS, POINTS, SAME_PX, SIZE, looking_at_the_stage, read

TERMS = {"f": 500.0, "b1": 6.5, "cx": -11.25, "cy": 7.5, "k1": -0.12, "k2": 0.05, "k3": 0.01, "p1": 0.002, "p2": -0.003}
FISHEYE_TERMS = {"f": 300.0, "b1": 2.5, "cx": -9.0, "cy": 4.0, "k1": -0.04, "k2": 0.01, "k3": -0.004, "k4": 0.0006}
SCALE, SHIFT = 0.37, np.array([0.4, -1.1, 2.3])
TURN = Rotation.from_euler("xyz", [0.7, -0.4, 1.2]).as_matrix()
"""X_world = SCALE TURN X_chunk + SHIFT."""


def text(numbers):
    return " ".join(repr(float(number)) for number in np.ravel(numbers))


def chunk_from_camera(center):
    """Columns are the camera's axes in the chunk; then its place there."""
    pose = np.eye(4)
    pose[:3, :3] = TURN.T @ looking_at_the_stage(center).T
    pose[:3, 3] = TURN.T @ (center - SHIFT) / SCALE
    return pose


def document(terms=TERMS, kind="frame", old=False, camera="", sensor="", chunk="", world=True):
    """As Metashape 2 exports cameras; `old`, as versions do that know no components."""
    lens = "".join(f"<{name}>{value!r}</{name}>" for name, value in terms.items())
    similarity = (
        f'<transform><rotation locked="true">{text(TURN)}</rotation><translation locked="true">{text(SHIFT)}'
        f'</translation><scale locked="true">{SCALE!r}</scale></transform>'
    )
    part = "" if old else ' component_id="0"'
    shots = "".join(
        f'<camera id="{k}" sensor_id="0"{part} label="{name}.jpg">'
        f"<transform>{text(chunk_from_camera(center))}</transform><orientation>1</orientation>{camera}</camera>"
        for k, (name, center) in enumerate(CENTERS.items())
    )
    component = f'<components next_id="1" active_id="0"><component id="0">{similarity}</component></components>'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
<sensors next_id="1"><sensor id="0" label="unknown" type="{kind}"><resolution width="640" height="480"/>
<property name="layer_index" value="0"/>{sensor}
<calibration type="{kind}" class="initial"><resolution width="640" height="480"/><f>9</f></calibration>
<calibration type="{kind}" class="adjusted"><resolution width="640" height="480"/>{lens}</calibration>
</sensor></sensors>
{component if world and not old else ""}<cameras next_id="3">
<group id="0" label="ring">{shots}</group>
<camera id="9" sensor_id="0" label="cam00"/></cameras>
{similarity if world and old else ""}
<reference>LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]</reference>{chunk}
</chunk></document>"""


def projected(center, terms, fisheye):
    """By the manual's equations, from points of the chunk."""
    in_chunk = (POINTS - SHIFT) @ TURN / SCALE
    pose = chunk_from_camera(center)
    X, Y, Z = ((in_chunk - pose[:3, 3]) @ pose[:3, :3]).T
    x, y = X / Z, Y / Z
    if fisheye:
        r0 = np.hypot(x, y)
        x, y = x * np.arctan(r0) / r0, y * np.arctan(r0) / r0
    f, B1, cx, cy, K1, K2, K3, K4, P1, P2 = (
        terms.get(name, 0.0) for name in ("f", "b1", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2")
    )
    r = np.hypot(x, y)
    radial = 1 + K1 * r**2 + K2 * r**4 + K3 * r**6 + K4 * r**8
    xd = x * radial + (P1 * (r**2 + 2 * x**2) + 2 * P2 * x * y)
    yd = y * radial + (P2 * (r**2 + 2 * y**2) + 2 * P1 * x * y)
    return np.stack([640 * 0.5 + cx + xd * f + xd * B1, 480 * 0.5 + cy + yd * f], 1)


def read_text(folder, content, **keys):
    (folder / "cameras.xml").write_text(content)
    return read(folder, **{"format": "metashape", "path": "cameras.xml", **keys})


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize(("kind", "terms"), [("frame", TERMS), ("fisheye", FISHEYE_TERMS)])
def test_projections_are_those_of_the_manual(tmp_path, kind, terms, old):
    cameras, complaints = read_text(tmp_path, document(terms, kind, old))
    assert not complaints
    for name, center in CENTERS.items():
        pixels, depth = cameras[name].project(POINTS)
        assert (depth > 0).all()
        assert np.abs(pixels - projected(center, terms, kind == "fisheye")).max() < SAME_PX
        assert cameras[name].center == pytest.approx(center)


def test_a_chunk_whose_transform_is_one_matrix(tmp_path):
    matrix = np.eye(4)
    matrix[:3] = np.concatenate([SCALE * TURN, SHIFT[:, None]], 1)
    content = document(old=True, world=False, chunk=f"<transform>{text(matrix)}</transform>")
    cameras, complaints = read_text(tmp_path, content)
    assert not complaints
    assert cameras["cam01"].center == pytest.approx(CENTERS["cam01"])


def test_a_chunk_without_scale_stays_in_its_own_frame(tmp_path):
    cameras, complaints = read_text(tmp_path, document(world=False), scale_to_m=SCALE)
    assert not complaints
    assert cameras["cam00"].center == pytest.approx(SCALE * chunk_from_camera(CENTERS["cam00"])[:3, 3])


BREAKS = {
    "rolling shutter of a sensor": (document(sensor="<rolling_shutter>true</rolling_shutter>"), "rolling shutter: exp"),
    "of a property": (document(sensor='<property name="rolling_shutter" value="1"/>'), "found it compensated"),
    "of a camera": (document(camera="<rolling_shutter>1 0 0</rolling_shutter>"), "camera cam00.jpg: rolling shutter"),
    "skew": (document(TERMS | {"b2": 0.3}), "distortion: expected k1, k2, p1, p2 and k3 only, found B2 of 0.3"),
    "k4": (document(TERMS | {"k4": 0.1}), "found k4 of 0.1; undistort the images"),
    "p3": (document(TERMS | {"p3": 0.1}), "found P3 of 0.1; undistort the images"),
    "tangential fisheye": (document(FISHEYE_TERMS | {"p1": 0.1}, "fisheye"), "k1, k2, k3 and k4 only, found p2 of 0.1"),
    "panorama": (document(kind="spherical"), "type: expected frame or fisheye, found spherical"),
    "NaN": (document(TERMS | {"cx": float("nan")}), "cx: expected a finite number, found nan"),
    "no focal length": (document({"cx": 1.0}), "f: expected a finite number, found none"),
    "other size": (document().replace('"640"', '"1280"'), "cam00: image cam00.jpg: width x height: expected"),
    "missing camera": (document().replace("cam01.jpg", "spare.jpg"), "cam01: expected an image with a pose that is"),
    "half a pose": (document().replace(" 0.0 0.0 0.0 1.0</tr", "</tr"), "transform: expected 16 finite numbers"),
    "no scale": (document().replace(f">{SCALE!r}<", ">0<"), "transform: expected a scale above 0, found 0"),
    "the Earth": (document().replace("LOCAL_CS", "GEOGCS"), "choose Local Coordinates in the Reference pane"),
    "two chunks": (document().replace("</chunk>", '</chunk><chunk label="B"/>'), "found Chunk 1, B; export one"),
    "slave": (
        document().replace("</group>", '<camera id="5" sensor_id="0" master_id="0" label="cam01"/></group>'),
        "transform: expected its own, found one of camera 0; export without the multi-camera system",
    ),
    "no sensor": (document().replace('sensor_id="0"', 'sensor_id="7"'), "expected a sensor of the file, found 7"),
    "parts not joined": (
        document(world=False).replace('component_id="0"', 'component_id="1"', 1),
        "components: 0, 1: expected one frame for all cameras",
    ),
    "mirrored": (
        document().replace(text(TURN), text(-TURN)),
        "R: expected a rotation (orthonormal, right-handed), found a mirrored one",
    ),
    "no document": ("<calibration/>", "expected a document of Metashape with one chunk, found none"),
    "no xml": ("<document>", "expected an XML file, found: no element found"),
    "entities": ("<!DOCTYPE a [<!ENTITY b 'b'>]><document/>", "expected an XML file without DOCTYPE"),
}  # fmt: skip


@pytest.mark.parametrize("name", BREAKS)
def test_what_is_wrong_is_named(tmp_path, name):
    content, words = BREAKS[name]
    _, complaints = read_text(tmp_path, content)
    assert words in complaints
    assert all(line.startswith("cameras.xml: ") for line in complaints.splitlines())


def test_other_cameras_of_the_file_may_be_anything(tmp_path):
    (tmp_path / "exported.xml").write_text(document().replace("cam01.jpg", "spare.jpg"))
    cameras, complaints = read(tmp_path, {"cam00": SIZE}, format="auto", path="exported.xml")
    assert not complaints
    assert set(cameras) == {"cam00"}
