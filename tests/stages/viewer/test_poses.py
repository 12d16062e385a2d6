"""Sliders of a head in the page that relights it: poses between their stops, against the pipeline's own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.capture.shards import read_frame_shards
from pipeline.config.export_viewer import ExportViewer
from pipeline.stages import export_viewer
from pipeline.viewer.head_poses import GAZE_DEGREES, HeadPose, head_sliders
from pipeline.viewer.packing import LEVELS
from pipeline.viewer.shown_frame import shown_frame
from tests.support.viewer.ball_avatar import LAMPS
from tests.support.viewer.eyes_head import write_head
from tests.support.viewer.relit_page import SETTLED, open_page

EYE_M = 0.015
"""Radius of the largest of the eyeballs, 12 mm made 15 % larger by the mean expression, and what floats above it."""

ROUNDING_M = 2 * 0.3 / LEVELS
"""Two roundings to 16 bits over a box of less than 0.3 m, at the stops and between them: half a level each, and as much
again for the box itself."""

TABLES = """() => ({
  means: Array.from(scene.frame.means), place: Array.from(scene.frame.place), hits: scene.frame.hits.length,
  starts: scene.frame.starts.at(-1), seen: Array.from(scene.frame.seen) })"""


@pytest.fixture(scope="module")
def head(tmp_path_factory):
    folder = tmp_path_factory.mktemp("head")
    inputs = write_head(folder)
    settings = ExportViewer(timeline_frames=4, code_axes=1, slider_steps=3)
    export_viewer.run(**inputs, out=folder / "head.html", subject="eyes", settings=settings)
    loaded = load_avatar(inputs["avatar"], inputs["atlas"])
    records = read_frame_shards([inputs["shards"] / "frames"])
    return folder / "head.html", loaded, [records[number] for number in sorted(records)]


@pytest.fixture(scope="module")
def page(browser, head):
    page = browser.new_page(viewport={"width": 640, "height": 400})
    assert open_page(page, head[0]) == "open"
    return page


def shown(page, *values: str) -> dict[str, np.ndarray]:
    """Tables of the page once its sliders stand at these."""
    for k, value in enumerate(values):
        page.locator("#head-sliders input").nth(k).fill(value)
    page.evaluate(SETTLED)
    return {name: np.array(value) for name, value in page.evaluate(TABLES).items()}


def pipeline_pose(loaded, records, expression: int, across: float, up: float) -> HeadPose:
    """The pose of an expression's half steps from -2 to 2, and of eyes turned by degrees, as the pipeline places it."""
    pose = head_sliders(loaded, records, axes=1, steps=5)[0].poses[expression + 2]
    turn = Rotation.from_euler("Y", across, degrees=True) * Rotation.from_euler("X", up, degrees=True)
    return replace(pose, record=replace(pose.record, gaze=turn.apply(pose.record.gaze).astype(np.float32)))


def farthest_m(across: float, up: float) -> float:
    """How far a sum of two turns is from one after the other, each a share of one to its end.

    A chord is below its arc by the cosine of half the angle between stops, and turns about two axes do not commute, by
    the product of their sines.
    """
    sums = 0.0
    for degrees, (_, end) in zip((across, up), GAZE_DEGREES.values(), strict=True):
        sums += 0.0 if abs(degrees) in (0.0, end) else 1 - math.cos(math.radians(end / 2))
    return EYE_M * (sums + math.sin(math.radians(abs(across))) * math.sin(math.radians(abs(up))))


@pytest.mark.parametrize(
    ("expression", "across", "up"),
    [(2, 0, 0), (1, 0, 0), (0, -24, 0), (0, 12, 0), (0, 0, -7), (1, 12, 7), (-2, -24, 14)],
)
def test_sliders_together_are_the_pipelines_pose(head, page, expression, across, up):
    """At stops as it was placed; between them, and together, as near as sums of turns can be."""
    _, loaded, records = head
    expected = pipeline_pose(loaded, records, expression, across, up)
    lights = np.array(list(LAMPS.values()))
    truth = shown_frame(loaded, expected.record, lights, expected.code)
    means = truth.low + (truth.high - truth.low) * truth.place[:, :3] / LEVELS
    found = shown(page, str(expression), str(across), str(up))
    moved = np.linalg.norm(found["means"].reshape(-1, 3) - means, axis=1)
    assert moved.max() < ROUNDING_M + farthest_m(across, up)
    q, p = (place.reshape(-1, 8)[:, 4:] / (LEVELS / 2) - 1 for place in (found["place"], truth.place))
    turns = 4 * np.arcsin(np.minimum(np.linalg.norm(q - p, axis=1), np.linalg.norm(q + p, axis=1)) / 2)
    assert np.degrees(turns).max() < 0.1 + np.degrees(farthest_m(across, up) / EYE_M)
    assert found["hits"] == found["starts"]


def test_shadows_of_a_stop_are_kept_up_to_half_way(head, page):
    """Visibility is not blended: it is that of the nearest stop."""
    rest, near, half, end = (shown(page, value, "0", "0")["seen"] for value in ("0", "0.9", "1", "2"))
    np.testing.assert_array_equal(rest, near)
    np.testing.assert_array_equal(half, end)
