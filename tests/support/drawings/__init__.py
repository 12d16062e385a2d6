"""Drawn calibration images with planted truth: mirror `balls`, ChArUco `boards`, a colour `chart`."""
