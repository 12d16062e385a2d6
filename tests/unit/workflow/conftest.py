"""A project with one synthetic subject."""

from __future__ import annotations

import pytest
import yaml

from pipeline.config.loading import load_project


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A function: a project whose synthetic subject has 24 frames of 8 cameras and 20 lights, in chunks of 5 frames."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config/subjects").mkdir(parents=True)

    def load(**settings):
        made = {
            "source": "synthetic",
            "chunk_frames": 5,
            "synthesize_capture": {"frames": 24, "cameras": 8, "lights": 20},
            **settings,
        }
        (tmp_path / "config/subjects/someone.yaml").write_text(yaml.safe_dump(made))
        return load_project({}, {}, tmp_path / "config/subjects")

    return load
