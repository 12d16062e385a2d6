"""Light calibration: mirror balls, highlights, positions, intensities, survey, verdicts."""
