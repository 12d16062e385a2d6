"""The native capture format and everything that reads it."""
