"""Cameras of each format against projections by others: OpenCV, COLMAP, and nerfstudio's published convention."""

from __future__ import annotations

import json
import shutil

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from pipeline.base.errors import Complaints
from pipeline.capture.known_cameras import digest_known_cameras, read_known_cameras
from pipeline.capture.known_schema import KnownCameras
from pipeline.geometry.cameras import Camera, write_cameras

SIZE = (640, 480)
SIZES = {"cam00": SIZE, "cam01": SIZE}
SAME_PX = 1e-6
CENTERS = {"cam00": np.array([0.3, 1.5, 2.0]), "cam01": np.array([-1.9, 0.8, 0.4])}
POINTS = np.array([0.0, 1.0, 0.0]) + np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3))
"""Metres, about the middle of the stage."""

LENSES = {
    "SIMPLE_PINHOLE": [500.0, 310.0, 250.0],
    "PINHOLE": [500.0, 510.0, 310.0, 250.0],
    "SIMPLE_RADIAL": [500.0, 310.0, 250.0, -0.12],
    "RADIAL": [500.0, 310.0, 250.0, -0.12, 0.05],
    "OPENCV": [500.0, 510.0, 310.0, 250.0, -0.12, 0.05, 0.002, -0.003],
    "FULL_OPENCV": [500.0, 510.0, 310.0, 250.0, -0.12, 0.05, 0.002, -0.003, 0.01, 0.0, 0.0, 0.0],
}


def looking_at_the_stage(center):
    """Rows right, down, forward of a camera, with some roll."""
    forward = np.array([0.0, 1.0, 0.0]) - center
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.1, 1.0, 0.05])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def read(folder, sizes=SIZES, **keys):
    """The cameras, and what is complained of."""
    complaints = Complaints(folder)
    section = KnownCameras.model_validate({"method": "known", **keys})
    return read_known_cameras(folder, section, sizes, complaints), "\n".join(complaints.messages)


def model(lens="OPENCV", images=None, unit_m=1.0, params=None, size=SIZE):
    """A COLMAP model of both cameras, one image each or as `images` (name: (camera, offset of the centre)) says."""
    images = images or {f"{name}.png": (name, np.zeros(3)) for name in SIZES}
    made, ids = pycolmap.Reconstruction(), {name: k for k, name in enumerate(SIZES, 1)}
    for k in ids.values():
        made.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=k, model=lens, width=size[0], height=size[1], params=params or LENSES[lens])
        )
    for key, (name, (owner, offset)) in enumerate(images.items(), 1):
        R = looking_at_the_stage(CENTERS[owner])
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ (CENTERS[owner] + offset) / unit_m)
        made.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=ids[owner], image_id=key), pose)
    return made


def write_model(folder, made, kind="binary"):
    folder.mkdir(parents=True, exist_ok=True)
    getattr(made, f"write_{kind}")(folder)


def same_projections(cameras, made, unit_m=1.0):
    for image in made.images.values():
        in_camera = POINTS / unit_m @ image.cam_from_world().rotation.matrix().T + image.cam_from_world().translation
        expected = image.camera.img_from_cam(in_camera)
        pixels, depth = cameras[image.name.split(".")[0]].project(POINTS)
        assert np.abs(pixels - expected).max() < SAME_PX
        assert depth == pytest.approx(in_camera[:, 2] * unit_m)


class TestColmap:
    @pytest.mark.parametrize("kind", ["text", "binary"])
    @pytest.mark.parametrize("lens", LENSES)
    def test_projections_are_colmaps(self, tmp_path, lens, kind):
        made = model(lens)
        write_model(tmp_path / "sparse/0", made, kind)
        cameras, complaints = read(tmp_path, format="colmap", path="sparse/0")
        assert not complaints
        same_projections(cameras, made)

    def test_projections_are_opencvs(self, tmp_path):
        """Text as COLMAP's documentation has it, without the rigs and frames of newer versions."""
        quaternion = Rotation.from_euler("xyz", [0.3, -0.2, 0.1])
        qx, qy, qz, qw = quaternion.as_quat().tolist()
        (tmp_path / "cameras.txt").write_text("7 OPENCV 640 480 500 510 310 250 -0.12 0.05 0.002 -0.003\n")
        (tmp_path / "images.txt").write_text(f"3 {qw!r} {qx!r} {qy!r} {qz!r} 0.1 -1.2 3.0 7 cam00.jpg\n\n")
        (tmp_path / "points3D.txt").write_text("")
        cameras, complaints = read(tmp_path, {"cam00": SIZE}, format="colmap", path=".")
        assert not complaints
        # OpenCV's first pixel centre is (0, 0).
        K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
        dist = np.array([-0.12, 0.05, 0.002, -0.003])
        expected, _ = cv2.projectPoints(POINTS, quaternion.as_rotvec(), np.array([0.1, -1.2, 3.0]), K, dist)
        pixels, _ = cameras["cam00"].project(POINTS)
        assert np.abs(pixels - expected[:, 0] - 0.5).max() < SAME_PX

    def test_a_model_in_millimetres(self, tmp_path):
        made = model(unit_m=1e-3)
        write_model(tmp_path / "sparse", made)
        cameras, complaints = read(tmp_path, format="colmap", path="sparse", scale_to_m=1e-3)
        assert not complaints
        same_projections(cameras, made, 1e-3)
        assert cameras["cam01"].center == pytest.approx(CENTERS["cam01"])

    def test_cameras_on_a_rig(self, tmp_path):
        """As newer versions of COLMAP write them: one pose of the rig, and the cameras' places on it."""
        made = pycolmap.Reconstruction()
        rig = pycolmap.Rig(rig_id=1)
        for key in (1, 2):
            made.add_camera(
                pycolmap.Camera(camera_id=key, model="OPENCV", width=640, height=480, params=LENSES["OPENCV"])
            )
        rig.add_ref_sensor(pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=1))
        first, second = (
            pycolmap.Rigid3d(pycolmap.Rotation3d(R), -R @ center)
            for R, center in ((looking_at_the_stage(center), center) for center in CENTERS.values())
        )
        sensor = pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=2)
        rig.add_sensor(sensor, second * first.inverse())
        made.add_rig(rig)
        frame = pycolmap.Frame(frame_id=1, rig_id=1, rig_from_world=first)
        for key in (1, 2):
            frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(type=pycolmap.SensorType.CAMERA, id=key), key))
        made.add_frame(frame)
        for key, name in enumerate(SIZES, 1):
            made.add_image(pycolmap.Image(name=f"{name}.png", camera_id=key, image_id=key, frame_id=1))
        made.register_frame(1)
        write_model(tmp_path / "sparse", made)
        cameras, complaints = read(tmp_path, format="colmap", path="sparse")
        assert not complaints
        for name, camera in cameras.items():
            assert camera.center == pytest.approx(CENTERS[name])
        same_projections(cameras, made)

    def test_images_over_time_in_folders_of_their_cameras(self, tmp_path):
        images = {f"{name}/{frame:06d}.png": (name, np.zeros(3)) for name in SIZES for frame in range(3)}
        write_model(tmp_path / "sparse", model(images=images | {"extra/holiday.jpg": ("cam00", np.ones(3))}))
        cameras, complaints = read(tmp_path, format="colmap", path="sparse")
        assert not complaints
        for name, camera in cameras.items():
            assert camera.center == pytest.approx(CENTERS[name])

    def test_a_camera_that_moved_between_images_is_named(self, tmp_path):
        images = {f"{name}/{frame}.png": (name, np.zeros(3)) for name in SIZES for frame in range(2)}
        # One millimetre to the side at 0.5 m is 500 * 0.002 = 1 pixel; seen at an angle, somewhat less.
        images["cam01/1.png"] = ("cam01", np.array([0.001, 0, 0]))
        write_model(tmp_path / "sparse", model(images=images))
        _, complaints = read(tmp_path, format="colmap", path="sparse")
        assert "sparse: cam01: expected one pose and lens for all of its 2 images" in complaints
        assert "found cam01/0.png and cam01/1.png 0.63 px apart" in complaints
        assert "cam00" not in complaints

    def test_names_are_matched_exactly(self, tmp_path):
        images = {"cam00_b.png": ("cam00", np.zeros(3)), "cam01/cam00.png": ("cam01", np.zeros(3))}
        write_model(tmp_path / "sparse", model(images=images))
        _, complaints = read(tmp_path, format="colmap", path="sparse")
        assert "image cam01/cam00.png: expected the name or the folder of one camera" in complaints
        assert "cam00: expected an image with a pose that is called cam00 or lies in a folder cam00" in complaints

    @pytest.mark.parametrize(
        ("lens", "params", "words"),
        [
            ("OPENCV_FISHEYE", [500.0, 510, 310, 250, 0, 0, 0, 0], "SIMPLE_PINHOLE, PINHOLE"),
            ("THIN_PRISM_FISHEYE", [500.0, 510, 310, 250, 0, 0, 0, 0, 0, 0, 0, 0], "found THIN_PRISM_FISHEYE; "),
            ("FULL_OPENCV", [500.0, 510, 310, 250, 0, 0, 0, 0, 0, 0.1, 0, 0], "found k4 of 0.1"),
            ("PINHOLE", [-500.0, 510, 310, 250], "positive focal lengths"),
        ],
    )
    def test_other_lenses_are_refused(self, tmp_path, lens, params, words):
        write_model(tmp_path / "sparse", model(lens, params=params))
        cameras, complaints = read(tmp_path, format="colmap", path="sparse")
        assert not cameras
        assert complaints.count(words) == 2
        assert complaints.count("COLMAP camera 2") == 1

    def test_an_unsupported_lens_of_an_unneeded_image_does_not_matter(self, tmp_path):
        write_model(tmp_path / "sparse", model(lens="OPENCV_FISHEYE", params=[500.0, 510, 310, 250, 0, 0, 0, 0]))
        _, complaints = read(tmp_path, {"cam07": SIZE}, format="colmap", path="sparse")
        assert "FISHEYE" not in complaints
        assert "cam07" in complaints

    @pytest.mark.parametrize("table", ["cameras", "images", "rigs", "frames"])
    def test_a_truncated_table_is_never_taken_for_whole(self, tmp_path, table):
        made = model(images={f"{name}/{frame}.png": (name, np.zeros(3)) for name in SIZES for frame in range(2)})
        write_model(tmp_path / "sparse", made)
        file = tmp_path / f"sparse/{table}.bin"
        content = file.read_bytes()
        for size in [*range(0, len(content), 13), len(content) - 1]:
            file.write_bytes(content[:size])
            cameras, complaints = read(tmp_path, format="colmap", path="sparse")
            assert not cameras
            assert "sparse: " in complaints

    def test_what_is_no_model_is_named(self, tmp_path):
        (tmp_path / "sparse").mkdir()
        assert "found no such files" in read(tmp_path, format="colmap", path="sparse")[1]
        assert "found no such folder" in read(tmp_path, format="colmap", path="other")[1]
        made = model()
        write_model(tmp_path / "sparse", made, "text")
        write_model(tmp_path / "sparse", made, "binary")
        assert "found both; remove one" in read(tmp_path, format="colmap", path="sparse")[1]

    def test_the_resolution_of_the_images_is_refused(self, tmp_path):
        write_model(tmp_path / "sparse", model(size=(320, 240)))
        _, complaints = read(tmp_path, format="colmap", path="sparse")
        assert "cam00: image cam00.png: width x height: expected the sensor's 640 x 480, found 320 x 240" in complaints
        assert "multiply its f and c (pixels) by 2" in complaints
        assert "cam01" in complaints

    def test_every_file_of_the_model_is_in_its_digest(self, tmp_path):
        write_model(tmp_path / "sparse", model())
        section = KnownCameras(method="known", format="colmap", path="sparse")
        before = digest_known_cameras(tmp_path, section)
        for file in sorted((tmp_path / "sparse").iterdir()):
            content = file.read_bytes()
            file.write_bytes(content + b"\0")
            assert digest_known_cameras(tmp_path, section) != before
            file.write_bytes(content)
        assert digest_known_cameras(tmp_path, section) == before
        (tmp_path / "sparse/cameras.bin").rename(tmp_path / "sparse/cameras.old")
        assert digest_known_cameras(tmp_path, section) != before


INTRINSICS = {"fl_x": 500.0, "fl_y": 510.0, "cx": 310.0, "cy": 250.0, "w": 640, "h": 480}


def opengl_pose(center):
    """World-from-camera, columns right, up, backward, centre."""
    right, down, forward = looking_at_the_stage(center)
    pose = np.eye(4)
    pose[:3] = np.stack([right, -down, -forward, center], 1)
    return pose


def transforms(change=None, **keys):
    """A transforms.json of both cameras."""
    frames = [
        {"file_path": f"./images/{name}/00001.png", "transform_matrix": opengl_pose(center).tolist()}
        for name, center in CENTERS.items()
    ]
    content = {"camera_model": "OPENCV", **INTRINSICS, **keys, "frames": frames}
    if change:
        change(content)
    return content


def read_transforms(folder, content, **keys):
    (folder / "transforms.json").write_text(json.dumps(content))
    return read(folder, format="nerfstudio", path="transforms.json", **keys)


def projected(center, points=POINTS):
    """By the convention: x right, y up, z backward; pixels right and down from the corner of the image."""
    pose = opengl_pose(center)
    x, y, z = pose[:3, :3].T @ (points - pose[:3, 3]).T
    return np.stack([310 + 500 * x / -z, 250 - 510 * y / -z], 1)


NERFSTUDIO_BREAKS = {
    "fisheye": (lambda c: c.update(camera_model="OPENCV_FISHEYE"), ["found OPENCV_FISHEYE; undistort"]),
    "another fisheye": (lambda c: c.update(is_fisheye=True), ["camera_model: expected one of SIMPLE_PINHOLE"]),
    "k4": (lambda c: c.update(k4=0.1), ["expected k1, k2, p1, p2 and k3 only, found k4 of 0.1"]),
    "no focal length": (lambda c: c.pop("fl_y"), ["fl_y: expected a finite number, found none"]),
    "angle": (
        lambda c: (c.pop("fl_x"), c.update(camera_angle_x=1.2)),
        ["only camera_angle_x; give fl_x = w / (2 tan(camera_angle_x / 2))"],
    ),
    "twice": (
        lambda c: c["frames"][0].update(cx=311.0),
        ["cam00/00001.png: expected a value for this frame or one for all frames, found cx of 311.0 and of 310.0"],
    ),
    "half a pose": (
        lambda c: c["frames"][1]["transform_matrix"].pop(),
        ["frame ./images/cam01/00001.png: transform_matrix: expected 4 x 4 finite numbers"],
    ),
    "mirrored": (
        lambda c: [row.__setitem__(0, -row[0]) for row in c["frames"][0]["transform_matrix"]],
        ["cam00: image ./images/cam00/00001.png: R: expected a rotation", "found a mirrored one"],
    ),
    "scaled": (
        lambda c: c.update(applied_transform=np.diag([2.0, 2, 2, 1])[:3].tolist()),
        ["cam00: image ./images/cam00/00001.png: R: expected a rotation", "rows off by 0.75"],
    ),
    "applied nothing": (lambda c: c.update(applied_scale=0), ["expected what can be undone, found a scale of 0"]),
    "no name": (lambda c: c["frames"][0].pop("file_path"), ["frames[0]: file_path: expected text, found None"]),
    "frames by name": (lambda c: c.update(frames={"a": {}}), ["frames: expected a list of sections"]),
    "other size": (lambda c: c.update(w=641), ["width x height: expected the sensor's 640 x 480, found 641 x 480"]),
    "half pixel": (lambda c: c.update(w=640.5), ["w, h: expected whole numbers of pixels, found 640.5"]),
    "all at once": (
        lambda c: (c["frames"][0].update(cx="wide"), c.pop("cx"), c["frames"][1].update(cx=1.0, k5=2.0)),
        ["cam00/00001.png: cx: expected a finite number, found wide", "cam01/00001.png: distortion: expected k1"],
    ),
}  # fmt: skip


class TestNerfstudio:
    def test_projections_are_the_conventions(self, tmp_path):
        cameras, complaints = read_transforms(tmp_path, transforms())
        assert not complaints
        for name, center in CENTERS.items():
            pixels, depth = cameras[name].project(POINTS)
            assert (depth > 0).all()
            assert np.abs(pixels - projected(center)).max() < SAME_PX

    def test_distortion_is_opencvs(self, tmp_path):
        terms = {"k1": -0.12, "k2": 0.05, "p1": 0.002, "p2": -0.003, "k3": 0.01}
        cameras, complaints = read_transforms(tmp_path, transforms(**terms))
        assert not complaints
        for name, center in CENTERS.items():
            ideal = (projected(center) - [310, 250]) / [500, 510]
            K = np.array([[500.0, 0, 309.5], [0, 510, 249.5], [0, 0, 1]])
            points = np.concatenate([ideal, np.ones((50, 1))], 1)
            expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array([*terms.values()]))
            assert np.abs(cameras[name].project(POINTS)[0] - expected[:, 0] - 0.5).max() < SAME_PX

    def test_intrinsics_of_each_frame(self, tmp_path):
        def move(content):
            for key in INTRINSICS:
                value = content.pop(key)
                for frame in content["frames"]:
                    frame[key] = value

        cameras, complaints = read_transforms(tmp_path, transforms(move))
        assert not complaints
        assert np.abs(cameras["cam01"].project(POINTS)[0] - projected(CENTERS["cam01"])).max() < SAME_PX

    def test_applied_transform_and_scale_are_undone(self, tmp_path):
        """As ns-process-data applies them: axes swapped, moved, then scaled."""
        applied = np.array([[1.0, 0, 0, 0.2], [0, 0, 1, -0.4], [0, -1, 0, 1.1]])

        def apply(content):
            for frame in content["frames"]:
                pose = np.array(frame["transform_matrix"])
                pose[:3] = applied @ pose
                pose[:3, 3] *= 0.25
                frame["transform_matrix"] = pose.tolist()

        content = transforms(apply, applied_transform=applied.tolist(), applied_scale=0.25)
        cameras, complaints = read_transforms(tmp_path, content)
        assert not complaints
        for name, center in CENTERS.items():
            assert np.abs(cameras[name].project(POINTS)[0] - projected(center)).max() < SAME_PX
            assert cameras[name].center == pytest.approx(center)

    def test_a_file_in_centimetres(self, tmp_path):
        def apply(content):
            for frame in content["frames"]:
                for row in frame["transform_matrix"][:3]:
                    row[3] *= 100

        cameras, complaints = read_transforms(tmp_path, transforms(apply), scale_to_m=0.01)
        assert not complaints
        for name, center in CENTERS.items():
            assert np.abs(cameras[name].project(POINTS)[0] - projected(center)).max() < SAME_PX

    @pytest.mark.parametrize("name", NERFSTUDIO_BREAKS)
    def test_what_is_wrong_is_named(self, tmp_path, name):
        change, words = NERFSTUDIO_BREAKS[name]
        _, complaints = read_transforms(tmp_path, transforms(change))
        for text in words:
            assert text in complaints
        assert all(line.startswith("transforms.json: ") for line in complaints.splitlines())


class TestCamerasJson:
    def test_cameras_come_as_they_are_but_in_metres(self, tmp_path):
        K = np.array([[500.0, 0, 310], [0, 510, 250], [0, 0, 1]])
        dist = np.array([-0.12, 0.05, 0.002, -0.003, 0.01])
        given = {}
        for name, center in CENTERS.items():
            R = looking_at_the_stage(center)
            given[name] = Camera(R, -R @ center * 1000, K, dist, *SIZE)
        write_cameras(tmp_path / "cameras.json", given | {"spare": given["cam00"]})
        cameras, complaints = read(tmp_path, path="cameras.json", scale_to_m=0.001)
        assert not complaints
        assert set(cameras) == set(SIZES)
        for name, center in CENTERS.items():
            turn, _ = cv2.Rodrigues(looking_at_the_stage(center))
            opencv_K = K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]
            expected, _ = cv2.projectPoints(POINTS, turn, -looking_at_the_stage(center) @ center, opencv_K, dist)
            assert np.abs(cameras[name].project(POINTS)[0] - expected[:, 0] - 0.5).max() < SAME_PX

    def test_a_rotation_of_five_digits_is_made_one(self, tmp_path):
        R = looking_at_the_stage(CENTERS["cam00"])
        camera = Camera(R.round(5), -R.round(5) @ CENTERS["cam00"], np.diag([500.0, 500, 1]), np.zeros(5), *SIZE)
        write_cameras(tmp_path / "cameras.json", {"cam00": camera})
        cameras, complaints = read(tmp_path, {"cam00": SIZE}, path="cameras.json")
        assert not complaints
        R = cameras["cam00"].R
        assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
        assert cameras["cam00"].center == pytest.approx(CENTERS["cam00"], abs=1e-4)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"path": "sparse"}, "ends in .json"),
        ({"path": "sparse", "format": "nerfstudio"}, "ends in .json"),
        ({"path": "../sparse", "format": "colmap"}, "stays inside"),
        ({"path": "cameras.json", "frame": "world"}, "'stage' or 'own'"),
        ({"path": "cameras.json", "scale_to_m": 0.0}, "greater than 0"),
        ({"path": "cameras.json", "format": "opencv"}, "'cameras_json', 'colmap' or 'nerfstudio'"),
    ],
)
def test_keys_are_checked(keys, expected):
    with pytest.raises(ValueError, match=expected):
        KnownCameras.model_validate({"method": "known", **keys})


def test_a_link_out_of_the_capture_is_refused(tmp_path):
    write_model(tmp_path / "elsewhere", model())
    shutil.copytree(tmp_path / "elsewhere", tmp_path / "capture/sparse")
    (tmp_path / "capture/sparse/cameras.bin").unlink()
    (tmp_path / "capture/sparse/cameras.bin").symlink_to(tmp_path / "elsewhere/cameras.bin")
    section = KnownCameras(method="known", format="colmap", path="sparse")
    with pytest.raises(Exception, match="expected a file inside the capture folder"):
        digest_known_cameras(tmp_path / "capture", section)
