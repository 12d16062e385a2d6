"""Say how many decibels each input costs.

First all inputs are true, then ours take their place, one after the other. For captures with a truth, as synthesised
ones have. For each step the images are packed, an avatar is trained and scored anew, with the subject's settings: the
last step is what the workflow has. What the workflow derived from its own tracking stays: the plan of effects, mean
textures and eyes of heads, irradiance maps of avatars that learn shadows. Out: error_budget.csv, a row per step, and
error_budget.png.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from pipeline.base.command import run_as_command
from pipeline.base.errors import Complaints, InputError
from pipeline.base.files import read_table, write_table
from pipeline.base.splits import VALIDATION
from pipeline.config.budget_errors import RETRAINED_STAGES, BudgetErrors, Part
from pipeline.config.stage_commands import Value
from pipeline.config.stage_settings import read_stage_settings
from pipeline.dials.subject import Subject
from pipeline.dials.true_inputs import TRUTH, Inputs
from pipeline.metrics.evaluation import LIT
from pipeline.metrics.measured_run import run_measured

log = logging.getLogger("budget_errors")


def run(
    *, results: Path, capture: Path, out: Path, threads: int = 1, chunk_size: int = 64, variant: str = "full",
    stage_settings: str = "{}", settings: BudgetErrors = BudgetErrors(),
) -> None:  # fmt: skip
    """Train on true inputs, and on ours in the place of one after the other.

    Args:
        results: the subject's results, results/SUBJECT.
        capture: folder of the capture; the truth is its folder truth.
        out: folder to write error_budget.csv and error_budget.png to.
        threads: that each stage may use.
        chunk_size: frames per chunk; the capture has one chunk.
        variant: the avatar's name.
        stage_settings: JSON, what differs from the stages' defaults: {"train_avatar": {"steps": 600}}.
        settings: see the flags below.
    """
    subject = Subject(
        results.resolve(), capture.resolve(), threads, chunk_size, read_stage_settings(stage_settings), variant=variant
    )
    require_truth(subject, settings.parts)
    rows = []
    with tempfile.TemporaryDirectory(prefix="budget_errors_") as name:
        for place in range(len(settings.parts) + 1):
            ours, true = settings.parts[:place], settings.parts[place:]
            scores = train_on(subject, true, Path(name) / str(place))
            rows.append({"step": f"our {ours[-1]}" if ours else "all true", "true": " ".join(true), **scores})
            log.info("%s: %s", rows[-1]["step"], ", ".join(f"{key} {value:.2f}" for key, value in scores.items()))
    table = pd.DataFrame(rows)
    write_table(out / "error_budget.csv", table)
    from pipeline.figures.waterfall import draw_waterfall  # Matplotlib, once there is something to draw.

    draw_waterfall(out / "error_budget.png", table, results.name)


def require_truth(subject: Subject, parts: Sequence[Part]) -> None:
    """Refuse captures whose truth is not known, or that have several chunks.

    Raises:
        InputError: naming every file that is not there.
    """
    complaints = Complaints(f"{subject.capture}/truth")
    for name in dict.fromkeys([TRUTH["cameras"], *(TRUTH[part] for part in parts)]):
        if not (subject.capture / "truth" / name).is_file():
            complaints.add("truth", name, expected="the truth, as synthesised captures know it", found="no such file")
    complaints.raise_if_any()
    frames = len(read_table(subject.results / "frames.parquet"))
    if frames > subject.chunk_size:
        expected = f"at most chunk_frames, {subject.chunk_size}, as one chunk is trained on"
        raise InputError(f"{subject.results}/frames.parquet: frames: expected {expected}, found {frames}")


def train_on(subject: Subject, true: Sequence[Part], folder: Path) -> dict[str, float]:
    """PSNR of an avatar for which some inputs are true.

    It is that of validation images, and of test images by their light.
    """
    inputs = Inputs.of(subject)
    own: dict[str, Value] = {part: str(inputs.write(part, folder / "true")) for part in true}
    own |= {"shards": str(folder / "shards"), "scores": str(folder)}
    own["avatar"] = str(folder / f"avatars/{subject.variant}")
    if not Path(str(subject.named()["irradiance"])).exists():
        own["irradiance"] = ()  # no avatar of the subject reads it
    for stage in RETRAINED_STAGES:
        change = {"pictures": False} if stage == "evaluate_avatar" else {}
        run_measured(subject.command_line(stage, change, own)).require_success()
    scores = pd.read_csv(folder / "metrics.csv").set_index(["split", "lit"]).psnr_db
    return {"validation_db": scores[VALIDATION, "all"], **{f"test_{lit}_db": scores["test", lit] for lit in LIT}}


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
