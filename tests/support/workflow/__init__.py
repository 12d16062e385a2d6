"""A copy of the project to run and edit (`project_copy`), and Snakemake without its start (`snakemake_server`)."""
