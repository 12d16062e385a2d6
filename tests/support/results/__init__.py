"""Results made by hand (`curve_files`, `reported_results`), and the table of hard cases.

`hard_case` is the row that a hard case fills, and the plugin that gathers the table.
"""
