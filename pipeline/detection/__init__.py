"""Landmarks and masks of photographs by programs of other environments, and masks by clean plates."""
