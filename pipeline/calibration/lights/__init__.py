"""Light calibration: mirror balls and their highlights, light positions and intensities, verdicts."""
