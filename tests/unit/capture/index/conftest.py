"""Tiny whole captures; tests break copies of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.captures.builder import build_capture


@pytest.fixture(scope="session")
def known(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Calibrated elsewhere."""
    return build_capture(tmp_path_factory.mktemp("known") / "tiny")


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With images to calibrate it by."""
    return build_capture(tmp_path_factory.mktemp("measured") / "tiny", measured=True)
