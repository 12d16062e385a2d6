"""The stage on a rig without any board: photographs of a textured subject whose cameras are known."""

from __future__ import annotations

import cv2
import numpy as np
import pandas as pd
import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_json, write_table
from pipeline.calibration.cameras.feature_calibration import calibrate_from_features
from pipeline.calibration.cameras.feature_rig import fit_similarity
from pipeline.calibration.lights.length_units import BALL_ERROR
from pipeline.capture.images import write_png
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.geometry.cameras import read_cameras, write_cameras
from pipeline.stages.calibrate_cameras import run
from tests.support.rigs.textured_subject import SIZE, moved, photograph, ring

CAMERAS, FRAMES, NOISE = 8, (3, 7), 0.004
FACTS = {"transfer": "srgb", "black_level": 0.0, "downsample_from_sensor": 2}
SENSOR = (2 * SIZE[0], 2 * SIZE[1])


def at_sensor(cameras):
    return {name: camera.downsampled(0.5) for name, camera in cameras.items()}


@pytest.fixture(scope="module")
def planted():
    return ring(CAMERAS, 112)


@pytest.fixture(scope="module")
def capture(planted, tmp_path_factory):
    """Two moments between which the subject moves; images are half as large as the sensor."""
    folder, random, views = tmp_path_factory.mktemp("features"), np.random.default_rng(5), []
    for frame in FRAMES:
        for name, camera in planted.items():
            image, mask = photograph(camera, moved(frame))
            noisy = np.repeat(np.clip(image + random.normal(0, NOISE, image.shape), 0, 1)[..., None], 3, 2)
            write_png(folder / f"{name}_{frame}.png", noisy.astype(np.float32))
            write_png(folder / f"{name}_{frame}_mask.png", mask.astype(np.uint8) * np.uint8(255))
            view = {"camera": name, "view": frame, "path": f"{name}_{frame}.png", "digest": ""}
            views.append({**view, "mask": f"{name}_{frame}_mask.png", "mask_digest": ""})
    write_cameras(folder / "lenses.json", at_sensor(planted))
    table = {"camera": list(planted), "sensor_width": SENSOR[0], "sensor_height": SENSOR[1]}
    write_table(folder / "index/cameras.parquet", pd.DataFrame(table))
    return folder, views


def calibrate(capture, out, views=None, **section):
    folder, every = capture
    content = {"method": "features", "intrinsics": "estimate", "views": views or every, "images": FACTS, **section}
    write_json(folder / "index/calibration_cameras.json", content)
    run(capture=folder, index=folder / "index", out=out, threads=2)
    return read_cameras(out / "rig.json"), read_table(out / "quality_cameras.parquet").set_index("camera")


def apart(planted):
    return float(np.linalg.norm(planted["cam0"].center - planted["cam7"].center))


def errors(cameras, planted):
    true = np.stack([camera.center for camera in planted.values()])
    return fit_similarity(np.stack([cameras[name].center for name in planted]), true) - true


def turn_errors(cameras, planted, pairs):
    """Of the pairs with the first camera: size of the turn's error over its error bar."""
    for row in pairs[pairs["first"] == "cam0"].itertuples():
        found, true = (rig[row.second].R @ rig[row.first].R.T for rig in (cameras, planted))
        apart = np.degrees(np.linalg.norm(cv2.Rodrigues(found @ true.T)[0]))
        yield apart / (np.sqrt(3) * row.turn_sigma_deg)


def test_rig_with_given_lenses_and_a_distance(capture, planted, tmp_path):
    given = {"format": "cameras_json", "path": "lenses.json"}
    distance = {"first": "cam0", "second": "cam7", "metres": apart(planted)}
    cameras, quality = calibrate(capture, tmp_path, intrinsics="known", lenses_from=given, distance=distance)
    assert np.linalg.norm(cameras["cam0"].center - cameras["cam7"].center) == pytest.approx(apart(planted), rel=1e-9)
    # SIFT is good to some 0.3 of these pixels of 2.9 mm; a camera's centre is held by some 300 of its features.
    assert np.linalg.norm(errors(cameras, planted), axis=1).max() < 0.005
    assert pytest.approx(at_sensor(planted)["cam3"].K) == cameras["cam3"].K
    assert (cameras["cam3"].width, cameras["cam3"].height) == SENSOR
    residuals = read_table(tmp_path / "residuals_cameras.parquet")
    assert sorted(residuals.view.unique()) == list(FRAMES) and (residuals.groupby("camera").size() > 100).all()
    # A point is of one moment; its projections are residuals of the cameras that are written.
    assert (residuals.groupby("corner").view.nunique() == 1).all()
    assert quality.rms_px.max() < 2.0


def photograph_ball(folder, cameras, radius_m=0.15, middle=(0.05, -0.1, 0.02)):
    """Silhouettes of a mirror ball at sensor resolution, each the outline of its cone of tangents."""
    entries = []
    for name, camera in cameras.items():
        toward = np.array(middle) - camera.center
        far = np.linalg.norm(toward)
        axis = toward / far
        side = np.cross(axis, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        around = np.linspace(0, 2 * np.pi, 720, endpoint=False)[:, None]
        ring = np.cos(around) * side + np.sin(around) * np.cross(axis, side)
        sine = radius_m / far
        rim = camera.center + toward * (1 - sine**2) + radius_m * np.sqrt(1 - sine**2) * ring
        # Four samples a pixel along each axis; OpenCV's rim is half a sample too wide.
        outline = camera.project(rim)[0]
        outline -= 0.125 * (outline - outline.mean(0)) / np.linalg.norm(outline - outline.mean(0), axis=1)[:, None]
        fine = np.full((4 * camera.height, 4 * camera.width), 200, np.uint8)
        cv2.fillPoly(fine, [np.round(16 * (4 * outline - 0.5)).astype(np.int32)], 10, cv2.LINE_8, 4)
        gray = fine.reshape(camera.height, 4, camera.width, 4).mean((1, 3))
        cv2.imwrite(str(folder / f"ball_{name}.png"), np.round(gray).astype(np.uint8))
        entries.append({"position": "0", "camera": name, "path": f"ball_{name}.png", "digest": ""})
    return {"silhouettes": entries, "radius_m": radius_m}


def test_rig_whose_lenses_are_estimated_is_as_far_off_as_it_says(capture, planted, tmp_path):
    """Its size is that of a mirror ball in four of the cameras."""
    folder, every = capture
    ball = photograph_ball(folder, {name: at_sensor(planted)[name] for name in ("cam1", "cam3", "cam4", "cam6")})
    # Without masks: what surrounds the subject is black.
    bare = [{key: view[key] for key in ("camera", "view", "path", "digest")} for view in every]
    content = {"method": "features", "intrinsics": "estimate", "views": bare, "images": FACTS, **ball}
    done = calibrate_from_features(folder, content, dict.fromkeys(planted, SENSOR), CalibrateCameras(), 2)
    quality = done.quality.set_index("camera")
    focal = np.array([done.cameras[n].K[0, 0] / at_sensor(planted)[n].K[0, 0] - 1 for n in planted])
    # Of 8 and 24 normal numbers over deviations known to a quarter, the root mean square is below 2 but once in 10^4.
    assert np.sqrt(np.mean((focal / quality.focal_sigma[list(planted)]) ** 2)) < 2
    off = errors(done.cameras, planted) / quality.center_sigma_m[list(planted)].to_numpy()[:, None]
    assert np.sqrt(np.mean(off**2)) < 2
    # Turns of seven relative poses: they share the first camera, and what that has in common.
    assert np.sqrt(np.mean([error**2 for error in turn_errors(done.cameras, planted, done.pairs)])) < 2
    assert {verdict.name for verdict in done.verdicts} == set(planted)
    size = [np.std([rig[name].center for name in planted], axis=0) for rig in (done.cameras, planted)]
    assert np.linalg.norm(size[0]) == pytest.approx(np.linalg.norm(size[1]), rel=BALL_ERROR)


def test_the_same_images_give_the_same_cameras_on_one_core_and_on_two(capture, planted):
    """COLMAP draws at random, and sums in any order unless told otherwise."""
    names = ("cam2", "cam3", "cam4")
    views = [view for view in capture[1] if view["camera"] in names]
    distance = {"first": "cam2", "second": "cam4", "metres": 1.0}
    content = {"method": "features", "intrinsics": "estimate", "views": views, "images": FACTS, "distance": distance}
    sizes = dict.fromkeys(names, SENSOR)
    one, two = (calibrate_from_features(capture[0], content, sizes, CalibrateCameras(), n) for n in (1, 2))
    for name in names:
        assert one.cameras[name].K.tolist() == two.cameras[name].K.tolist()
        assert one.cameras[name].t.tolist() == two.cameras[name].t.tolist()
    assert one.quality.equals(two.quality) and one.residuals.equals(two.residuals)


def test_two_cameras_suffice_if_their_lenses_are_known(capture, planted, tmp_path):
    """Points that no third camera sees are all they have."""
    folder, every = capture
    pair = {name: planted[name] for name in ("cam3", "cam4")}
    true = np.linalg.norm(pair["cam3"].center - pair["cam4"].center)
    write_cameras(folder / "pair.json", at_sensor(pair))
    content = {
        "method": "features", "intrinsics": "known", "images": FACTS,
        "lenses_from": {"format": "cameras_json", "path": "pair.json"},
        "views": [view for view in every if view["camera"] in pair],
        "distance": {"first": "cam3", "second": "cam4", "metres": float(true)},
    }  # fmt: skip
    done = calibrate_from_features(folder, content, dict.fromkeys(pair, SENSOR), CalibrateCameras(), 2)
    (row,) = done.pairs.itertuples()
    found, turn = (rig["cam4"].R @ rig["cam3"].R.T for rig in (done.cameras, pair))
    off = np.degrees(np.linalg.norm(cv2.Rodrigues(found @ turn.T)[0]))
    # Of three normal numbers over a deviation known to a quarter, the root mean square is below 3 but once in 10^4.
    assert off < 3 * np.sqrt(3) * row.turn_sigma_deg
    # 0.3 pixels of SIFT over some hundred points, and what turn and baseline have in common; 16 degrees lie between.
    assert row.turn_sigma_deg < 0.5
    # How far features are from each other's rays says the direction in which the other camera stands.
    ways = [(rig["cam3"].R @ (rig["cam4"].center - rig["cam3"].center)) / true for rig in (done.cameras, pair)]
    assert np.degrees(np.arccos(ways[0] @ ways[1])) < 2


def test_lenses_of_two_cameras_alone_are_refused_as_uncertain(capture):
    """What two nearly parallel views show fits lenses of any focal length."""
    views = [view for view in capture[1] if view["camera"] in ("cam3", "cam4")]
    distance = {"first": "cam3", "second": "cam4", "metres": 1.0}
    content = {"method": "features", "intrinsics": "estimate", "views": views, "images": FACTS, "distance": distance}
    done = calibrate_from_features(capture[0], content, dict.fromkeys(("cam3", "cam4"), SENSOR), CalibrateCameras(), 2)
    assert [verdict.grade for verdict in done.verdicts] == ["failed", "failed"]
    assert "its focal length is uncertain: give it" in done.verdicts[0].reason


def test_subject_that_stands_still_is_no_more_evidence_when_it_is_photographed_again(planted, tmp_path):
    """Error bars of one moment, and of six at which the same points lie at the same places."""
    names, random, views = ("cam3", "cam4", "cam5"), np.random.default_rng(8), []
    for name in names:
        image, _ = photograph(planted[name], moved(FRAMES[0]))
        for frame in range(6):
            noisy = np.clip(image + random.normal(0, NOISE, image.shape), 0, 1)[..., None]
            write_png(tmp_path / f"{name}_{frame}.png", np.repeat(noisy, 3, 2).astype(np.float32))
            views.append({"camera": name, "view": frame, "path": f"{name}_{frame}.png", "digest": ""})
    write_cameras(tmp_path / "lenses.json", at_sensor({name: planted[name] for name in names}))
    given = {"format": "cameras_json", "path": "lenses.json"}
    content = {"method": "features", "intrinsics": "known", "lenses_from": given, "images": FACTS}
    content["distance"] = {"first": "cam3", "second": "cam5", "metres": 1.0}
    bars = []
    for moments in (1, 6):
        some = {**content, "views": [view for view in views if view["view"] < moments]}
        done = calibrate_from_features(tmp_path, some, dict.fromkeys(names, SENSOR), CalibrateCameras(), 2)
        bars.append(np.sqrt(np.mean(done.pairs.turn_sigma_deg**2)))
    # With six times the points as if each were new, 1 / sqrt(6) = 0.41; both are known to a quarter.
    assert bars[1] > 0.6 * bars[0]


def test_cameras_that_share_nothing_are_named(capture, tmp_path):
    """The outermost two are 112 degrees apart; of the others there are no images."""
    views = [view for view in capture[1] if view["camera"] in ("cam0", "cam7")]
    with pytest.raises(InputError, match=r"camera cam0: expected 30 points .* found none that is alike in another"):
        calibrate(capture, tmp_path, views, distance={"first": "cam0", "second": "cam7", "metres": 1.0})


def test_rig_that_nothing_gives_a_size_is_refused(capture, planted, tmp_path):
    with pytest.raises(InputError, match=r"distance: expected a size of the rig, .* found neither"):
        calibrate(capture, tmp_path)
