"""Choices that variants of an avatar differ in, and how settings and effects decide them."""
