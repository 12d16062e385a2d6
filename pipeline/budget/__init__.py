"""Costs of jobs by size, committed curves, and the choice of settings for a budget."""
