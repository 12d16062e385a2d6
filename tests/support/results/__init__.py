"""Results made by hand: `curve_files`, `reported_results` of subjects, and `hard_case`, the table of errors."""
