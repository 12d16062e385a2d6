"""Networks of pose, expression, view, light and shadow."""
