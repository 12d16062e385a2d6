"""Settings for a time budget: committed curves, cost estimates, and the choice among them."""
