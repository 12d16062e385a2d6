"""What runs again after an edit, with stages that copy digests of their inputs in place of the real ones."""

from __future__ import annotations

import re
import shutil

import pytest

from pipeline.config.project import SECTIONS

TARGET = "results/subjectA/metrics.csv"
INDEX = ("cameras", "frames", "lights", "patterns", "images", "keypoints_2d", "eyes", "eye_points", "gaze", "meshes")
INDEX_JSON = ("capture", "calibration_cameras", "calibration_lights", "calibration_color")
OUTPUTS = {
    "synthesize_capture": ["capture.yaml"],
    "index_capture": [
        *(f"{name}.parquet" for name in INDEX),
        *(f"{name}.json" for name in INDEX_JSON),
        "verdicts_images.csv",
    ],
    "calibrate_cameras": [
        "rig.json",
        *(f"{table}_cameras.parquet" for table in ("residuals", "quality", "pairs")),
        "verdicts_cameras.csv",
    ],
    "calibrate_color": ["color.json", "residuals_color.parquet", "quality_color.parquet", "verdicts_color.csv"],
    "calibrate_lights": ["lights.parquet", "cameras.json", "residuals_lights.parquet", "verdicts_lights.csv"],
    "book_patterns": ["patterns.parquet", "frames.parquet", "sync.json", "verdicts_patterns.csv", "sync.png"],
    "track_mesh": ["{chunk}.safetensors", "{chunk}.parquet", "verdicts_{chunk}.csv"],
    "unwrap_atlas": ["atlas.safetensors", "atlas.png", "template.glb"],
    "plan_effects": [""],
    "fit_eyes": ["", "../verdicts_eyes.csv"],
    "trace_irradiance": ["/000000.exr", ".parquet", ".png"],
    "bake_textures": [".safetensors", ".png"],
    "pack_shards": ["train/{chunk}.arrow", "validation/{chunk}.arrow", "test/{chunk}.arrow", "frames/{chunk}.arrow"],
    "train_avatar": ["avatar.safetensors", "config.json", "log.parquet"],
    "evaluate_avatar": [
        "metrics.csv",
        "metrics_per_image.parquet",
        "ablations.csv",
        "avatar_times.csv",
        "images/worst.png",
    ],
}
ON_REQUEST = {
    "import_capture",
    "detect_landmarks",
    "segment_subject",
    "estimate_gaze",
    "check_budget",
    "review_calibration",
    "review_tracking",
    "measure_cost",
    "budget_errors",
    "relight_avatar",
    "export_viewer",
    "export_avatar",
    "export_capture",
    "write_report",
    "compare_subjects",
}
"""Stages that nothing else of this subject waits for."""

HEADS_ONLY = {"bake_textures"}
"""Stages that captures of bodies do without."""

STAND_IN = """
import hashlib, json, sys
from pathlib import Path

def settings():  # Part of the stage's code, without the time to import it.
    from pipeline.config import STAGE

CHANGED = []
words, flags, name = sys.argv[1:], {}, None
for word in words:
    if word.startswith("--"):
        name = word[2:]
        flags[name] = []
    else:
        flags[name].append(word)
out = Path(flags["out"][0])
content = hashlib.sha256(" ".join(word for word in words if word not in flags.get("capture", [])).encode())
head = flags.get("figure") == ["head"]
for path in sorted(Path(word) for key, values in flags.items() if key != "out" for word in values):
    for file in sorted(path.rglob("*.*")) if path.is_dir() else [path] if path.is_file() else []:
        if file.is_file() and not file.name.startswith("."):
            content.update(file.read_bytes())
            head |= b'"kind": "head"' in file.read_bytes()
planned = {name: {"on": flags.get(name) != ["off"]} for name in ("shadow", "eyes")}
text = json.dumps({**planned, "kind": "head" if head else "body", "content": content.hexdigest()})
for output in OUTPUTS:
    output = output.replace("{chunk}", flags.get("chunk", [""])[0])
    path = Path(f"{out}{output}") if output[:1] in ("", "/") else out / output
    beside = out.parent / output[3:] if output[:3] == "../" else None
    path = beside or (out.with_suffix(output) if output[:1] == "." else path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + " changed" * (output in CHANGED))
"""


def stand_in(stage, outputs):
    """A module in place of a stage's."""
    return STAND_IN.replace("STAGE", stage).replace("OUTPUTS:", f"{outputs!r}:")


SUBJECT = "source: synthetic\nchunk_frames: 12\nsynthesize_capture: {frames: 24}\n"
AFTER_PACKING = {"pack_shards": 2, "train_avatar": 1, "evaluate_avatar": 1}
AFTER_TRACKING = {"track_mesh": 2, "plan_effects": 1, "fit_eyes": 1, **AFTER_PACKING}


@pytest.fixture(scope="module")
def made(copy_of_project, tmp_path_factory):
    """A project in which everything has run once."""
    workflow = copy_of_project(tmp_path_factory.mktemp("reruns") / "project").with_own_code()
    assert set(OUTPUTS) == set(SECTIONS) - ON_REQUEST
    for stage in OUTPUTS:
        (workflow.folder / f"pipeline/stages/{stage}.py").write_text(stand_in(stage, OUTPUTS[stage]))
    (workflow.folder / "config/subjects/subjectA.yaml").write_text(SUBJECT)
    workflow.edit("config/config.yaml", "shading: auto", "shading: transfer")  # which reads irradiance maps
    ran = [*(OUTPUTS.keys() - HEADS_ONLY), "track_mesh", "trace_irradiance", "pack_shards"]
    assert sorted(workflow.ran(TARGET)) == sorted(ran)
    assert workflow.planned(TARGET) == {}
    return workflow


@pytest.fixture
def workflow(made, tmp_path):
    """A fresh copy of it; times are kept."""
    return made.copied(tmp_path / "project")


def test_touched_files_comments_and_prose_rerun_nothing(workflow):
    for path in [*workflow.folder.glob("results/subjectA/**/*.*"), *workflow.folder.glob("captures/subjectA/*")]:
        path.touch()
    workflow.append("pipeline/stages/train_avatar.py", "# A comment.\n")
    workflow.append("pipeline/config/track_mesh.py", '"""A text."""\n')
    workflow.append("pipeline/geometry/mesh.py", "UNRELATED = 1\n")
    workflow.append("envs/cpu.yaml", "# A comment.\n")
    assert workflow.planned(TARGET) == {}


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("evaluate_avatar: {lpips_net: vgg}", {"evaluate_avatar": 1}),
        ("evaluate_avatar: {pictures: false}", {"evaluate_avatar_without_pictures": 1}),
        ("train_avatar: {steps: 7}", {"train_avatar": 1, "evaluate_avatar": 1}),
        ("variants: {full: {}, matte: {specular: false}}", {"train_avatar": 1, "evaluate_avatar": 1}),
        ("trace_irradiance: {samples: '4'}", {"trace_irradiance": 2, **AFTER_PACKING}),
        ("track_mesh: {inlier_px: 4}", AFTER_TRACKING),
    ],
)
def test_changed_setting_reruns_its_stage_and_what_follows(workflow, setting, expected):
    workflow.append("config/subjects/subjectA.yaml", setting + "\n")
    planned = workflow.planned(TARGET)
    if "track_mesh" in expected:
        # Whether there are shadows and eyes is open until plan_effects has run.
        for open_until_planned in ("trace_irradiance", "fit_eyes"):
            planned.pop(open_until_planned, None)
    assert planned == {stage: jobs for stage, jobs in expected.items() if stage != "fit_eyes"}


def test_training_processes_and_their_memory_rerun_nothing_and_are_told(workflow):
    changed = ("training_processes=2", "training_cache_mb=300", "training_scratch=/somewhere")
    assert workflow.planned(TARGET, "--config", *changed) == {}
    shown = ("--dry-run", "--printshellcmds", "--forcerun", "train_avatar", "--config")
    told = workflow.snakemake(*shown, *changed, "--", TARGET).stdout
    assert re.search(
        r"-m pipeline.stages.train_avatar --subject subjectA .*--processes 2 --cache-mb 300 --scratch /somewhere ", told
    )


def test_variant_with_other_irradiance_gets_its_own_maps_beside_the_others(workflow):
    def jobs(samples, rule="{full: {}, few: {steps: 9, trace_irradiance: {samples: '%s'}}}"):
        return workflow.planned(TARGET, "--config", f"variants={rule % samples}")

    own = {"trace_irradiance_of_variant": 2, "pack_frames_of_variant": 2}
    assert jobs("4") == {**own, "train_avatar": 1, "evaluate_avatar": 1}
    assert jobs("full") == {"train_avatar": 1, "evaluate_avatar": 1}  # what the subject has
    workflow.append("config/subjects/subjectA.yaml", "variants: {full: {}, few: {trace_irradiance: {samples: '4'}}}\n")
    assert sorted(set(workflow.ran(TARGET))) == sorted([*own, "train_avatar", "evaluate_avatar"])
    assert workflow.planned(TARGET) == {}
    assert jobs("8") == {**own, "train_avatar": 1, "evaluate_avatar": 1}


def test_edited_code_reruns_the_stages_that_import_it(workflow):
    workflow.append("pipeline/config/pack_shards.py", "EDITED = 1\n")
    assert workflow.planned(TARGET) == AFTER_PACKING


def test_edit_that_leaves_the_index_as_it_was_ends_there(workflow):
    workflow.append("pipeline/stages/index_capture.py", "EDITED = 1\n")
    assert workflow.ran(TARGET) == ["index_capture"]
    assert workflow.planned(TARGET) == {}


@pytest.mark.parametrize(
    ("setting", "expected"),
    [
        ("evaluate_avatar: {lpips_net: vgg}", {"evaluate_avatar"}),
        ("train_avatar: {steps: 7}", {"train_avatar", "evaluate_avatar"}),
        ("pack_shards: {margin_px: 4}", {*AFTER_PACKING}),
        ("trace_irradiance: {samples: '4'}", {"trace_irradiance", *AFTER_PACKING}),
        ("track_mesh: {inlier_px: 4}", {*AFTER_TRACKING, "trace_irradiance"}),
    ],
)
@pytest.mark.parametrize("edited", ["index_capture", "synthesize_capture"])
def test_changed_setting_is_heeded_where_an_edit_leaves_the_index_as_it_was(workflow, edited, setting, expected):
    """What stages after the index are to do anew is not told by the index alone."""
    workflow.append(f"pipeline/stages/{edited}.py", "EDITED = 1\n")
    workflow.append("config/subjects/subjectA.yaml", setting + "\n")
    ran = set(workflow.ran(TARGET))
    assert ran - {"synthesize_capture", "index_capture"} == expected
    assert workflow.planned(TARGET) == {}


def test_edit_that_leaves_the_shards_as_they_were_trains_nothing(workflow):
    workflow.append("pipeline/stages/calibrate_lights.py", "EDITED = 1\n")
    workflow.append("pipeline/stages/pack_shards.py", "EDITED = 1\n")
    assert set(workflow.ran(TARGET)) == {
        "calibrate_lights",
        "book_patterns",
        "track_mesh",
        "plan_effects",
        "pack_shards",
    }
    assert workflow.planned(TARGET) == {}


def test_edit_that_changes_one_table_reruns_what_reads_it(workflow):
    """Cameras, colour and atlas stay when the lights change."""
    workflow.edit("pipeline/stages/index_capture.py", "CHANGED = []", "CHANGED = ['lights.parquet']")
    ran = set(workflow.ran(TARGET))
    assert ran == {"index_capture", "calibrate_lights", "book_patterns", *AFTER_TRACKING, "trace_irradiance"}


def test_recorded_capture_is_watched_by_content(workflow):
    folder = workflow.folder / "captures/someone"
    folder.mkdir()
    (folder / "capture.yaml").write_text("frames: frames.csv\n")
    (folder / "frames.csv").write_text("frame,timestamp_s,segment\n0,0,a\n")
    (folder / "image.png").write_text("a picture")
    target = "results/someone/metrics.csv"
    assert "synthesize_capture" not in workflow.ran(target)
    for path in folder.iterdir():
        path.touch()
    assert workflow.planned(target) == {}
    (folder / "image.png").write_text("another picture")
    assert "index_capture" in workflow.planned(target)


def test_moved_captures_rerun_their_check_alone(workflow):
    """What a capture holds counts, not where it lies: stages are told of its folder, and of its digests."""
    (workflow.folder / "captures").rename(workflow.folder / "elsewhere")
    moved = ("--config", "captures=elsewhere")
    assert workflow.ran(TARGET, *moved) == ["index_capture"]
    assert workflow.planned(TARGET, *moved) == {}


def test_captures_that_were_moved_behind_a_link_rerun_nothing(workflow, tmp_path):
    """With other times."""
    (workflow.folder / "captures").rename(tmp_path / "elsewhere")
    for path in (tmp_path / "elsewhere").rglob("*"):
        path.touch()
    (workflow.folder / "captures").symlink_to(tmp_path / "elsewhere")
    assert workflow.planned(TARGET) == {}


def test_copied_results_capture_and_metadata_rerun_nothing_on_another_machine(workflow, tmp_path):
    """As rsync without times copies them; the rest is the project's."""
    there = workflow.copied(tmp_path / "there")
    for folder in ("results", "captures", ".snakemake"):
        shutil.rmtree(there.folder / folder)
    for folder in ("results/subjectA", "captures/subjectA", ".snakemake/metadata"):
        shutil.copytree(workflow.folder / folder, there.folder / folder, copy_function=shutil.copyfile)
    assert there.planned(TARGET) == {}


def test_effect_that_is_off_has_no_job(workflow):
    workflow.append("config/subjects/subjectA.yaml", "plan_effects: {shadow: off}\n")
    assert workflow.ran(TARGET) == ["plan_effects", "pack_shards", "pack_shards", "train_avatar", "evaluate_avatar"]
    shutil.rmtree(workflow.folder / "results/subjectA/irradiance")
    assert workflow.planned(TARGET) == {}


def test_eyes_are_fitted_only_where_an_avatar_has_them(workflow):
    workflow.append("config/subjects/subjectA.yaml", "variants: {full: {eyes: off}}\n")
    (workflow.folder / "results/subjectA/eyes.json").unlink()
    assert workflow.ran(TARGET) == ["train_avatar", "evaluate_avatar"]
    assert workflow.planned(TARGET) == {}


def test_shadows_that_no_avatar_learns_have_no_job(workflow):
    workflow.append("config/subjects/subjectA.yaml", "variants: {full: {shading: microfacet}}\n")
    shutil.rmtree(workflow.folder / "results/subjectA/irradiance")
    assert workflow.ran(TARGET) == ["pack_shards", "pack_shards", "train_avatar", "evaluate_avatar"]


def test_heads_have_jobs_that_bodies_have_not(workflow):
    workflow.edit("config/subjects/subjectA.yaml", "{frames: 24}", "{frames: 24, figure: head}")
    ran = workflow.ran(TARGET)
    assert ran.count("bake_textures") == 2
    assert workflow.planned(TARGET) == {}
    workflow.append("config/subjects/subjectA.yaml", "bake_textures: {cosine_power: 2}\n")
    assert workflow.planned(TARGET) == {"bake_textures": 2, **AFTER_PACKING}


@pytest.mark.parametrize("said", ["subject", "command line"])
def test_pictures_of_scores_are_expected_only_where_they_are_made(workflow, said):
    """The stand-in makes none, as the stage does when they are turned off; the report asks for none either."""
    workflow.edit("pipeline/stages/evaluate_avatar.py", "'images/worst.png'", "")
    shutil.rmtree(workflow.folder / "results/subjectA/images")
    done = workflow.snakemake("--latency-wait", "0", "--", TARGET)
    assert done.returncode != 0 and "results/subjectA/images" in done.stdout
    options = ["--config", "evaluate_avatar={pictures: false}"] if said == "command line" else []
    if said == "subject":
        workflow.append("config/subjects/subjectA.yaml", "evaluate_avatar: {pictures: false}\n")
    assert workflow.ran(TARGET, *options) == ["evaluate_avatar_without_pictures"]
    assert workflow.planned(TARGET, *options) == {}
    assert workflow.planned("results/subjectA/report/index.html", *options) == {"write_report": 1}
    if said == "subject":  # others have theirs
        assert "evaluate_avatar" in workflow.planned("results/tiny/metrics.csv")


def test_relighting_a_head_reads_its_textures_and_the_tables_that_drive_it(workflow):
    stage = workflow.with_own_code().folder / "pipeline/stages/relight_avatar.py"
    stage.write_text(stand_in("relight_avatar", ["film.mp4"]))
    (workflow.folder / "config/lights").mkdir()
    (workflow.folder / "config/lights/key.csv").write_text("light,x,y,z,r,g,b\n")
    target = "results/subjectA/relit/full/key"
    assert workflow.ran(target) == ["relight_avatar"]
    shown = ["--forcerun", "relight_avatar", "--dry-run", "--printshellcmds", "--", target]
    assert "--textures" not in workflow.snakemake(*shown).stdout
    workflow.edit("config/subjects/subjectA.yaml", "{frames: 24}", "{frames: 24, figure: head}")
    assert workflow.ran(target)[-1] == "relight_avatar"
    folder = "results/subjectA/textures"
    command = workflow.snakemake(*shown).stdout
    assert f"--textures {folder}/0000.safetensors {folder}/0001.safetensors --index results/subjectA/index " in command
    drives = "relight_avatar: {codes: config/codes.csv, gaze: config/gaze.csv, head_motion: rest, segment: b}\n"
    workflow.append("config/subjects/subjectA.yaml", drives)
    assert "config/codes.csv" in workflow.refused(target)  # it is not there
    for name in ("codes", "gaze"):
        (workflow.folder / f"config/{name}.csv").write_text("picture\n")
    assert workflow.ran(target) == ["relight_avatar"]
    assert workflow.planned(target) == {}
    workflow.append("config/gaze.csv", "0\n")
    assert workflow.planned(target) == {"relight_avatar": 1}


def test_shards_of_other_chunks_are_refused(workflow):
    shutil.copy(*(workflow.folder / f"results/subjectA/shards/train/{name}.arrow" for name in ("0001", "0002")))
    printed = workflow.refused(TARGET)
    assert "left over from other chunks of frames, delete: results/subjectA/shards/train/0002.arrow" in printed


def test_failed_stage_shows_its_log(workflow):
    workflow.append("pipeline/stages/evaluate_avatar.py", "raise SystemExit('error: no such light')\n")
    done = workflow.snakemake("--", TARGET)
    assert done.returncode != 0
    assert "error: no such light" in done.stdout


def test_report_shows_what_is_there_and_makes_nothing_else(workflow):
    """What it can do without is no input: it is not made for the report, nor made anew; yet the report follows it."""
    target = "results/subjectA/report/index.html"
    stage = workflow.with_own_code().folder / "pipeline/stages/write_report.py"
    stage.write_text(stand_in("write_report", [""]))
    assert workflow.ran(target) == ["write_report"]
    assert workflow.planned(target) == {}
    cost = workflow.folder / "results/subjectA/accuracy_cost.csv"
    cost.write_text("dial,setting\n")
    assert workflow.ran(target) == ["write_report"]
    assert cost.read_text() == "dial,setting\n"
    scaling = workflow.folder / "results/scaling/exponents.csv"
    scaling.parent.mkdir()
    scaling.write_text("stage,varied\n")
    assert workflow.ran(target) == ["write_report"]
    assert workflow.planned(target) == {}
    workflow.append("config/subjects/subjectA.yaml", "review_tracking: {most_cameras: 3}\n")
    assert workflow.planned(target) == {"write_report": 1}  # Only for the settings that it lists.


def test_comparison_needs_the_scores_of_the_subjects_that_are_named(workflow):
    options = ["--config", "compare_subjects={subjects: [subjectA]}"]
    assert workflow.planned("results/comparison.csv", *options) == {"compare_subjects": 1}
    assert "evaluate_avatar" in workflow.planned("results/comparison.csv")
