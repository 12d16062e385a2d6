# What the stages' rules share: the validated configuration, and functions of wildcards.
import functools
import os
import shutil
import sys
import time
from pathlib import Path

from snakemake.exceptions import IncompleteCheckpointException
from snakemake.logging import logger

from pipeline.base.code_digest import code_digest
from pipeline.base.errors import InputError
from pipeline.budget.resolved_project import resolve_budgets
from pipeline.config.flags import flags
from pipeline.config.loading import load_project
from pipeline.config.stage_commands import stage_arguments
from pipeline.config.subjects import subject_names
from pipeline.config.write_report import subject_changes
from pipeline.workflow.dead_runs import remove_dead_locks
from pipeline.workflow.detected_files import detected_keypoints, detected_masks
from pipeline.workflow.job_files import RESULTS, JobFiles, compared_scores, read_kind, read_planned
from pipeline.workflow.job_requests import memory_mb, minutes, request_words, useful_threads
from pipeline.workflow.job_size import job_size, unknown_size
from pipeline.workflow.object_storage import local_copies, require_own_captures, start_in
from pipeline.workflow.rule_words import LIGHT_KINDS, estimate_json, light_file, one_of, subject_pattern
from pipeline.workflow.shared_images import (
    chunk_words,
    inspected_tables,
    joined_size,
    score_tables,
    scored_files,
    scoring_flags,
    share_size,
)
from pipeline.workflow.shared_photographs import (
    boards_joined_size,
    boards_share_size,
    found_boards,
    lights_joined_size,
    lights_share_size,
    measured_lights,
)
from pipeline.workflow.shown_verdicts import shown_verdicts
from pipeline.workflow.termination import pass_signals_on

STARTED = time.time()

# Where files of object storage lie on this machine while a job works with them; None where all is in one file system.
copies = local_copies(workflow)

# Stages run under the Python that runs Snakemake, whether or not its environment is activated.
os.environ.update(PATH=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
# Snakemake tells the linear algebra libraries how many threads a job has; numba has its own word for it. Threads that
# wait must sleep: spinning, they slow training ten times as soon as another process wants a core. Memory that was given
# back is kept for the next array: fetching it from the system anew costs as much as filling it.
shell.prefix(
    "trap : TERM INT; export NUMBA_NUM_THREADS=$OMP_NUM_THREADS OMP_WAIT_POLICY=passive"
    " MALLOC_MMAP_THRESHOLD_=33554432 MALLOC_TRIM_THRESHOLD_=1073741824; " + (start_in(copies) if copies else "")
)


if workflow.is_main_process and remove_dead_locks(Path(".snakemake")):
    logger.info("A run was killed, and what it had locked is free again.")


# After Snakemake has set its own handlers.
onstart:
    pass_signals_on()


onsuccess:
    judged, amiss = shown_verdicts(Path(RESULTS), STARTED)
    for line in judged:
        logger.info(line)
    for line in amiss:
        logger.warning(line)


def validated_project():
    """The configuration; what is wrong with it is said without a traceback."""
    try:
        loaded = load_project(config, workflow.config_settings.overwrite_config, Path("config/subjects"))
        require_own_captures(os.path.normpath(loaded.settings.captures), copies)
        return resolve_budgets(loaded, logger.info)
    except InputError as error:
        raise WorkflowError(str(error))


project = validated_project()
MAKES_CAPTURE = ("synthesize_capture", "import_capture")
captures = os.path.normpath(project.settings.captures)


def job(wildcards):
    """The files of a job, as the configuration asks for them."""
    return JobFiles(project, wildcards.subject, wildcards.get("variant"), wildcards.get("chunk"))


@functools.cache
def capture_files(subject):
    """Files whose content decides whether the capture is checked anew; looked for once, for all jobs that check it.

    In object storage the capture is one thing, its folder, and is fetched as a whole.
    """
    return [JobFiles(project, subject).capture] if copies else JobFiles(project, subject).capture_files()


def stored_capture(wildcards):
    """The capture, for stages that read of it more than they declare; nothing where all is in one file system.

    Asks for an import in any case: if that leaves all as it was, Snakemake looks again at those jobs alone that waited
    for it, and would run all others.
    """
    imported(wildcards)
    return [job(wildcards).capture] if copies else []


def captured(pattern):
    """Declared output of what makes a capture, which is its description or, in object storage, all of it."""
    return directory(os.path.dirname(pattern)) if copies else pattern


def fetched(file):
    """The path of a checkpoint's output, which is fetched if it lies in object storage."""
    with file.open():
        return file


def code_for(stage):
    """A function of wildcards: the digest of all code that a stage can run; an edit to it reruns the stage.

    A function, so that only the code of planned jobs is read: a cluster's job plans itself alone.
    """
    return lambda wildcards: code_digest(f"pipeline.stages.{stage}")


def size_of(wildcards):
    """Sizes of a job, by which it asks for threads, memory and time."""
    return job_size(job(wildcards)) if "subject" in wildcards.keys() else unknown_size()


def size_of_share(wildcards):
    """Sizes of a job that inspects or scores a share of the images."""
    return share_size(job(wildcards))


def size_by_boards(size):
    """A function of wildcards: sizes of a job by the photographs of boards; before there is an index, of all the work.

    Snakemake has no answer for resources that a checkpoint decides.
    """

    def sizes(wildcards):
        try:
            return size(job(wildcards), indexed_boards(wildcards))
        except IncompleteCheckpointException:
            return size_of(wildcards)

    return sizes


def size_of_lights_share(wildcards):
    """Sizes of a job that measures photographs of mirror balls of some cameras."""
    return lights_share_size(job(wildcards))


def size_joining_lights(wildcards):
    """Sizes of the job that fits lights to them."""
    return lights_joined_size(job(wildcards))


def size_joining(tables):
    """A function of wildcards: sizes of a job that joins such tables, or does without them what they are made for."""
    return lambda wildcards: joined_size(job(wildcards), tables(job(wildcards)))


def threads_for(stage):
    """A function of wildcards: the threads that a stage can use; Snakemake takes at most --cores and --max-threads."""
    return lambda wildcards: useful_threads(stage, size_of(wildcards))


def memory_for(stage, size=size_of):
    """A function of wildcards: megabytes that a stage asks for, more at each attempt."""
    return lambda wildcards, threads, attempt: memory_mb(stage, size(wildcards), threads, attempt)


def minutes_for(stage, size=size_of):
    """A function of wildcards: minutes that a stage asks for, more at each attempt."""
    return lambda wildcards, threads, attempt: minutes(stage, size(wildcards), threads, attempt)


def all_cores(wildcards):
    """All that one job may have: of this machine, or, on a cluster, of a node."""
    granted = workflow.resource_settings
    return granted.max_threads or granted.cores or 1


def settings_for(stage):
    """A function of wildcards: the flags with a stage's settings."""
    return lambda wildcards: job(wildcards).flags(stage)


def arguments_for(stage, **own):
    """A function of wildcards: all other words of a stage's command line but for threads and the capture's folder.

    `own` are functions of wildcards for values that are not those of `JobFiles.named`, by the name that
    `pipeline.config.stage_commands` has for them.
    """

    def words(wildcards):
        shared = job(wildcards).named() if "subject" in wildcards.keys() else {}
        values = {name: value(wildcards) for name, value in own.items()}
        # Those that write it: another folder is another output.
        return stage_arguments(stage, {**shared, **({} if stage in MAKES_CAPTURE else {"capture": []}), **values})

    return words


def arguments_with_input(stage, own, **read):
    """The same for a command line that follows the rule's input: `read` are functions of that.

    Snakemake reruns nothing for such a parameter; `named` beside it stands for the rest.
    """

    def words(wildcards, input):
        values = {name: (lambda wildcards, found=value(input): found) for name, value in read.items()}
        return arguments_for(stage, **own, **values)(wildcards)

    return words


def named(wildcards):
    """What a command line names of a job, but for the capture's folder."""
    return {name: value for name, value in job(wildcards).named().items() if name != "capture"}


def capture_folder(wildcards, input):
    """Where the capture lies.

    A function of the input, for which Snakemake reruns nothing: what a capture holds counts, by its digests in the
    index, and not where it was moved to.
    """
    return job(wildcards).capture


def training_scratch(wildcards, input):
    """The flag that says where training may put what it would else make again; for the same reason a function of it."""
    return ["--scratch", project.settings.training_scratch] if project.settings.training_scratch else []


def resources_of_nodes():
    """What a training on several nodes asks for: one task on each, which the job itself starts, by srun."""
    nodes = project.settings.training_nodes
    if nodes == 1:
        return {"launcher": ""}
    if shutil.which("srun") is None:
        raise WorkflowError(
            f"configuration: training_nodes: expected 1 where there is no Slurm, found {nodes} and no srun"
        )
    on_each = f"srun --nodes={nodes} --ntasks={nodes} --ntasks-per-node=1 --kill-on-bad-exit=1"
    launcher = lambda wildcards, threads: f"{on_each} --cpus-per-task={threads}"
    return {"nodes": nodes, "tasks": nodes, "mpi": "srun", "launcher": launcher}


def traced_maps(input):
    """The folder of maps beside each of their tables."""
    return [table.removesuffix(".parquet") for table in input.irradiance]


def captured_folder(wildcards):
    """The folder of the shards, if captured pictures are shown."""
    return job(wildcards).path("shards") if job(wildcards).captured_shards() else []


def light_as(kind):
    """A function of wildcards: the file of the light, if it is of that kind."""

    def file(wildcards):
        found = light_file(wildcards.light)
        return found if LIGHT_KINDS[Path(found).suffix] == kind else []

    return file


def each_chunk(pattern):
    """A function of wildcards: files of all chunks, by their path below the subject's results."""
    return lambda wildcards: job(wildcards).each_chunk(pattern)


def of_goliath(path):
    """A function of wildcards: a file that Goliath's layout alone holds; none of the other layouts."""
    return lambda wildcards: [path.format(subject=wildcards.subject)] if wildcards.layout == "goliath" else []


def tracking_of_layout(pattern):
    """A function of wildcards: files of all chunks of tracked meshes, which Goliath's layout alone holds."""
    return lambda wildcards: job(wildcards).each_chunk(pattern) if wildcards.layout == "goliath" else []


def imported(wildcards):
    """Wait for the import of a capture that is imported first."""
    if wildcards.subject in project.imported_subjects:
        checkpoints.import_capture.get(subject=wildcards.subject)


def indexed(wildcards):
    """Output of index_capture.

    Checkpoints are asked in their order, the earliest first. If it leaves all as it was, Snakemake runs none of the later
    ones, and asks again what a job has to wait for; of a job that has named a later one from the start it would never
    look at settings and code again.
    """
    imported(wildcards)
    return checkpoints.index_capture.get(subject=wildcards.subject).output


def planned_effects(wildcards):
    """The effects that plan_effects turned on."""
    indexed(wildcards)
    return read_planned(fetched(checkpoints.plan_effects.get(subject=wildcards.subject).output.effects))


def capture_kind(wildcards):
    """What a capture is of, body or head."""
    return read_kind(fetched(indexed(wildcards).capture))


def indexed_boards(wildcards):
    """What the index says about photographs of boards, which decides how many jobs look at them."""
    return fetched(indexed(wildcards).calibration_cameras)


def board_tables(wildcards):
    """Tables of boards that are found in photographs of some cameras."""
    return found_boards(job(wildcards), indexed_boards(wildcards))


def estimated_gaze(wildcards):
    """The table of gaze from images, where the capture declares none."""
    return job(wildcards).estimated_gaze(fetched(indexed(wildcards).capture))


def stored_maps(wildcards):
    """Folders of irradiance maps, which their tables stand for where all is in one file system."""
    return [table.removesuffix(".parquet") for table in traced_irradiance(wildcards)] if copies else []


def traced_irradiance(wildcards):
    planned = planned_effects(wildcards)
    return job(wildcards).traced_irradiance(planned, capture_kind(wildcards))


def inspected_images(wildcards):
    """Tables of inspected images; of a capture that is imported first, its size is not known before."""
    imported(wildcards)
    return inspected_tables(job(wildcards))


def mean_textures(wildcards):
    return job(wildcards).mean_textures(capture_kind(wildcards))


def fitted_eyes(wildcards):
    return job(wildcards).fitted_eyes(planned_effects(wildcards))
