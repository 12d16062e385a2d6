"""Captures in files, small enough for a test.

- `builder` writes a tiny valid capture without the code that reads it; `broken` breaks it in named ways.
- `posed` and `walking` write the index of a posed body and of a walking figure, for the stages that read one.
- `synthesized` makes a small capture by synthesize_capture and reads its truth.
"""
