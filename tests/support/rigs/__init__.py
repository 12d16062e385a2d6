"""Rigs with planted truth: `cameras`, `camera_files` of other programs, a `light_stage` and its log of patterns."""
