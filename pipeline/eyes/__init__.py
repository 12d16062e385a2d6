"""Two-sphere eyes: `eye_shape`, `eye_fit`, `eye_pixels`, `gaze_estimate`, `eye_verdicts`."""
