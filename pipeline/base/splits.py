"""Names of the splits of a capture's images: for training, for choices, for scores."""

from __future__ import annotations

TEST_FLAGS = ("test_camera", "test_frame", "test_segment", "test_pattern")
"""Reasons why an image is held out for testing."""

VALIDATION_FLAGS = ("validation_camera", "validation_frame", "validation_pattern")
"""Reasons why an image is held out for validation, where none of `TEST_FLAGS` is true."""

VALIDATION = "validation"
"""Split, and flag of an image, on which settings and models are chosen; it neither trains nor tests."""
