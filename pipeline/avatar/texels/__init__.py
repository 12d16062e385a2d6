"""Texels of the atlas: their parameters, and where a posed mesh puts them."""
