"""Two-sphere eyes: their shape, and the fit to tracked eyeballs."""
