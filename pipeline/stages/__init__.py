"""Stages: file-to-file programs that the rules of the workflow run, one per module.

Nothing else runs them; `pipeline.STAGES` lists them. `python -m pipeline.stages.STAGE --help` ends here, before the
stage imports what it works with.
"""

from pathlib import Path

from pipeline.base.stage_help import answer_help

answer_help(Path(__file__).parent)
