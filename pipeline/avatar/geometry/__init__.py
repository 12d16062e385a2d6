"""Primitives of an avatar: placing them, drawing them, and the depth of their pixels."""
