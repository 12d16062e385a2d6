"""Stages: file-to-file programs that the rules of the workflow run, one per module.

Nothing else runs them; `pipeline.STAGES` lists them. `python -m pipeline.stages.STAGE` comes here first, before the
stage imports what it works with: with `--help` it ends here.
"""

from pathlib import Path

from pipeline.base.stage_help import answer_help
from pipeline.base.start_up import end_by_interrupts, pause_collection, use_one_blas_thread

use_one_blas_thread()
pause_collection()
end_by_interrupts()
answer_help(Path(__file__).parent)
