"""The whole configuration: one section per stage, and what belongs to no stage.

`config/config.yaml` holds the defaults, generated from here (`python -m pipeline.config.schema`);
`config/subjects/<name>.yaml` changes them for one subject, the command line for one run.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, StringConstraints, field_validator
from pydantic_core import PydanticCustomError

from pipeline import STAGES
from pipeline.config.bake_textures import BakeTextures
from pipeline.config.book_patterns import BookPatterns
from pipeline.config.budget_errors import BudgetErrors
from pipeline.config.calibrate_cameras import CalibrateCameras
from pipeline.config.calibrate_color import CalibrateColor
from pipeline.config.calibrate_lights import CalibrateLights
from pipeline.config.check_budget import CheckBudget
from pipeline.config.compare_subjects import CompareSubjects
from pipeline.config.datasets import DATASETS
from pipeline.config.detect_landmarks import DetectLandmarks
from pipeline.config.estimate_gaze import EstimateGaze
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.config.export_avatar import ExportAvatar
from pipeline.config.export_capture import ExportCapture
from pipeline.config.export_viewer import ExportViewer
from pipeline.config.fit_eyes import FitEyes
from pipeline.config.import_capture import ImportCapture
from pipeline.config.index_capture import IndexCapture
from pipeline.config.measure_cost import MeasureCost
from pipeline.config.pack_shards import PackShards
from pipeline.config.plan_effects import PlanEffects
from pipeline.config.relight_avatar import RelightAvatar
from pipeline.config.review_calibration import ReviewCalibration
from pipeline.config.review_tracking import ReviewTracking
from pipeline.config.segment_subject import SegmentSubject
from pipeline.config.settings import Settings
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.config.track_mesh import TrackMesh
from pipeline.config.train_avatar import TrainAvatar
from pipeline.config.unwrap_atlas import UnwrapAtlas
from pipeline.config.write_report import WriteReport

NAME_PATTERN = "[A-Za-z0-9_][A-Za-z0-9_-]*"
"""What subjects and variants may be called: they become folder names, wildcards and words of command lines."""

Name = Annotated[str, StringConstraints(pattern=f"^{NAME_PATTERN}$")]


class SubjectSettings(Settings):
    """Settings of one subject: all that may stand in config/subjects/<name>.yaml."""

    source: Literal["native", "synthetic", *DATASETS] = Field(
        "native",
        description="native: a recorded capture folder; synthetic: synthesize_capture makes it; else the public set "
        "that `path` holds and import_capture reads",
    )
    path: str = Field("", description="folder of one capture of a public set, as it ships; nothing is written there")
    chunk_frames: int = Field(64, ge=1, le=9999, description="frames that one job handles together [frames]")
    chunk_images: int = Field(
        4096,
        ge=1,
        description="images that one job checks, finds boards or measures mirror balls in, or scores of, at least: for "
        "larger captures several jobs do, each for some chunks of frames, or some cameras; changes no result [images]",
    )
    variants: dict[Name, dict[str, Any]] = Field(
        {"full": {}},
        min_length=1,
        description="avatars to train: name -> what it changes in train_avatar and, below trace_irradiance, in that",
    )

    budget_minutes: float | None = Field(
        None,
        gt=0,
        description="minutes of one processor for metrics.csv: what nobody sets is chosen from config/curves so that "
        "it loses least; null: no budget",
    )

    # The stages, in data order.
    synthesize_capture: SynthesizeCapture = SynthesizeCapture()
    import_capture: ImportCapture = ImportCapture()
    detect_landmarks: DetectLandmarks = DetectLandmarks()
    segment_subject: SegmentSubject = SegmentSubject()
    index_capture: IndexCapture = IndexCapture()
    calibrate_cameras: CalibrateCameras = CalibrateCameras()
    calibrate_color: CalibrateColor = CalibrateColor()
    calibrate_lights: CalibrateLights = CalibrateLights()
    review_calibration: ReviewCalibration = ReviewCalibration()
    book_patterns: BookPatterns = BookPatterns()
    unwrap_atlas: UnwrapAtlas = UnwrapAtlas()
    track_mesh: TrackMesh = TrackMesh()
    review_tracking: ReviewTracking = ReviewTracking()
    estimate_gaze: EstimateGaze = EstimateGaze()
    plan_effects: PlanEffects = PlanEffects()
    fit_eyes: FitEyes = FitEyes()
    trace_irradiance: TraceIrradiance = TraceIrradiance()
    bake_textures: BakeTextures = BakeTextures()
    pack_shards: PackShards = PackShards()
    train_avatar: TrainAvatar = TrainAvatar()
    evaluate_avatar: EvaluateAvatar = EvaluateAvatar()
    relight_avatar: RelightAvatar = RelightAvatar()
    export_viewer: ExportViewer = ExportViewer()
    export_avatar: ExportAvatar = ExportAvatar()
    export_capture: ExportCapture = ExportCapture()
    check_budget: CheckBudget = CheckBudget()
    measure_cost: MeasureCost = MeasureCost()
    budget_errors: BudgetErrors = BudgetErrors()
    write_report: WriteReport = WriteReport()


class ProjectSettings(SubjectSettings):
    """Everything that may stand in config/config.yaml."""

    captures: str = Field("captures", min_length=1, description="folder that holds one capture folder per subject")
    track_capture_files: int = Field(
        5000,
        ge=0,
        description="captures of at most so many files are watched file by file, larger ones by their tables",
    )
    training_processes: int = Field(
        0,
        ge=0,
        description="processes that train one avatar together, on each node, as many as GPUs; 0: on a CPU one per "
        "core, at most train_avatar.steps_together, on a GPU one",
    )
    training_nodes: int = Field(
        1,
        ge=1,
        le=1024,
        description="nodes of a Slurm cluster that train one avatar together, each with `training_processes`; other "
        "stages have one node for each job",
    )
    training_cache_mb: int = Field(
        16_000,
        ge=0,
        description="memory that training keeps frames in, of all its processes on a machine together, at most half of "
        "what is free; other frames are read and traced again at each visit; changes no result [MB]",
    )
    training_scratch: str = Field(
        "",
        description="folder on a disk of the machine that trains, for traced light of frames beyond training_cache_mb, "
        "which is then read, not traced again; at most half of what is free there; empty: none; changes no result",
    )
    machine_pace: PositiveFloat | dict[str, PositiveFloat] = Field(
        1.0,
        description="seconds that jobs take on this machine over those that config/curves/job_costs.csv expects, more "
        "than 0; of all stages, or by stage and 1 for the others: budgets count with it; `make left` and budget.csv "
        "say what finished jobs took",
    )
    compare_subjects: CompareSubjects = CompareSubjects()

    @field_validator("machine_pace")
    @classmethod
    def _is_of_stages(cls, pace: float | dict[str, float]) -> float | dict[str, float]:
        if isinstance(pace, dict) and not pace.keys() <= set(STAGES):
            raise PydanticCustomError("unknown_stage", "Input should be paces of stages, such as train_avatar")
        return pace


SECTIONS: dict[str, type[Settings]] = {
    name: type(default) for name, default in ProjectSettings() if isinstance(default, Settings)
}
"""Stage -> its settings model, in data order."""

VARIED = ("train_avatar", "trace_irradiance")
"""Stages that variants may change."""

PROJECT_ONLY = tuple(ProjectSettings.model_fields.keys() - SubjectSettings.model_fields.keys())
"""Keys that cannot differ between subjects."""
