"""Values and places of the patches of charts, from their makers' tables."""

from __future__ import annotations

import numpy as np
import pytest
import skimage.color
from scipy.optimize import linear_sum_assignment

from pipeline.base.color import linear_from_srgb
from pipeline.base.errors import Complaints, InputError
from pipeline.capture.index.patch_tables import linear_from_lab, read_patches_csv
from pipeline.capture.index.validation import index_folder
from pipeline.synthesis.targets import CHART_PATCHES
from tests.support.captures.builder import CAMERAS, build_capture, edit_manifest, write_lines

GRID = [(row, column) for row in (1, 2) for column in (1, 2, 3)]


def read(folder, *lines, illuminant="D50"):
    write_lines(folder / "chart.csv", *lines)
    complaints = Complaints(folder)
    table = read_patches_csv(folder, "chart.csv", illuminant, complaints)
    complaints.raise_if_any()
    return table


def test_lab_under_d65_is_what_scikit_image_makes_of_it():
    random = np.random.default_rng(0)
    linear = random.uniform(0.02, 1, (200, 3))
    lab = skimage.color.rgb2lab(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))
    # Both round the matrix and the white point to seven or five digits.
    np.testing.assert_allclose(linear_from_lab(lab, "D65"), linear, atol=2e-4)


def test_greys_have_the_luminance_of_their_lightness_under_either_light():
    lightness = np.linspace(0, 100, 21)
    lab = np.stack([lightness, 0 * lightness, 0 * lightness], 1)
    luminance = np.where(lightness > 8, ((lightness + 16) / 116) ** 3, lightness * 27 / 24389)
    for illuminant in ("D50", "D65"):
        expected = np.repeat(luminance[:, None], 3, 1)
        np.testing.assert_allclose(linear_from_lab(lab, illuminant), expected, atol=2e-4)


def test_published_lab_of_the_classic_chart_is_its_published_srgb(repo_root, tmp_path):
    """X-Rite's two tables, in print apart from each other: CIELAB under D50, and sRGB of 8 bits, which clips cyan."""
    lines = (repo_root / "config/charts/classic_24.csv").read_text().splitlines()
    table = read(tmp_path, *lines)
    in_gamut = (CHART_PATCHES > 0).all(1)
    assert in_gamut.sum() == 23
    difference = np.abs(
        skimage.color.rgb2lab(_srgb(np.array(table.values))) - skimage.color.rgb2lab(_srgb(CHART_PATCHES))
    )
    # The sRGB table was printed for an earlier edition: a unit of CIELAB in the mean, four at worst.
    assert difference[in_gamut].mean() < 1 and difference[in_gamut].max() < 4


def _srgb(linear):
    clipped = linear.clip(0, 1)
    encoded = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(linear_from_srgb(encoded), clipped, atol=1e-6)
    return encoded


def test_places_begin_at_nought_and_blocks_may_stand_apart(tmp_path):
    rows = [f"{k + 1},{row},{column + (column == 3) * 0.4},0.1,0.2,0.3" for k, (row, column) in enumerate(GRID)]
    table = read(tmp_path, "patch,row,column,r,g,b", *reversed(rows))
    assert table.places == [[0, 0], [1, 0], [2.4, 0], [0, 1], [1, 1], [2.4, 1]]
    assert table.values == [[0.1, 0.2, 0.3]] * 6


def test_chart_without_places_has_24_patches(tmp_path):
    rows = [f"{k + 1},0.1,0.2,0.3" for k in range(6)]
    with pytest.raises(InputError, match=r"patch: expected 1 to 24, each once, found 6 rows.* row and column, from 1"):
        read(tmp_path, "patch,r,g,b", *rows)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("patch,row,column,r,g,b", "1,1,1,0,0,0", "2,1,1,0,0,0", "3,2,2,0,0,0"), "found two in one place"),
        (("patch,row,column,r,g,b", "1,1,1,0,0,0", "2,1,2,0,0,0"), "at least two rows and two columns, found one"),
        (("patch,row,column,L,a,b", "1,1,1,50,0,0", "2,2,2,150,0,0"), "L: expected a lightness, 0 to 100"),
        (("patch,row,column,r,g,b", "1,1,1,0,0,0", "3,2,2,0,0,0"), "patch: expected 1 to 2, each once"),
    ],
)
def test_broken_tables_are_named(tmp_path, lines, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path, *lines)


def test_other_charts_need_their_corners_for_every_camera(tmp_path):
    capture = build_capture(tmp_path / "tiny", measured=True)
    rows = [f"{k + 1},{row},{column},{k / 8},0.2,{0.7 - k / 9:.3f}" for k, (row, column) in enumerate(GRID)]
    write_lines(capture / "calibration/chart/chart.csv", "patch,row,column,r,g,b", *rows)
    corners = [f"{CAMERAS[0]},{corner},{x},{y}" for corner, (x, y) in enumerate([(1, 1), (9, 1), (9, 7), (1, 7)])]
    write_lines(capture / "corners.csv", "camera,corner,x,y", *corners)
    edit_manifest(capture, lambda manifest: manifest["calibration"]["color"].update(corners="corners.csv"))
    with pytest.raises(InputError, match=r"calibration.color.corners: expected where the chart lies, .*none for right"):
        index_folder(capture)
    corners += [line.replace(CAMERAS[0], CAMERAS[1]) for line in corners]
    write_lines(capture / "corners.csv", "camera,corner,x,y", *corners)
    content = index_folder(capture).contents["calibration_color"]
    assert content["places"] == [[float(column - 1), float(row - 1)] for row, column in GRID]


@pytest.mark.parametrize(("edition", "classic"), [("before", "classic_24"), ("after", "classic_24_after_2014")])
def test_middle_of_the_sg_chart_is_the_classic_one(repo_root, tmp_path, edition, classic):
    """Its fifth to tenth columns, second to fifth rows: no other pairing is nearer, though it is glossier."""
    charts = repo_root / "config/charts"
    sg = read(tmp_path, *(charts / f"sg_140_{edition}_2014.csv").read_text().splitlines())
    places = np.array(sg.places)
    assert len(sg.values) == 140 and places.max(0).tolist() == [13, 9]
    middle = ((places >= [4, 1]) & (places <= [9, 4])).all(1)
    own = read(tmp_path, *(charts / f"{classic}.csv").read_text().splitlines())
    labs = [skimage.color.rgb2lab(_srgb(np.array(values))) for values in (np.array(sg.values)[middle], own.values)]
    apart = np.linalg.norm(labs[0][:, None] - labs[1], axis=2)
    assert linear_sum_assignment(apart)[1].tolist() == list(range(24))
