"""The parts of the report: what stands on the page that a result is judged by, one module per group of parts."""
