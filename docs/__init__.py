"""The documentation: pages in Markdown, built by `make docs`, and `docs.generate`, which writes what is generated."""
