"""Commands that write the generated parts of the documentation; `python -m docs.generate` runs those that need no results.

Pages of settings and command lines come from the code, the table of results and the pictures from finished results.
"""
