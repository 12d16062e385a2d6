"""The stages: what the rules of the workflow run, one file-to-file program per module, in no other place."""
