"""Two-sphere eyes: `eye_shape` is their geometry, `eye_fit` fits it to tracked eyeballs."""
