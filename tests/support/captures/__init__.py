"""Captures in files: `builder` writes a tiny valid one, `broken` breaks it; `posed` and `walking` write indices."""
