"""Commands that write the generated parts of the documentation.

`python -m docs.generate` writes the pages of settings, command lines and references, and the flowchart. The table of
results and the pictures come from finished runs.
"""
