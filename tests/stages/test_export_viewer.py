"""The stage from an avatar to a page: what is in it, what is refused, and that the viewer is what its sources build."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.config.export_viewer import ExportViewer
from pipeline.stages import export_viewer
from pipeline.viewer import page as viewer_page
from tests.support.viewer.ball_avatar import BRIGHT, LAMPS, write_ball


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ball")
    return write_ball(folder)


def facts(page: str) -> dict:
    return json.loads(re.search(r'id="facts">(.*?)</script>', page)[1])


def exported(ball, tmp_path, **settings) -> str:
    out = tmp_path / "index.html"
    export_viewer.run(**ball, out=out, subject="ball & floor", settings=ExportViewer(**settings))
    return out.read_text("utf-8")


def test_page_has_all_frames_lights_and_pictures(ball, tmp_path):
    page = exported(ball, tmp_path)
    found = facts(page)
    assert "<title>ball &amp; floor: relit in your browser</title>" in page
    assert [light["name"] for light in found["lights"]] == list(LAMPS)
    assert found["lights"][2]["intensity"] == list(BRIGHT)  # lit in no frame, it is as bright as the others
    assert [frame["frame"] for frame in found["frames"]] == [10, 11]
    assert found["frames"][0]["pattern"] == [[0, *BRIGHT], [1, *BRIGHT]]
    assert [(one["frame"], one["camera"]) for one in found["captured"]] == [
        (10, "cam0"), (10, "cam1"), (11, "cam0"), (11, "cam1"),
    ]  # fmt: skip
    # Shapes are written once: no frame changes them.
    assert re.findall(r'id="(shape-\d)"', page) == ["shape-0"]
    assert "</script>" not in re.search(r'id="facts">(.*?)</script>', page)[1]


def test_page_loads_nothing(ball, tmp_path):
    page = exported(ball, tmp_path)
    markup = re.sub(r"<script.*?</script>|<style.*?</style>", "", page, flags=re.DOTALL)
    assert not re.findall(r'(?:src|href)="[^#"][^"]*"', markup)
    assert "default-src 'none'" in markup


def test_settings_make_the_page_smaller(ball, tmp_path, monkeypatch):
    for module in (export_viewer, viewer_page):  # the page has less than a megabyte: counted by tenths
        monkeypatch.setattr(module, "MEGA", 1e5)
    whole = exported(ball, tmp_path)
    found = facts(exported(ball, tmp_path, timeline_frames=1, captured_cameras=1))
    assert (len(found["frames"]), len(found["captured"])) == (1, 1)
    limit = 0.9 * len(whole) / 1e5
    page = exported(ball, tmp_path, page_mb=limit)
    assert len(facts(page)["frames"]) == 1
    assert len(page) / 1e5 < limit


def test_page_without_room_for_a_frame_is_refused(ball, tmp_path, monkeypatch):
    monkeypatch.setattr(export_viewer, "MEGA", 1e3)
    with pytest.raises(InputError, match=r"--page-mb: expected room for one frame"):
        exported(ball, tmp_path, page_mb=2)


@pytest.mark.parametrize("spec", [{"shading": "transfer"}, {"shading": "combined"}, {"shading": "subsurface"},
                                  {"visibility": "learned"}, {"indirect": "ambient"}])  # fmt: skip
def test_learned_light_is_refused(tmp_path, spec):
    inputs = write_ball(tmp_path, **spec)
    with pytest.raises(InputError, match=r"config\.json: spec: expected Lambert and GGX"):
        export_viewer.run(**inputs, out=tmp_path / "index.html", subject="ball")
    assert not (tmp_path / "index.html").exists()


def test_lights_without_a_place_are_refused(ball, tmp_path):
    write_table(tmp_path / "lights.parquet", read_table(ball["lights"]).assign(x=float("nan")))
    inputs = ball | {"lights": tmp_path / "lights.parquet"}
    with pytest.raises(InputError, match="expected at least one light with a finite position"):
        export_viewer.run(**inputs, out=tmp_path / "index.html", subject="ball")


def test_bundle_is_what_the_sources_build(repo_root, tmp_path):
    if shutil.which("node") is None:
        pytest.skip("no node: the viewer cannot be built here")
    if not (repo_root / "viewer/node_modules/esbuild").is_dir():
        pytest.skip("no viewer/node_modules: make viewer installs esbuild")
    subprocess.run(["node", repo_root / "viewer/build.mjs", tmp_path / "page.html"], check=True, capture_output=True)
    committed = repo_root / "pipeline/viewer/bundle/page.html"
    assert (tmp_path / "page.html").read_text("utf-8") == committed.read_text("utf-8"), "run make viewer"
