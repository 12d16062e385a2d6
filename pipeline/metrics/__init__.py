"""Image metrics with their protocol spelled out."""
