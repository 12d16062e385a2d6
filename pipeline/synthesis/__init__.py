"""Synthetic captures with known truth: a procedural subject in a light stage, path-traced.

Used by the stage `synthesize_capture` only: no other package may import it, so that truth never leaks into the
pipeline. Shading is Mitsuba's, posing is this package's own, so that both are independent of the code they test.
"""
