"""Files that the jobs of a subject read, by configuration and plan.

No stage imports this package: an edit here changes which jobs there are, and never what a stage does. All paths are
relative to the project's folder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from pipeline.base.code_digest import code_digest
from pipeline.base.errors import InputError
from pipeline.config.effects import EFFECTS
from pipeline.config.flags import flags
from pipeline.config.loading import Project
from pipeline.config.project import SubjectSettings
from pipeline.config.sections import has_own_light, section_for
from pipeline.config.stage_commands import subject_files
from pipeline.config.subjects import chunk_ids, dataset_files, require_subject, subject_names, watched_files

RESULTS = "results"

OPTIONAL_OF_PROJECT = ("hard_cases.csv", "effects_comparison.csv", "scaling/*", "growth/*")
OPTIONAL_OF_SUBJECT = (
    "accuracy_cost.*", "error_budget/*", "calibration/review/*.png", "tracking/review/*.png", "relit/*/*/stills/*.png",
    "verdicts_eyes.csv", "verdicts_gaze.csv",
)  # fmt: skip
"""What a report shows if it is there: below the project's results, and below the subject's."""


@dataclass(frozen=True)
class JobFiles:
    """Files of a job.

    Attributes:
        project: the validated configuration.
        subject: whose results the job belongs to.
        variant: the avatar, if the job is for one; else it is for all.
        chunk: the chunk of frames, if the job is for one; else it is for all.
    """

    project: Project
    subject: str
    variant: str | None = None
    chunk: str | None = None

    def __post_init__(self) -> None:
        """Refuse what the configuration does not have.

        Raises:
            InputError: if the subject has no such variant, or no such chunk of frames.
        """
        variants = self.project.subjects.get(self.subject, self.project.settings).variants
        if self.variant is not None and self.variant not in variants:
            raise InputError(
                f"{self.subject}: variant {self.variant!r}: expected one of {', '.join(variants)}, found no such; "
                f"write it below `variants` in config/subjects/{self.subject}.yaml"
            )
        if self.chunk is not None and self.chunk not in (known := chunk_ids(self.project, self.subject)):
            raise InputError(
                f"{self.subject}: chunk {self.chunk!r}: expected 0000 to {known[-1]} "
                f"({self.settings.chunk_frames} frames each), found no such"
            )

    @property
    def settings(self) -> SubjectSettings:
        """The settings of the subject."""
        return self.project.subject(self.subject)

    @property
    def variants(self) -> list[str]:
        """The avatar of the job, or all of the subject's, in their order."""
        return list(self.settings.variants) if self.variant is None else [self.variant]

    @property
    def chunks(self) -> list[str]:
        """The chunk of the job, or all of the subject's."""
        return chunk_ids(self.project, self.subject) if self.chunk is None else [self.chunk]

    @property
    def capture(self) -> str:
        """The folder of the capture."""
        return os.path.join(os.path.normpath(self.project.settings.captures), self.subject)

    def path(self, *parts: str) -> str:
        """A path below the subject's results."""
        return "/".join((RESULTS, self.subject, *parts))

    def named(self) -> dict[str, str]:
        """Files, and words about the job, by the names of `pipeline.config.stage_commands`."""
        words = {"subject": self.subject, "chunk_size": str(self.settings.chunk_frames), "project_results": RESULTS}
        given = {name: value for name, value in (("chunk", self.chunk), ("variant", self.variant)) if value is not None}
        files = subject_files(f"{RESULTS}/{self.subject}", self.chunk, self.variant)
        return {**files, **words, **given, "capture": self.capture}

    def flags(self, stage: str) -> list[str]:
        """A stage's settings as flags."""
        return flags(section_for(self.settings, stage, self.variant))

    def capture_files(self) -> list[str]:
        """Files whose content decides whether the capture is indexed anew.

        Raises:
            InputError: if nothing is known of this subject.
        """
        require_subject(self.project, self.subject)
        return watched_files(self.project, self.subject)

    def capture_origin(self) -> list[str]:
        """Code digest and settings that make a synthetic capture; else nothing.

        Its files are not watched. Those of an imported one are known by the digest in its capture.yaml.
        """
        if self.subject not in self.project.synthetic_subjects:
            return []
        return [code_digest("pipeline.stages.synthesize_capture"), *self.flags("synthesize_capture")]

    def dataset_files(self) -> list[str]:
        """Files of the set that the capture is imported from, and those that the settings name."""
        chosen = self.settings.import_capture
        named = [chosen.topology, chosen.mesh, chosen.light_patterns]
        return [*dataset_files(self.project, self.subject), *filter(None, named)]

    def each_chunk(self, pattern: str) -> list[str]:
        """Files of the job's chunks; {chunk} in a path below the subject's results is filled in."""
        return [self.path(pattern.format(chunk=chunk)) for chunk in self.chunks]

    def shards(self, folder: str) -> list[str]:
        """Shards of all chunks in a folder below the subject's results.

        Raises:
            InputError: if other shards are there: stages read whole folders.
        """
        expected = self.each_chunk(f"{folder}/{{chunk}}.arrow")
        stale = sorted({str(path) for path in Path(self.path(folder)).glob("[!.]*.arrow")} - set(expected))
        if stale:
            raise InputError(f"stale files, left over from other chunks of frames, delete: {' '.join(stale)}")
        return expected

    def frame_folders(self) -> list[str]:
        """Folder of each variant's frame shards.

        It is its own, if it asks for other irradiance maps than its subject.
        """
        return [self.path(self._frame_folder(variant)) for variant in self.variants]

    def frame_shards(self) -> list[str]:
        """All files of these folders."""
        folders = dict.fromkeys(self._frame_folder(variant) for variant in self.variants)
        return [file for folder in folders for file in self.shards(folder)]

    def _frame_folder(self, variant: str) -> str:
        return f"variants/{variant}/frames" if has_own_light(self.settings, variant) else "shards/frames"

    def traced_irradiance(self, planned: Collection[str], kind: str) -> list[str]:
        """Tables of the chunks' irradiance maps, where they are needed.

        They are if the capture needs shadows and an avatar of the job learns them.

        A table holds the digests of the maps and stands for their folder, whose content Snakemake cannot compare.

        Args:
            planned: effects that plan_effects turned on.
            kind: of the capture, body or head.
        """
        trained = [section_for(self.settings, "train_avatar", variant) for variant in self.variants]
        if not any(settings.reads_irradiance(planned, kind) for settings in trained):
            return []
        own = "" if self.variant is None else f"variants/{self.variant}/"
        return self.each_chunk(f"{own}irradiance/{{chunk}}.parquet")

    def mean_textures(self, kind: str) -> list[str]:
        """Mean textures of the chunks, if an avatar of the job is encoded from them.

        None of a body is.
        """
        trained = [section_for(self.settings, "train_avatar", variant) for variant in self.variants]
        read = any(settings.reads_textures(kind) for settings in trained)
        return self.each_chunk("textures/{chunk}.safetensors") if read else []

    def fitted_eyes(self, planned: Collection[str]) -> list[str]:
        """The file of a variant's explicit eyes, if it has any."""
        settings = section_for(self.settings, "train_avatar", self.variant)
        return [self.path("eyes.json")] if settings.reads_eyes(planned) else []

    def estimated_gaze(self, capture: str | Path) -> list[str]:
        """The table of gaze from images, for a capture that lists eyes and declares no gaze.

        Args:
            capture: capture.json of index_capture.
        """
        described = json.loads(Path(capture).read_text())
        lacking = described.get("template", {}).get("eyes") and not described.get("gaze", True)
        return [self.path("gaze.parquet")] if lacking and self.settings.estimate_gaze.mode == "auto" else []

    def given_geometry(self) -> list[str]:
        """Files of the avatar whose geometry the variant takes over, if it does."""
        source = section_for(self.settings, "train_avatar", self.variant).geometry_from
        return [self.path("avatars", source, file) for file in ("avatar.safetensors", "config.json") if source]

    def avatars(self, file: str = "") -> list[str]:
        """A file of each avatar of the job, or the avatars' folders."""
        return [self.path("avatars", variant, *filter(None, [file])) for variant in self.variants]

    def driving_tables(self) -> list[str]:
        """Tables of codes and gaze that the settings of relight_avatar name."""
        settings = section_for(self.settings, "relight_avatar", self.variant)
        return [path for path in (settings.codes, settings.gaze) if path]

    def captured_shards(self) -> list[str]:
        """Shards of captured pictures, if relight_avatar shows them beside its own."""
        if not section_for(self.settings, "relight_avatar", self.variant).beside_captured:
            return []
        return [file for split in ("train", "validation", "test") for file in self.shards(f"shards/{split}")]

    def score_pictures(self) -> list[str]:
        """The folder of pictures of evaluate_avatar, unless its setting turns them off."""
        return [self.path("images")] if self.settings.evaluate_avatar.pictures else []

    def optional_digests(self) -> dict[str, str]:
        """SHA-256 of each file that the report shows if it is there.

        A change to one writes the report anew and makes no other.
        """
        places = [(RESULTS, OPTIONAL_OF_PROJECT), (self.path(), OPTIONAL_OF_SUBJECT)]
        found = [path for folder, patterns in places for each in patterns for path in sorted(Path(folder).glob(each))]
        return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in found if path.is_file()}


def compared_scores(project: Project) -> list[str]:
    """Scores of every image of the subjects that compare_subjects compares."""
    subjects = project.settings.compare_subjects.subjects or subject_names(project)
    return [JobFiles(project, subject).path("metrics_per_image.parquet") for subject in subjects]


def read_planned(path: str | Path) -> list[str]:
    """Effects that are on, of effects.json of plan_effects."""
    effects = json.loads(Path(path).read_text())
    return [name for name in EFFECTS if effects.get(name, {}).get("on")]


def read_kind(path: str | Path) -> str:
    """Kind of a capture, body or head, from capture.json of index_capture."""
    return json.loads(Path(path).read_text())["kind"]
