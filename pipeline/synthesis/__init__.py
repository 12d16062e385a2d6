"""A procedural subject in a procedural light stage, path-traced into a native capture with known truth.

Used by the stage `synthesize_capture` only: no other package may import it, so that truth never leaks into the
pipeline. Shading is Mitsuba's, posing is this package's own, so that both are independent of the code they test.
"""
