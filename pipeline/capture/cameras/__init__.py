"""Cameras calibrated elsewhere: COLMAP, nerfstudio and this project's own format."""
