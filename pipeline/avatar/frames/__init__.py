"""Frames, moments in time: their inputs, their light, and what all cameras share."""
