"""Captures under constant light are not relit."""

from __future__ import annotations

import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.lighting.changing_light import require_changing_light
from pipeline.stages import export_viewer, relight_avatar


def test_constant_light_is_refused_and_other_captures_are_not(tmp_path):
    for content in ({"constant_light": False}, {}):
        write_json(tmp_path / "capture.json", content)
        require_changing_light(tmp_path)
    require_changing_light(None)
    require_changing_light(tmp_path / "absent")
    write_json(tmp_path / "capture.json", {"constant_light": True})
    with pytest.raises(InputError, match=r"capture\.json: constant_light: expected .* known and change"):
        require_changing_light(tmp_path)


def test_films_and_pages_ask_before_they_read_anything_else(tmp_path):
    write_json(tmp_path / "capture.json", {"constant_light": True})
    given = {"atlas": tmp_path / "none", "avatar": tmp_path / "none", "out": tmp_path / "out", "index": tmp_path}
    with pytest.raises(InputError, match="constant_light"):
        relight_avatar.run(**given, lights=tmp_path / "none.csv")
    shards = {"shards": tmp_path / "none", "lights": tmp_path / "none", "patterns": tmp_path / "none"}
    with pytest.raises(InputError, match="constant_light"):
        export_viewer.run(**given, **shards, subject="x")
