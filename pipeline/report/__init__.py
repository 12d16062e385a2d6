"""Parts of the page that a result is judged by, one module per group of parts."""
