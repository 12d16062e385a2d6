"""Cameras, lights and colour: what calibration images say of the stage."""
