"""Camera calibration from boards: detection, start, bundle adjustment, verdicts."""
