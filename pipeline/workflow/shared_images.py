"""Jobs that share the images of a large capture: to check, and to score.

Each handles the images of as few chunks of frames as hold `chunk_images` images, and is named after the first of them.
The stage that one job runs for a small capture joins their tables for a large one. Photographs of the calibration are
shared by camera, see `shared_photographs`.
"""

from __future__ import annotations

from dataclasses import replace

from pipeline.budget.job_size import JobSize
from pipeline.config.flags import flags
from pipeline.config.subjects import chunk_ids, has_few_files
from pipeline.workflow.job_files import JobFiles
from pipeline.workflow.job_size import job_size
from pipeline.workflow.shared_photographs import (
    board_index,
    boards_share_size,
    lights_share_size,
)

SHARES = {
    "inspect_images": "index_capture",
    "find_boards": "calibrate_cameras",
    "measure_lights": "calibrate_lights",
    "score_images": "evaluate_avatar",
}
"""Rules of jobs with a share -> the stage that each runs."""

INSPECTED, SCORES = "inspected/{chunk}.parquet", "scores/{variant}/{chunk}.parquet"
"""Tables of these jobs below the subject's results."""


def chunks_together(files: JobFiles) -> int:
    """Chunks that one of these jobs handles, but for the last."""
    images = files.settings.chunk_frames * job_size(replace(files, chunk=None, variant=None)).cameras
    return -(-files.settings.chunk_images // images)


def first_chunks(files: JobFiles) -> list[str]:
    """First chunk of each of these jobs; none if one job does it all."""
    chunks = chunk_ids(files.project, files.subject)
    firsts = chunks[:: chunks_together(files)] if len(chunks) > 1 else chunks
    return firsts if len(firsts) > 1 else []


def inspected_tables(files: JobFiles) -> list[str]:
    """Tables of inspected images that the index is made of; none if one job inspects all images.

    It also does if the files are watched one by one: each of several jobs would have to be told of all of them.
    """
    if not (firsts := first_chunks(files)):
        return []
    if files.settings.source == "native" and has_few_files(files.project, files.subject):
        return []
    return [files.path(INSPECTED.format(chunk=chunk)) for chunk in firsts]


def score_tables(files: JobFiles) -> list[str]:
    """Tables of scored images of all avatars of the job; none if one job scores all images."""
    firsts = first_chunks(files)
    return [files.path(SCORES.format(variant=name, chunk=chunk)) for name in files.variants for chunk in firsts]


def chunks_of_job(files: JobFiles) -> list[str]:
    """Chunks of the job that is named after its first, the one of `files`."""
    chunks = chunk_ids(files.project, files.subject)
    first = chunks.index(files.chunk)
    return chunks[first : first + chunks_together(files)]


def chunk_words(files: JobFiles) -> list[str]:
    """Words that tell a stage of these chunks."""
    return ["--chunk", str(int(files.chunk)), "--chunks", str(len(chunks_of_job(files)))]


def scored_files(files: JobFiles) -> list[str]:
    """Shards that a job of these reads which scores an avatar."""
    folders = ("shards/test", "shards/validation", *files.frame_folders())
    below = [folder.removeprefix(files.path("")) for folder in folders]
    return [files.path(folder, f"{chunk}.arrow") for folder in below for chunk in chunks_of_job(files)]


def scoring_flags(files: JobFiles) -> list[str]:
    """Settings of the scores alone, as flags.

    Pictures are made, and protocols named, where the tables are joined.
    """
    settings = files.settings.evaluate_avatar
    return flags(settings.model_copy(update={"pictures": False, "intrinsic_layers": False, "protocol": "ours"}))


def share_size(files: JobFiles) -> JobSize:
    """Size of a job that inspects or scores the images of its chunks."""
    size = job_size(files)
    return replace(size, frames=size.frames * len(chunks_of_job(files)))


def size_of_share(rule: str, files: JobFiles) -> JobSize:
    """Size of a job of one of the rules of `SHARES`.

    It is that of the chunk of `files`, or of a share of the cameras.
    """
    whole = replace(files, chunk=None)
    if rule == "find_boards":
        return boards_share_size(whole, board_index(whole))
    return lights_share_size(whole) if rule == "measure_lights" else share_size(files)


def joined_size(files: JobFiles, tables: list[str]) -> JobSize:
    """Size of the job that joins these tables; without, of the one that does it all."""
    size = job_size(files)
    return replace(size, frames=0) if tables else size
