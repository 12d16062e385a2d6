"""Colour calibration: the chart found in an image, the 3x3 matrix it gives, verdicts."""
