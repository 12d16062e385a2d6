"""A copy of the project to run and edit, Snakemake without its start, and stages without theirs."""
