"""Commands that write the generated parts of the documentation.

`python -m docs.generate` writes the pages of settings, command lines and references, and the flowchart. The table of
results and the pictures come from finished runs; the table of hard cases from `make hard-cases`, and their pictures
from the functions.
"""
