"""Settings for a time budget: what jobs take by their size, committed curves, estimates, and the choice among them."""
