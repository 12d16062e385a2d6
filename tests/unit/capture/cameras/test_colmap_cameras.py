"""Cameras of COLMAP models against projections by COLMAP."""

from __future__ import annotations

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from pipeline.capture.cameras.colmap_cameras import write_colmap
from pipeline.capture.cameras.known_cameras import digest_known_cameras
from pipeline.capture.schema.camera_schema import KnownCameras
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import FISHEYE
from tests.support.rigs.camera_files import (
    CENTERS,
    LENSES,
    POINTS,
    SAME_PX,
    SIZE,
    SIZES,
    model,
    read,
    same_projections,
    write_model,
)


class TestColmap:
    @pytest.mark.parametrize("kind", ["text", "binary"])
    @pytest.mark.parametrize("lens", LENSES)
    def test_projections_are_colmaps(self, tmp_path, lens, kind):
        made = model(lens)
        write_model(tmp_path / "sparse/0", made, kind)
        cameras, complaints = read(tmp_path, format="colmap", path="sparse/0")
        assert not complaints
        same_projections(cameras, made)

    @pytest.mark.parametrize("kind", ["text", "binary"])
    @pytest.mark.parametrize("lens", ["PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"])
    def test_written_model_projects_as_the_cameras_and_is_read_back(self, tmp_path, lens, kind):
        write_model(tmp_path / "given", model(lens))
        cameras, _ = read(tmp_path, format="colmap", path="given")
        write_colmap(tmp_path / "sparse/0", cameras, kind)
        same_projections(cameras, pycolmap.Reconstruction(tmp_path / "sparse/0"))
        again, complaints = read(tmp_path, format="colmap", path="sparse/0")
        assert not complaints
        for name, camera in cameras.items():
            assert again[name].lens is camera.lens
            np.testing.assert_allclose(again[name].R, camera.R, atol=1e-14)
            for key in ("t", "K", "dist"):
                np.testing.assert_allclose(getattr(again[name], key), getattr(camera, key), rtol=1e-14)

    def test_written_fisheye_projects_as_colmaps_up_to_89_degrees(self, tmp_path):
        K = np.array([[200.0, 0, 310], [0, 205, 250], [0, 0, 1]])
        camera = Camera(np.eye(3), np.zeros(3), K, np.array([-0.03, 0.012, -0.005, 0.0007]), *SIZE, FISHEYE)
        write_colmap(tmp_path, {"cam00": camera})
        theta, phi = np.meshgrid(np.radians(np.linspace(0, 89, 90)), np.linspace(0, 2 * np.pi, 17))
        points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
        (theirs,) = pycolmap.Reconstruction(tmp_path).cameras.values()
        assert np.abs(camera.project(points)[0] - theirs.img_from_cam(points)).max() < SAME_PX

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
            ("FOV", [500.0, 510, 310, 250, 0.9], "SIMPLE_PINHOLE, PINHOLE"),
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
        write_model(tmp_path / "sparse", model(lens="FOV", params=[500.0, 510, 310, 250, 0.9]))
        _, complaints = read(tmp_path, {"cam07": SIZE}, format="colmap", path="sparse")
        assert "FOV" not in complaints
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
