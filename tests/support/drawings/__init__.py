"""Drawn calibration images with planted truth, each with the capture that a stage reads.

- `balls`: mirror balls before lights; `boards`: ChArUco boards before cameras; `chart`: a colour chart.
"""
