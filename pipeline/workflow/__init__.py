"""Files and words that the rules of the workflow ask for; Snakemake is not known here."""
