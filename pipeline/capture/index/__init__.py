"""The checked index of a capture: tables, images, templates and calibration files, all complaints at once."""
