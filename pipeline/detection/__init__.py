"""Landmarks and masks of photographs, by other programs and by clean plates."""
