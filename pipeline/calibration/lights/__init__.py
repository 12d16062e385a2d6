"""Light calibration: mirror balls and their highlights, positions, intensities, verdicts."""
