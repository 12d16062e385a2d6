"""Connections of processes that tests start: none may leave this machine."""
