"""Frames, moments in time: what an avatar is given, the light it is in, and what is prepared for all cameras."""
