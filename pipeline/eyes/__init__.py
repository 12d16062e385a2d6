"""Two-sphere eyes: their geometry, `eye_shape`, their fit, `eye_fit`, and `eye_verdicts`."""
