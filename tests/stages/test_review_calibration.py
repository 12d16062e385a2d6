"""The stage on a small calibration written by hand: two cameras, one ball, three lights, one board, two charts."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pandas as pd
import pytest
import scipy.spatial.transform
from matplotlib.patches import Circle, Ellipse

from pipeline.base.color import linear_from_srgb
from pipeline.base.errors import InputError
from pipeline.base.exr import write_exr
from pipeline.base.files import write_json, write_table
from pipeline.config.review_calibration import ReviewCalibration
from pipeline.figures.style import GRADE_COLORS
from pipeline.geometry.cameras import Camera, write_cameras
from pipeline.stages.review_calibration import run
from tests.support.figures.kept_figures import kept_figures, panel_named, points

SIZE, FOCAL, DISTANCE, RADIUS = 240, 360.0, 2.2, 0.18
DISC_PX = FOCAL * RADIUS / np.sqrt(DISTANCE**2 - RADIUS**2)
LIGHTS = {"L1": (1.0, 2.0, 0.0), "L2": (-1.0, 1.5, 0.5), "L3": (0.0, -1.0, 2.0)}
PICTURES = {"rig", "corners", "coverage", "residuals", "balls", "charts", "residual_histogram"}
VERDICTS = {
    "cameras": [("camera", "east", "good", "0.05 px"), ("camera", "west", "weak", "few views")],
    "lights": [
        ("ball", "top", "good", "2 cameras"),
        ("light", "L1", "good", ""),
        ("light", "L2", "good", ""),
        ("light", "L3", "failed", "dead"),
    ],
    "color": [("color", "east", "good", ""), ("color", "west", "good", "")],
}
CORNERS = ["camera", "view", "board", "corner", "x", "y", "residual_x", "residual_y", "weight"]
HIGHLIGHTS = ["light", "position", "camera", "x", "y", "residual_x", "residual_y", "weight"]
SQUARE = [f"{axis}{corner}" for corner in range(4) for axis in "xy"]
PATCHES = ["camera", "patch", *"rgb", *(f"residual_{c}" for c in "rgb"), "weight", "used", *SQUARE]


def cameras():
    found = {}
    for name, angle in (("east", 0.0), ("west", 1.5)):
        R = scipy.spatial.transform.Rotation.from_euler("XY", [np.pi, angle]).as_matrix()
        K = np.array([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
        found[name] = Camera(R, np.array([0.0, 0.0, DISTANCE]), K, np.zeros(5), SIZE, SIZE)
    return found


def write_capture(folder, methods=("charuco", "mirror_ball", "chart")):
    """Capture, index and calibration; what `methods` leaves out is known or absent."""
    rng, index, out = np.random.default_rng(0), folder / "index", folder / "calibration"
    measured = [method not in ("known", "none") for method in methods]
    write_json(index / "capture.json", {"subject": "small", "images": {"black_level": 0.0}})
    write_cameras(out / "cameras.json", cameras())
    survey = pd.DataFrame([(name, *place) for name, place in LIGHTS.items()], columns=["light", "x", "y", "z"])
    write_table(index / "lights.parquet", survey)
    variance = [1e-5, 0.0, 0.0, 1e-5, 0.0, 1e-5] if measured[1] else [np.nan] * 6
    upper = dict(zip(["cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz"], variance, strict=True))
    lights = survey.assign(**upper)
    lights.loc[2, list(upper)] = np.nan
    write_table(out / "lights.parquet", lights)
    write_boards(folder, methods[0], rng)
    write_balls(folder, methods[1], rng)
    write_charts(folder, methods[2], rng)
    for (part, rows), there in zip(VERDICTS.items(), measured, strict=True):
        table = pd.DataFrame(rows if there else [], columns=["kind", "name", "grade", "reason"])
        write_table(out / f"verdicts_{part}.csv", table)
    return {"capture": folder, "index": index, "calibration": out, "out": folder / "out"}


def write_boards(folder, method, rng):
    corners, views = [], []
    for name in cameras():
        for view in (0, 4):
            views.append({"camera": name, "view": view, "path": f"{name}_{view}.png"})
            cv2.imwrite(str(folder / f"{name}_{view}.png"), rng.integers(0, 255, (SIZE, SIZE), dtype=np.uint8))
            noise = rng.normal(0, 0.05, (12, 2))
            places = rng.uniform(20, SIZE - 20, (12, 2))
            corners += [(name, view, 0, k, *places[k], *noise[k], 0.9) for k in range(12)]
    there = method == "charuco"
    write_json(folder / "index/calibration_cameras.json", {"method": method, "views": views if there else []})
    table = pd.DataFrame(corners if there else [], columns=CORNERS)
    write_table(folder / "calibration/residuals_cameras.parquet", table)


def write_balls(folder, method, rng):
    silhouettes, images, highlights = [], [], []
    for name in cameras():
        backdrop = np.full((SIZE, SIZE), 200, np.uint8)
        cv2.circle(backdrop, (SIZE * 8 - 8, SIZE * 8 - 8), round(DISC_PX * 16), 20, cv2.FILLED, cv2.LINE_AA, 4)
        cv2.imwrite(str(folder / f"{name}_ball.png"), backdrop)
        silhouettes.append({"position": "top", "camera": name, "path": f"{name}_ball.png"})
        for light in LIGHTS:
            lit = np.full((SIZE, SIZE), 5, np.uint8)
            x, y = SIZE // 2 + rng.integers(-15, 15, 2)
            lit[y, x] = 250
            cv2.imwrite(str(folder / f"{name}_{light}.png"), lit)
            images.append({"position": "top", "camera": name, "light": light, "path": f"{name}_{light}.png"})
            highlights.append((light, "top", name, x + 0.5, y + 0.5, *rng.normal(0, 0.1, 2), 0.05))
    there = method == "mirror_ball"
    content = (
        {"images": images, "silhouettes": silhouettes, "radius_m": RADIUS}
        if there
        else {"images": [], "silhouettes": []}
    )
    write_json(folder / "index/calibration_lights.json", {"method": method, **content})
    table = pd.DataFrame(highlights if there else [], columns=HIGHLIGHTS)
    write_table(folder / "calibration/residuals_lights.parquet", table)


def write_charts(folder, method, rng):
    rows, matrices = [], {}
    for name, gain in (("east", 0.9), ("west", 1.1)):
        image, colors = np.zeros((100, 140, 3), np.float32), rng.uniform(0.1, 0.8, (24, 3))
        for k, color in enumerate(colors):
            x, y = 10 + 20 * (k % 6), 10 + 20 * (k // 6)
            image[y : y + 16, x : x + 16] = gain * color
            square = (x + 4, y + 4, x + 12, y + 4, x + 12, y + 12, x + 4, y + 12)
            rows.append((name, k + 1, *(gain * color), 0.001, -0.002, 0.003, 0.8, True, *square))
        write_exr(folder / f"{name}.exr", image)
        matrices[name] = (np.eye(3) / gain).tolist()
    there = method == "chart"
    images = [{"camera": name, "path": f"{name}.exr"} for name in matrices]
    content = {"method": method, "transfer": "linear", "images": images}
    write_json(folder / "index/calibration_color.json", content if there else {"method": "none", "images": []})
    write_json(folder / "calibration/color.json", {"cameras": matrices})
    write_table(folder / "calibration/residuals_color.parquet", pd.DataFrame(rows if there else [], columns=PATCHES))


@pytest.fixture(scope="module")
def reviewed_and_drawn(tmp_path_factory):
    paths = write_capture(tmp_path_factory.mktemp("small"))
    with kept_figures() as figures:
        run(**paths, threads=2)
    return paths, figures


@pytest.fixture(scope="module")
def reviewed(reviewed_and_drawn):
    return reviewed_and_drawn[0]


@pytest.fixture(scope="module")
def drawn(reviewed_and_drawn):
    """Figures, by the names of their files."""
    return reviewed_and_drawn[1]


def offsets(axes, number):
    """Places of the marks that were drawn as the n-th collection."""
    return np.asarray(axes.collections[number].get_offsets())


def test_every_picture_is_there_and_on_the_page(reviewed):
    folder = reviewed["out"] / "review"
    assert {path.stem for path in folder.glob("*.png")} == PICTURES
    page = (folder / "index.html").read_text()
    assert {f"{name}.png" for name in PICTURES} == set(re.findall(r'src="([^"]+)"', page))
    assert "few views" in page


def test_lights_stand_where_they_were_measured_in_the_colour_of_their_verdict(drawn):
    above, side = drawn["rig.png"].axes[:2]
    for axes, depth in ((above, 2), (side, 1)):
        marks = {tuple(line.get_xydata()[0]): line for line in axes.get_lines()}
        assert marks.keys() == {(place[0], place[depth]) for place in LIGHTS.values()}
        for name, place in LIGHTS.items():
            grade = "failed" if name == "L3" else "good"
            assert marks[place[0], place[depth]].get_color() == GRADE_COLORS[grade]
    # Where 95 % would lie is not drawn: an ellipse is one sigma in each direction, enlarged for all alike.
    sizes = [patch.width for patch in above.patches if isinstance(patch, Ellipse) and not isinstance(patch, Circle)]
    assert sizes == pytest.approx([2 * 20 * np.sqrt(1e-5)] * 2)


def test_corners_are_marked_where_they_were_detected_and_projected(reviewed, drawn):
    corners = pd.read_parquet(reviewed["calibration"] / "residuals_cameras.parquet")
    error = np.hypot(corners.residual_x, corners.residual_y)
    for name in cameras():
        rows = corners[corners.camera == name]
        worst = (error[rows.index] ** 2).groupby(rows["view"]).mean().idxmax()
        axes = panel_named(drawn["corners.png"], name)
        assert any(f"view {worst}, 12 corners" in text.get_text() for text in axes.texts)
        seen = rows[rows["view"] == worst]
        np.testing.assert_allclose(offsets(axes, 0), seen[["x", "y"]], atol=1e-9)
        moved = seen[["x", "y"]].to_numpy() + seen[["residual_x", "residual_y"]].to_numpy()
        np.testing.assert_allclose(offsets(axes, 2), moved, atol=1e-9)
        covered = points(panel_named(drawn["coverage.png"], name))
        np.testing.assert_allclose(covered, rows[["x", "y"]], atol=1e-9)


def test_arrows_are_residuals_and_alike_enlarged_in_all_panels(reviewed, drawn):
    corners = pd.read_parquet(reviewed["calibration"] / "residuals_cameras.parquet")
    factors = []
    for name in cameras():
        rows, arrows = corners[corners.camera == name], panel_named(drawn["residuals.png"], name).collections[0]
        np.testing.assert_allclose(arrows.get_offsets(), rows[["x", "y"]], atol=1e-9)
        factors += [arrows.U / rows.residual_x, arrows.V / rows.residual_y]
    np.testing.assert_allclose(factors, np.full((4, 24), np.mean(factors)), rtol=1e-9)
    assert np.mean(factors) > 1


def test_highlights_and_outline_are_marked_on_the_ball(reviewed, drawn):
    highlights = pd.read_parquet(reviewed["calibration"] / "residuals_lights.parquet")
    for name in cameras():
        axes, rows = panel_named(drawn["balls.png"], name), highlights[highlights.camera == name]
        np.testing.assert_allclose(offsets(axes, 1), rows[["x", "y"]], atol=1e-9)
        moved = rows[["x", "y"]].to_numpy() + rows[["residual_x", "residual_y"]].to_numpy()
        np.testing.assert_allclose(offsets(axes, 2), moved, atol=1e-9)
        # A disc in the middle, as large as its pixels are dark.
        drawn_ball = cv2.imread(str(reviewed["capture"] / f"{name}_ball.png"), cv2.IMREAD_GRAYSCALE).astype(float)
        radius = np.sqrt(((200 - drawn_ball) / 180).sum() / np.pi)
        np.testing.assert_allclose(np.linalg.norm(points(axes) - SIZE / 2, axis=1), radius, atol=0.3)


def test_charts_are_shown_as_recorded_and_corrected_by_the_cameras_matrix(drawn):
    for name, gain in (("east", 0.9), ("west", 1.1)):
        recorded, corrected = (
            np.asarray(image.get_array(), np.float64) for image in panel_named(drawn["charts.png"], name).images
        )
        inside = (corrected > 0.05) & (np.maximum(recorded, corrected) < 0.98)
        ratio = linear_from_srgb(recorded[inside]) / linear_from_srgb(corrected[inside])
        np.testing.assert_allclose(ratio, gain, rtol=1e-5)


def test_histograms_hold_every_residual_once(drawn):
    counts = {"board corners": 96, "highlights in balls": 12, "chart patches": 144}
    for name, count in counts.items():
        axes = panel_named(drawn["residual_histogram.png"], f"{name}: {count} numbers")
        (steps,) = axes.patches
        density, edges, _ = steps.get_data()
        assert (density * np.diff(edges)).sum() == pytest.approx(1.0)


def test_residuals_are_predicted_minus_observed_one_row_per_observation(reviewed):
    table = pd.read_parquet(reviewed["out"] / "residuals.parquet")
    assert table.kind.value_counts().to_dict() == {"corner": 48, "highlight": 6, "patch": 48}
    corners = pd.read_parquet(reviewed["calibration"] / "residuals_cameras.parquet")
    row = table[(table.kind == "corner") & (table.camera == "west") & (table.name == "4/0/7")].iloc[0]
    source = corners[(corners.camera == "west") & (corners["view"] == 4) & (corners.corner == 7)].iloc[0]
    assert (row.x, row.y, row.residual_x, row.residual_y) == (source.x, source.y, source.residual_x, source.residual_y)
    assert set(table[table.kind == "highlight"].name) == {"L1/top", "L2/top", "L3/top"}
    patches = table[table.kind == "patch"]
    # The colour stage writes observed minus fitted.
    assert (patches[["residual_r", "residual_g", "residual_b"]] == [-0.001, 0.002, -0.003]).all(axis=None)
    assert patches.residual_x.isna().all() and set(patches.unit) == {"full scale"}
    first = patches[(patches.camera == "east") & (patches.name == "1")].iloc[0]
    assert (first.x, first.y) == (18, 18)


def test_verdicts_of_all_stages_are_one_table_and_in_the_log(reviewed, tmp_path, caplog):
    table = pd.read_csv(reviewed["out"] / "verdicts.csv", keep_default_na=False)
    assert [tuple(row) for row in table.itertuples(index=False)] == [row for rows in VERDICTS.values() for row in rows]
    with caplog.at_level("INFO"):
        run(**{**reviewed, "out": tmp_path})
    assert "camera west: weak: few views" in caplog.text
    assert "6 good, 1 weak, 1 failed" in caplog.text
    # The same calibration gives the same bytes, however many threads read images.
    for path in reviewed["out"].rglob("*.*"):
        assert path.read_bytes() == (tmp_path / path.relative_to(reviewed["out"])).read_bytes(), path.name


def test_only_the_worst_are_shown_of_many(reviewed, tmp_path):
    with kept_figures() as figures:
        run(**{**reviewed, "out": tmp_path}, settings=ReviewCalibration(most_panels=1, lit_images=1))
    (axes,) = figures["corners.png"].axes
    assert panel_named(figures["corners.png"], "west: weak") is axes
    assert {path.stem for path in (tmp_path / "review").glob("*.png")} == PICTURES


def test_what_was_not_measured_is_left_out_and_the_page_says_why(tmp_path):
    paths = write_capture(tmp_path, ("known", "known", "none"))
    run(**paths)
    folder = paths["out"] / "review"
    assert {path.stem for path in folder.glob("*.png")} == {"rig"}
    page = (folder / "index.html").read_text()
    assert page.count("method is known") == 2 and "method is none" in page and "no residuals" in page
    table = pd.read_parquet(paths["out"] / "residuals.parquet")
    assert len(table) == 0 and table.x.dtype == np.float64


def test_known_lights_beside_a_chart(tmp_path):
    paths = write_capture(tmp_path, ("known", "known", "chart"))
    run(**paths)
    assert {path.stem for path in (paths["out"] / "review").glob("*.png")} == {"rig", "charts", "residual_histogram"}


def test_missing_verdicts_are_named(tmp_path):
    paths = write_capture(tmp_path)
    (paths["calibration"] / "verdicts_lights.csv").unlink()
    with pytest.raises(InputError, match=r"verdicts_lights.csv: expected a table of verdicts, found"):
        run(**paths)
    assert not paths["out"].exists()
