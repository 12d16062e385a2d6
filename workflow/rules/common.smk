# What the stages' rules share: the validated configuration, and functions of wildcards.
import json
import os
import re
import sys
from pathlib import Path

from pipeline.base.code_digest import code_digest
from pipeline.base.errors import InputError
from pipeline.config.effects import EFFECTS
from pipeline.config.flags import flags
from pipeline.config.loading import load_project, section_of
from pipeline.config.subjects import (
    chunk_ids,
    require_subject,
    subject_names,
    watched_files,
)

# Stages run under the Python that runs Snakemake, whether or not its environment is activated.
os.environ.update(PATH=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
# Snakemake tells the linear algebra libraries how many threads a job has; numba has its own word for it. Threads that
# wait must sleep: spinning, they slow training ten times as soon as another process wants a core. Memory that was given
# back is kept for the next array: fetching it from the system anew costs as much as filling it.
shell.prefix(
    "export NUMBA_NUM_THREADS=$OMP_NUM_THREADS OMP_WAIT_POLICY=passive"
    " MALLOC_MMAP_THRESHOLD_=33554432 MALLOC_TRIM_THRESHOLD_=1073741824; "
)


def validated_project():
    """The configuration; what is wrong with it is said without a traceback."""
    try:
        return load_project(config, workflow.config_settings.overwrite_config, Path("config/subjects"))
    except InputError as error:
        raise WorkflowError(str(error))


project = validated_project()
captures = os.path.normpath(project.settings.captures)


def code_of(stage):
    """Digest of all code that a stage can run: an edit to it reruns the stage."""
    return code_digest(f"pipeline.{stage}")


def settings_of(stage):
    """A function of wildcards: the flags with a stage's settings."""
    return lambda wildcards: stage_flags(stage, wildcards.subject, wildcards.get("variant"))


def stage_flags(stage, subject, variant=None):
    return flags(section_of(project.subject(subject), stage, variant))


def capture_folder(wildcards):
    return os.path.join(captures, wildcards.subject)


def capture_files(wildcards):
    require_subject(project, wildcards.subject)
    return watched_files(project, wildcards.subject)


def origin_of_capture(wildcards):
    """What decides the content of a synthetic capture, whose files are not watched; nothing for a recorded one."""
    if wildcards.subject not in project.synthetic_subjects:
        return []
    return [
        code_of("synthesize_capture"),
        *stage_flags("synthesize_capture", wildcards.subject),
    ]


def chunk_size(wildcards):
    return project.subject(wildcards.subject).chunk_frames


def of_chunks(*patterns):
    """A function of wildcards: files of all chunks of a subject."""
    return lambda wildcards: expand(patterns, subject=wildcards.subject, chunk=chunk_ids(project, wildcards.subject))


def shards_of(split):
    """A function of wildcards: a split's shards. The stages read whole folders, so strangers in them are refused."""

    def files(wildcards):
        expected = of_chunks(f"results/{{subject}}/shards/{split}/{{chunk}}.arrow")(wildcards)
        present = Path(f"results/{wildcards.subject}/shards/{split}").glob("*.arrow")
        strangers = sorted({str(path) for path in present} - set(expected))
        if strangers:
            raise WorkflowError(f"left over from other chunks of frames, delete: {' '.join(strangers)}")
        return expected

    return files


def traced_irradiance(wildcards):
    """The table of a chunk's irradiance maps, if plan_effects found that this capture needs shadows and an avatar learns
    them. It holds the maps' digests and stands for their folder, whose content Snakemake cannot compare."""
    path = checkpoints.plan_effects.get(subject=wildcards.subject).output.effects
    effects = json.loads(Path(path).read_text())
    planned = [name for name in EFFECTS if effects.get(name, {}).get("on")]
    subject = project.subject(wildcards.subject)
    read = any(section_of(subject, "train_avatar", variant).reads_irradiance(planned) for variant in subject.variants)
    return [f"results/{wildcards.subject}/irradiance/{wildcards.chunk}.parquet"] if read else []


def avatars_of(*files):
    """A function of wildcards: files of all variants of a subject's avatar."""
    return lambda wildcards: expand(
        "results/{subject}/avatars/{variant}/{file}",
        subject=wildcards.subject,
        variant=project.subject(wildcards.subject).variants,
        file=files,
    )


LIGHT_KINDS = {".hdr": "environment", ".exr": "environment", ".csv": "lights", ".json": "lights"}


def light_file(wildcards):
    """The panorama or list of lights of that name in config/lights."""
    found = [path for kind in LIGHT_KINDS if (path := Path(f"config/lights/{wildcards.light}{kind}")).is_file()]
    if len(found) != 1:
        raise WorkflowError(
            f"config/lights: expected one file named {wildcards.light} with the suffix {', '.join(LIGHT_KINDS)}; "
            f"found {len(found)}"
        )
    return str(found[0])
