"""Cameras that sit on a rig of a COLMAP model, text and binary, against projections by COLMAP."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from pipeline.capture.cameras.colmap_cameras import write_colmap_rig
from tests.support.rigs.camera_files import (
    CENTERS,
    LENSES,
    POINTS,
    SAME_PX,
    SIZE,
    SIZES,
    looking_at_the_stage,
    read,
    same_projections,
    write_model,
)

KINDS = ("text", "binary")
STILL = ((np.zeros(3), np.zeros(3)),)
MOVING = (*STILL, (np.array([0.0, 0.3, 0.0]), np.array([0.1, -0.2, 0.4])), (np.array([0.5, 0, 0.1]), np.ones(3)))
"""Rotation vector and metres by which the rig is turned and moved in each frame, in its own axes."""


def sensor(key, kind=pycolmap.SensorType.CAMERA):
    return pycolmap.sensor_t(type=kind, id=key)


def rigid(center):
    R = looking_at_the_stage(center)
    return pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ center)


def rig_model(motions=STILL, imu=False):
    """One pose of the rig per frame, and the cameras' places on it; the first camera is the reference."""
    made, rig = pycolmap.Reconstruction(), pycolmap.Rig(rig_id=1)
    for key in (1, 2):
        made.add_camera(pycolmap.Camera(camera_id=key, model="OPENCV", width=640, height=480, params=LENSES["OPENCV"]))
    first, second = (rigid(center) for center in CENTERS.values())
    rig.add_ref_sensor(sensor(1))
    rig.add_sensor(sensor(2), second * first.inverse())
    if imu:
        rig.add_sensor(sensor(7, pycolmap.SensorType.IMU), None)
    made.add_rig(rig)
    for number, (turn, shift) in enumerate(motions, 1):
        moved = pycolmap.Rigid3d(pycolmap.Rotation3d(Rotation.from_rotvec(turn).as_matrix()), shift)
        frame = pycolmap.Frame(frame_id=number, rig_id=1, rig_from_world=moved * first)
        for key in (1, 2):
            frame.add_data_id(pycolmap.data_t(sensor(key), 10 * number + key))
        made.add_frame(frame)
        for key, name in enumerate(SIZES, 1):
            image = {"name": f"rig/{name}/{number:04d}.png", "camera_id": key, "image_id": 10 * number + key}
            made.add_image(pycolmap.Image(**image, frame_id=number))
        made.register_frame(number)
    return made


def same_as_first_frame(cameras, made):
    for image in list(made.images.values())[:2]:
        pose = image.cam_from_world()
        expected = image.camera.img_from_cam(POINTS @ pose.rotation.matrix().T + pose.translation)
        assert np.abs(cameras[image.name.split("/")[1]].project(POINTS)[0] - expected).max() < SAME_PX


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("motions", [STILL, STILL * 3])
@pytest.mark.parametrize("frame", ["stage", "own"])
def test_a_rig_that_stands_still_is_in_the_world(tmp_path, kind, motions, frame):
    made = rig_model(motions)
    write_model(tmp_path / "sparse", made, kind)
    cameras, complaints = read(tmp_path, format="auto", path="sparse", frame=frame)
    assert not complaints
    for name, camera in cameras.items():
        assert camera.center == pytest.approx(CENTERS[name])
    same_as_first_frame(cameras, made)


@pytest.mark.parametrize("kind", KINDS)
def test_a_rig_that_moved_is_in_its_own_frame(tmp_path, kind):
    """Its reference camera is the origin; what the cameras are to each other is the truth."""
    write_model(tmp_path / "sparse", rig_model(MOVING), kind)
    cameras, complaints = read(tmp_path, format="colmap", path="sparse", frame="own")
    assert not complaints
    first = looking_at_the_stage(CENTERS["cam00"])
    assert cameras["cam00"].center == pytest.approx(np.zeros(3), abs=1e-12)
    in_rig = (POINTS - CENTERS["cam00"]) @ first.T
    for image in list(rig_model().images.values()):
        pose = image.cam_from_world()
        expected = image.camera.img_from_cam(POINTS @ pose.rotation.matrix().T + pose.translation)
        assert np.abs(cameras[image.name.split("/")[1]].project(in_rig)[0] - expected).max() < SAME_PX


def test_a_rig_that_moved_has_no_place_in_the_stage(tmp_path):
    write_model(tmp_path / "sparse", rig_model(MOVING))
    _, complaints = read(tmp_path, format="colmap", path="sparse")
    assert complaints.count("expected one pose and lens for all of its 3 images") == 2
    assert complaints.count("a rig that moved needs frame: own") == 2


def test_other_sensors_of_a_rig_do_not_matter(tmp_path):
    made = rig_model(imu=True)
    write_model(tmp_path / "sparse", made)
    cameras, complaints = read(tmp_path, format="colmap", path="sparse")
    assert not complaints
    same_as_first_frame(cameras, made)


def test_tables_by_hand(tmp_path):
    """Text as COLMAP's documentation of its output format has it: QW QX QY QZ TX TY TZ."""
    first, second = (rigid(center) for center in CENTERS.values())
    on_rig = second * first.inverse()

    def seven(pose):
        x, y, z, w = Rotation.from_matrix(pose.rotation.matrix()).as_quat().tolist()
        return " ".join(map(repr, [w, x, y, z, *pose.translation.tolist()]))

    lens = "OPENCV 640 480 " + " ".join(map(repr, LENSES["OPENCV"]))
    (tmp_path / "cameras.txt").write_text(f"1 {lens}\n2 {lens}\n")
    (tmp_path / "rigs.txt").write_text(f"1 2 CAMERA 1 CAMERA 2 1 {seven(on_rig)}\n")
    (tmp_path / "frames.txt").write_text(f"1 1 {seven(first)} 2 CAMERA 1 1 CAMERA 2 2\n")
    (tmp_path / "images.txt").write_text(f"1 {seven(first)} 1 cam00.png\n\n2 {seven(second)} 2 cam01.png\n\n")
    cameras, complaints = read(tmp_path, format="auto", path=".")
    assert not complaints
    for name, center in CENTERS.items():
        assert cameras[name].center == pytest.approx(center)
    same_projections(cameras, pycolmap.Reconstruction(write_points(tmp_path)))


@pytest.mark.parametrize("kind", KINDS)
def test_a_rig_that_is_written_is_read_back(tmp_path, kind):
    write_model(tmp_path / "given", rig_model())
    known, _ = read(tmp_path, format="colmap", path="given")
    images = {number: {name: f"{name}/{number}.png" for name in known} for number in (4, 7, 9)}
    del images[7]["cam00"]
    write_colmap_rig(tmp_path / "sparse", known, images, kind)
    cameras, complaints = read(tmp_path, format="colmap", path="sparse")
    assert not complaints
    for name, camera in known.items():
        assert np.abs(cameras[name].project(POINTS)[0] - camera.project(POINTS)[0]).max() < SAME_PX
    written = pycolmap.Reconstruction(tmp_path / "sparse")
    assert (written.num_rigs(), written.num_reg_frames(), written.num_images()) == (1, 3, 5)


def write_points(folder):
    (folder / "points3D.txt").write_text("")
    return folder


def test_one_camera_that_moved_is_no_rig(tmp_path):
    """All images share one camera of COLMAP's: they are of two cameras of the capture, which are not in one place."""
    made = pycolmap.Reconstruction()
    lens = pycolmap.Camera(camera_id=1, model="OPENCV", width=SIZE[0], height=SIZE[1], params=LENSES["OPENCV"])
    made.add_camera_with_trivial_rig(lens)
    for key, (name, shift) in enumerate([("cam00", 0.0), ("cam00", 0.1), ("cam01", 0.0)], 1):
        image = pycolmap.Image(name=f"{name}/{key}.png", camera_id=1, image_id=key)
        made.add_image_with_trivial_frame(image, rigid(CENTERS[name] + shift))
    write_model(tmp_path / "sparse", made)
    _, complaints = read(tmp_path, format="colmap", path="sparse", frame="own")
    assert "cam00: expected one pose and lens for all of its 2 images" in complaints
