"""Camera calibration: boards found in images, a rig that starts camera by camera, bundle adjustment, verdicts."""
