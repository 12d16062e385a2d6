"""Primitives that an avatar is made of: how they are placed, drawn, and how far away a pixel's surface is."""
