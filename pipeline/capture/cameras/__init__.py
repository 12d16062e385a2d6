"""Cameras calibrated elsewhere, in the formats that `file_formats` lists."""
