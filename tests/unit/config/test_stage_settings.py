"""Settings of stages that other stages run, as one word."""

from __future__ import annotations

import json

from pipeline.config.project import SubjectSettings
from pipeline.config.stage_settings import changed_settings


def test_setting_that_is_said_but_is_the_default_is_no_change() -> None:
    """The configuration says all of them; a rerun, and a report, is for what differs."""
    default = SubjectSettings().track_mesh.model_dump()
    said = SubjectSettings(track_mesh={**default, "outline_rounds": default["outline_rounds"] + 1})
    assert json.loads(changed_settings(said, ["track_mesh", "pack_shards"])) == {
        "track_mesh": {"outline_rounds": default["outline_rounds"] + 1}, "pack_shards": {},
    }  # fmt: skip
