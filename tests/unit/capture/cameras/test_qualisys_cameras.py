"""Cameras of QTM's calibrations against projections by its convention."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.support.rigs.camera_files import CENTERS, POINTS, SAME_PX, SIZE, looking_at_the_stage, read

SERIALS = {"26580": "cam00", "26581": "cam01"}
SIZES = dict.fromkeys(SERIALS, SIZE)
DIST = {"k1": -0.12, "k2": 0.05, "p1": 0.002, "p2": -0.003, "k3": 0.01}
LEFT, TOP = 40, 20
"""Of the video within a sensor of 720 x 520 pixels."""


def camera(serial, center, extra='viewrotation="0"'):
    """Rows of the rotation are right, up and backward; lengths in mm, image coordinates in 1/64 pixel."""
    right, down, forward = looking_at_the_stage(center)
    rows = np.stack([right, -down, -forward])
    turn = " ".join(f'r{i + 1}{j + 1}="{float(rows[i, j])!r}"' for i in range(3) for j in range(3))
    x, y, z = (1000 * center).tolist()
    return f"""<camera active="1" avg-residual="0.4" serial="{serial}" model="Miqus Video" {extra}>
<fov_marker left="0" top="0" right="719" bottom="519"/>
<fov_video left="{LEFT}" top="{TOP}" right="{LEFT + 639}" bottom="{TOP + 479}"/>
<transform x="{x!r}" y="{y!r}" z="{z!r}" {turn}/>
<intrinsic focallength="9.3" sensorMinU="0.0" sensorMaxU="46079.0" sensorMinV="0.0" sensorMaxV="33279.0"
 focalLengthU="{64 * 500.0}" focalLengthV="{64 * 510.0}" centerPointU="{64 * (LEFT + 310) - 0.5}"
 centerPointV="{64 * (TOP + 250) - 0.5}" skew="0.000000" radialDistortion1="-0.12" radialDistortion2="0.05"
 radialDistortion3="0.01" tangentalDistortion1="0.002" tangentalDistortion2="-0.003"/>
</camera>"""


def document(change=lambda text: text, attributes='source="a.qca" qtm-version="2023.3" type="regular"', **keys):
    cameras = "\n".join(camera(serial, CENTERS[name], **keys) for serial, name in SERIALS.items())
    marker = camera("1", CENTERS["cam00"]).replace('active="1"', 'active="0"')
    return change(f"<calibration {attributes}><cameras>{cameras}{marker}</cameras></calibration>")


def read_text(folder, content, sizes=SIZES, **keys):
    (folder / "rig.qca.txt").write_text(content)
    return read(folder, sizes, **{"format": "qualisys", "path": "rig.qca.txt", **keys})


def projected(center):
    """Right, up and backward of the camera by OpenCV's polynomial, pixels from the corner of the video."""
    right, down, forward = looking_at_the_stage(center)
    axes = np.stack([right, -down, -forward])
    x, y, z = axes @ (POINTS - center).T
    slopes = np.stack([x / -z, -y / -z, np.ones_like(x)], 1)
    K = np.array([[500.0, 0, 310 - 0.5], [0, 510, 250 - 0.5], [0, 0, 1]])
    dist = np.array([DIST[name] for name in ("k1", "k2", "p1", "p2", "k3")])
    return cv2.projectPoints(slopes, np.zeros(3), np.zeros(3), K, dist)[0][:, 0] + 0.5


@pytest.mark.parametrize("name", ["qualisys", "auto"])
def test_projections_are_those_of_the_convention(tmp_path, name):
    cameras, complaints = read_text(tmp_path, document(), format=name)
    assert not complaints
    for serial, owner in SERIALS.items():
        pixels, depth = cameras[serial].project(POINTS)
        assert (depth > 0).all()
        assert np.abs(pixels - projected(CENTERS[owner])).max() < SAME_PX
        assert cameras[serial].center == pytest.approx(CENTERS[owner])


def test_a_file_without_field_of_view_has_all_of_the_sensor(tmp_path):
    start, end = (document().index(tag) for tag in ("<fov_video", "<transform"))
    content = document()[:start] + document()[end:]
    cameras, complaints = read_text(tmp_path, content, {"26580": (720, 520)})
    assert not complaints
    assert cameras["26580"].K[:2, 2] == pytest.approx([LEFT + 310, TOP + 250])


BREAKS = {
    "of Theia": (document(attributes=""), "calibration: expected a calibration with the attribute qtm-version"),
    "upside down": (document(extra='viewrotation="180"'), "viewrotation: expected 0, 90 or 270, found 180; set it to"),
    "skew": (document(lambda t: t.replace('skew="0.000000"', 'skew="3.0"')), "camera 26580: skew: expected 0, found 3"),
    "NaN": (document(lambda t: t.replace('r11="', 'r11="nan" was="', 1)), "camera 26580: r11: expected a finite"),
    "no number": (document(lambda t: t.replace("centerPointU", "centreU")), "centerPointU: expected a finite number"),
    "no transform": (document(lambda t: t.replace("<transform", "<place")), "transform: expected such a part"),
    "half a pixel": (document(lambda t: t.replace('left="40"', 'left="40.5"')), "fov_video: expected whole pixels"),
    "other size": (document(lambda t: t.replace('right="679"', 'right="639"')), "26580: width x height: expected the"),
    "missing": (document(lambda t: t.replace("26581", "26582")), "26581: expected a section of this name, found none"),
    "no xml": ("FREQUENCY 100", "expected an XML file, found: syntax error"),
}


@pytest.mark.parametrize("name", BREAKS)
def test_what_is_wrong_is_named(tmp_path, name):
    content, words = BREAKS[name]
    _, complaints = read_text(tmp_path, content)
    assert words in complaints
    assert all(line.startswith("rig.qca.txt: ") for line in complaints.splitlines())


def test_turned_video_is_not_taken_for_the_sensors(tmp_path):
    _, complaints = read_text(tmp_path, document(extra='viewrotation="90"'), dict.fromkeys(SERIALS, (480, 640)))
    assert complaints.count("width x height: expected the sensor's 480 x 640, found 640 x 480") == 2
