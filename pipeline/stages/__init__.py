"""Stages: file-to-file programs that the rules of the workflow run, one per module.

Nothing else runs them; `pipeline.STAGES` lists them.
"""
