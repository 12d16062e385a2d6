# What the stages' rules share: the validated configuration, and functions of wildcards.
import hashlib
import json
import os
import re
import sys
from pathlib import Path

from snakemake.logging import logger

from pipeline.base.code_digest import code_digest
from pipeline.base.errors import InputError
from pipeline.budget.resolved_project import with_budgets
from pipeline.config.effects import EFFECTS
from pipeline.config.flags import flags
from pipeline.config.loading import has_own_light, load_project, section_of
from pipeline.config.subjects import (
    chunk_ids,
    require_subject,
    subject_names,
    watched_files,
)
from pipeline.config.write_report import subject_changes

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
        loaded = load_project(config, workflow.config_settings.overwrite_config, Path("config/subjects"))
        return with_budgets(loaded, logger.info)
    except InputError as error:
        raise WorkflowError(str(error))


project = validated_project()
captures = os.path.normpath(project.settings.captures)


def code_of(stage):
    """Digest of all code that a stage can run: an edit to it reruns the stage."""
    return code_digest(f"pipeline.stages.{stage}")


def settings_of(stage):
    """A function of wildcards: the flags with a stage's settings."""
    return lambda wildcards: stage_flags(stage, wildcards.subject, wildcards.get("variant"))


def stage_flags(stage, subject, variant=None):
    return flags(section_of(project.subject(subject), stage, variant))


def launcher(processes):
    """How a module is started in so many processes. It stands among the resources, which rerun nothing: their number
    changes nothing but the order of sums."""
    return "python" if processes == 1 else f"torchrun --standalone --nproc_per_node {processes}"


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
    """A function of wildcards: a split's shards."""
    return lambda wildcards: shards_in(f"results/{wildcards.subject}/shards/{split}", wildcards)


def shards_in(folder, wildcards):
    """The shards of a folder. The stages read whole folders, so strangers in them are refused."""
    expected = of_chunks(f"{folder}/{{chunk}}.arrow")(wildcards)
    strangers = sorted({str(path) for path in Path(folder).glob("*.arrow")} - set(expected))
    if strangers:
        raise WorkflowError(f"left over from other chunks of frames, delete: {' '.join(strangers)}")
    return expected


def frames_folder(subject, variant):
    """Where the frame shards of a variant lie: its own, if it asks for other irradiance maps than its subject."""
    own = has_own_light(project.subject(subject), variant)
    return f"results/{subject}/variants/{variant}/frames" if own else f"results/{subject}/shards/frames"


def frame_folders(wildcards):
    """The folders of the frame shards of a variant; without one, of all variants, in their order."""
    variants = [wildcards.variant] if "variant" in wildcards.keys() else project.subject(wildcards.subject).variants
    return [frames_folder(wildcards.subject, variant) for variant in variants]


def frame_shards(wildcards):
    """All files of these folders."""
    return [file for folder in dict.fromkeys(frame_folders(wildcards)) for file in shards_in(folder, wildcards)]


def kind_of(subject):
    """What a capture is of, body or head."""
    return json.loads(Path(checkpoints.index_capture.get(subject=subject).output.capture).read_text())["kind"]


def planned_effects(wildcards):
    """The effects that plan_effects turned on."""
    path = checkpoints.plan_effects.get(subject=wildcards.subject).output.effects
    effects = json.loads(Path(path).read_text())
    return [name for name in EFFECTS if effects.get(name, {}).get("on")]


def traced_irradiance(wildcards):
    """The table of a chunk's irradiance maps, if plan_effects found that this capture needs shadows and an avatar learns
    them. It holds the maps' digests and stands for their folder, whose content Snakemake cannot compare."""
    planned = planned_effects(wildcards)
    subject = project.subject(wildcards.subject)
    is_own = "variant" in wildcards.keys()
    variants = [wildcards.variant] if is_own else subject.variants
    kind = kind_of(wildcards.subject)
    read = any(section_of(subject, "train_avatar", variant).reads_irradiance(planned, kind) for variant in variants)
    own = f"variants/{wildcards.variant}/" if is_own else ""
    return [f"results/{wildcards.subject}/{own}irradiance/{wildcards.chunk}.parquet"] if read else []


def first_avatar(wildcards):
    """The avatar of a subject's first variant: what is relit where one will do."""
    variant = next(iter(project.subject(wildcards.subject).variants))
    return f"results/{wildcards.subject}/avatars/{variant}/avatar.safetensors"


def promise_of_budget(wildcards):
    """JSON of what the budget of a subject is expected to buy."""
    promise = project.promise(wildcards.subject)
    if promise is None:
        raise WorkflowError(f"results/{wildcards.subject}/budget.csv: expected a budget: --config budget_minutes=10")
    return json.dumps(promise.as_json())


def mean_textures(wildcards):
    """Mean textures of a chunk or, without one, of all, if an avatar is encoded from them: not if all are of bodies."""
    subject, kind = project.subject(wildcards.subject), kind_of(wildcards.subject)
    variants = [wildcards.variant] if "variant" in wildcards.keys() else subject.variants
    read = any(section_of(subject, "train_avatar", variant).reads_textures(kind) for variant in variants)
    chunks = [wildcards.chunk] if "chunk" in wildcards.keys() else chunk_ids(project, wildcards.subject)
    return [f"results/{wildcards.subject}/textures/{chunk}.safetensors" for chunk in chunks] if read else []


def fitted_eyes(wildcards):
    """The file of a variant's explicit eyes, if it has any."""
    settings = section_of(project.subject(wildcards.subject), "train_avatar", wildcards.variant)
    return [f"results/{wildcards.subject}/eyes.json"] if settings.reads_eyes(planned_effects(wildcards)) else []


def avatars_of(*files):
    """A function of wildcards: files of all variants of a subject's avatar."""
    return lambda wildcards: expand(
        "results/{subject}/avatars/{variant}/{file}",
        subject=wildcards.subject,
        variant=project.subject(wildcards.subject).variants,
        file=files,
    )


def drive_tables(wildcards):
    """The tables of codes and gaze that the settings name."""
    settings = section_of(project.subject(wildcards.subject), "relight_avatar", wildcards.variant)
    return [path for path in (settings.codes, settings.gaze) if path]


def pictures_of_scores(wildcards):
    """The folder of pictures of evaluate_avatar, unless its setting turns them off."""
    shown = project.subject(wildcards.subject).evaluate_avatar.pictures
    return [f"results/{wildcards.subject}/images"] if shown else []


def subjects_that(asked):
    """A pattern of the names of the subjects whose settings, before a budget changes any, a function finds true; those
    without a file have the project's."""
    chosen = [name for name, settings in project.subjects.items() if asked(settings)]
    if asked(project.settings):
        chosen.append(f"(?!(?:{'|'.join(project.subjects) or NO_NAME})/)[A-Za-z0-9_-]+")
    return "|".join(chosen) or NO_NAME


NO_NAME = "(?!)"
"""A pattern that nothing matches."""

PROJECT_RESULTS = "results"
OF_NO_SUBJECT = ["hard_cases.csv", "effects_comparison.csv", "growth/*"]
OPTIONAL = [
    "accuracy_cost.*",
    "calibration/review/*.png",
    "tracking/review/*.png",
    "relit/*/*/stills/*.png",
]
"""What a subject's report shows if it is there: below the project's results, and below the subject's."""


def digests_of_optional(wildcards):
    """Of each file that the report shows if it is there: a change to one writes the report anew, and makes no other."""
    places = [(Path(PROJECT_RESULTS), OF_NO_SUBJECT), (Path(PROJECT_RESULTS, wildcards.subject), OPTIONAL)]
    found = [path for folder, patterns in places for pattern in patterns for path in sorted(folder.glob(pattern))]
    contents = {str(path): path.read_bytes() for path in found if path.is_file()}
    return {path: hashlib.sha256(content).hexdigest() for path, content in contents.items()}


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
