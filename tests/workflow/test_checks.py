"""The workflow as it is written: style, plans, and what it says when something is wrong."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

from pipeline import STAGES
from pipeline.config.project import SECTIONS
from pipeline.config.stage_commands import ARGUMENTS
from tests.support.results.curve_files import write_curves, write_job_costs

ALWAYS = {
    "index_capture": 1,
    "calibrate_cameras": 1,
    "calibrate_color": 1,
    "calibrate_lights": 1,
    "book_patterns": 1,
    "track_mesh": 1,
    "unwrap_atlas": 1,
    "plan_effects": 1,
    "pack_shards": 1,
    "train_avatar": 1,
    "evaluate_avatar": 1,
}
"""The jobs of a capture of one chunk, as far as they are known before plan_effects has run."""


@pytest.fixture(scope="module")
def workflow(copy_of_project, tmp_path_factory):
    return copy_of_project(tmp_path_factory.mktemp("checks") / "project")


def test_lint_finds_nothing(workflow):
    done = workflow.snakemake("--lint")
    assert done.returncode == 0, done.stdout


def test_format_is_snakefmts(repo_root):
    words = [sys.executable, "-m", "snakefmt", "--check", "Snakefile", "workflow"]
    done = subprocess.run(words, cwd=repo_root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_snakefile_is_a_table_of_contents(repo_root):
    assert len((repo_root / "Snakefile").read_text().splitlines()) < 60


@pytest.mark.parametrize("subject", ["subjectA", "tiny"])
def test_synthetic_subject_is_planned_from_its_name(workflow, subject):
    assert workflow.planned(f"results/{subject}/metrics.csv") == {"synthesize_capture": 1, **ALWAYS}


def test_chunks_and_variants_multiply_their_jobs(workflow):
    options = ["--config", "chunk_frames=10", "variants={full: {}, matte: {specular: false}}"]
    assert workflow.planned("results/subjectA/metrics.csv", *options) == {
        "synthesize_capture": 1,
        **ALWAYS,
        "track_mesh": 3,
        "pack_shards": 3,
        "train_avatar": 2,
    }


def test_images_of_many_chunks_are_shared_by_jobs_of_whole_chunks(workflow):
    """Three chunks of 10 frames of 8 cameras, two of which hold 100 images: two jobs inspect, two score each avatar."""
    options = ["--config", "chunk_frames=10", "chunk_images=100", "variants={full: {}, matte: {specular: false}}"]
    assert workflow.planned("results/subjectA/metrics.csv", *options) == {
        "synthesize_capture": 1,
        **ALWAYS,
        "inspect_images": 2,
        "track_mesh": 3,
        "pack_shards": 3,
        "train_avatar": 2,
        "score_images": 4,
    }


@pytest.fixture(scope="module")
def indexed(workflow, tmp_path_factory):
    """Words for a recorded capture whose index is there: four cameras, each with five photographs of a board."""
    folder = tmp_path_factory.mktemp("indexed") / "photographed"
    folder.mkdir()
    (folder / "capture.yaml").write_text("frames: frames.csv\n")
    (folder / "frames.csv").write_text("frame,timestamp_s,segment\n0,0,a\n")
    words = ["--config", f"captures={folder.parent}"]
    listed = workflow.snakemake("--summary", *words, "--", "results/photographed/index/capture.json").stdout
    for path in re.findall(r"^results/photographed/index/\S+", listed, flags=re.MULTILINE):
        (workflow.folder / path).parent.mkdir(parents=True, exist_ok=True)
        (workflow.folder / path).touch()
    views = [{"camera": camera, "view": view, "path": f"{camera}{view}.png"} for camera in "abcd" for view in range(5)]
    index = workflow.folder / "results/photographed/index/calibration_cameras.json"
    index.write_text(json.dumps({"method": "charuco", "views": views}))
    return words


@pytest.mark.parametrize(("least", "shares"), [(21, 0), (20, 0), (10, 2), (5, 4), (1, 20)])
def test_many_photographs_of_boards_are_shared_by_jobs(workflow, indexed, least, shares):
    planned = workflow.planned("results/photographed/calibration/rig.json", *indexed, f"chunk_images={least}")
    assert planned == {"calibrate_cameras": 1, **({"find_boards": shares} if shares else {})}


def test_recorded_capture_is_found_elsewhere_and_never_made(workflow, tmp_path):
    folder = tmp_path / "elsewhere" / "someone"
    folder.mkdir(parents=True)
    (folder / "capture.yaml").write_text("frames: frames.csv\n")
    (folder / "frames.csv").write_text("frame,timestamp_s,segment\n" + "".join(f"{f},0,a\n" for f in range(65)))
    for stray in ("notes {draft}.txt", 'it\'s [a] "*?" (1).txt'):
        (folder / stray).touch()
    (folder / "dangling").symlink_to("nothing")
    planned = workflow.planned("results/someone/metrics.csv", "--config", f"captures={folder.parent}")
    assert planned == {**ALWAYS, "track_mesh": 2, "pack_shards": 2}


def test_preset_is_a_config_file(workflow):
    options = ["--configfile", "config/presets/draft.yaml", "--printshellcmds"]
    done = workflow.snakemake("--dry-run", *options, "--", "results/tiny/metrics.csv")
    preset = yaml.safe_load((workflow.folder / "config/presets/draft.yaml").read_text())
    assert f"--steps {preset['train_avatar']['steps']} " in done.stdout


def test_ablations_are_one_command_for_any_subject(workflow):
    planned = workflow.planned("results/tiny/ablations.csv", "--configfile", "config/presets/ablations.yaml")
    variants = yaml.safe_load((workflow.folder / "config/presets/ablations.yaml").read_text())["variants"]
    once = {"synthesize_capture": 1, **ALWAYS, "pack_frames_of_variant": 2}
    assert planned == {**once, "train_avatar": len(variants)}


def test_rows_of_a_head_are_one_command_for_any_subject(workflow):
    planned = workflow.planned("results/tiny/ablations.csv", "--configfile", "config/presets/head_rows.yaml")
    variants = yaml.safe_load((workflow.folder / "config/presets/head_rows.yaml").read_text())["variants"]
    assert planned == {"synthesize_capture": 1, **ALWAYS, "train_avatar": len(variants)}


def test_missing_subject_is_told_what_is_expected_and_what_there_is(workflow):
    printed = workflow.refused("results/nobody/metrics.csv")
    assert "subject 'nobody': expected captures/nobody/capture.yaml, found no such file" in printed
    assert "subjects: subjectA, subjectB, subjectC, subjectD, tiny" in printed
    assert "MissingInputException" not in printed


def test_subject_with_a_strange_name_is_no_target(workflow):
    assert "MissingRuleException" in workflow.refused("results/no body/metrics.csv")


def test_wrong_configuration_is_said_at_once_and_without_traceback(copy_of_project, tmp_path):
    workflow = copy_of_project(tmp_path / "project")
    workflow.append("config/subjects/tiny.yaml", "track_mesh: {inlier_px: -1}\nnonsense: 1\n")
    printed = workflow.refused("results/subjectA/metrics.csv", "--config", "train_avatar={steps: 0, setps: 1}")
    for expected in (
        "configuration: 4 problems",
        "config/subjects/tiny.yaml: track_mesh.inlier_px: expected greater than 0, found -1",
        "config/subjects/tiny.yaml: nonsense: expected a known key",
        "command line (--config, --configfile): train_avatar.steps: expected greater than or equal to 1, found '0'",
        "command line (--config, --configfile): train_avatar.setps: expected a known key, found an unknown one",
    ):
        assert expected in printed
    assert "Traceback" not in printed


def test_stages_are_listed_once_for_modules_rules_and_settings(repo_root):
    text = "\n".join(path.read_text() for path in sorted((repo_root / "workflow/rules").glob("*.smk")))
    modules = {path.stem for path in (repo_root / "pipeline/stages").glob("*.py")} - {"__init__"}
    assert tuple(SECTIONS) == STAGES == tuple(ARGUMENTS)
    assert sorted(STAGES) == sorted(modules) == sorted(re.findall(r"-m pipeline\.stages\.(\w+) ", text))


def test_stage_has_one_rule_with_a_log_and_a_benchmark_of_its_name(repo_root):
    text = "\n".join(path.read_text() for path in sorted((repo_root / "workflow/rules").glob("*.smk")))
    for stage in STAGES:
        (rule,) = re.findall(rf"^(?:rule|checkpoint) {stage}:\n(.*?)(?=^\S|\Z)", text, re.MULTILINE | re.DOTALL)
        for expected in (f"/logs/{stage}." if stage != "compare_subjects" else f"/{stage}.log", f"/{stage}.",
                         "code=", f'"{stage}"', f"-m pipeline.stages.{stage} "):  # fmt: skip
            assert expected in rule


def test_commands_name_files_that_the_rules_declare(copy_of_project, tmp_path):
    """A path of a command that is no input and no output would be read behind Snakemake's back."""
    workflow = copy_of_project(tmp_path / "project")
    for path in (workflow.folder / "workflow/rules").glob("*.smk"):  # Without messages, a plan lists files.
        path.write_text(re.sub(r"^    message:\n        .*\n", "", path.read_text(), flags=re.MULTILINE))
    (workflow.folder / "config/lights").mkdir(exist_ok=True)
    (workflow.folder / "config/lights/sky.exr").touch()
    (tmp_path / "set").mkdir()
    workflow.append("config/subjects/someone.yaml", f"source: goliath\npath: {tmp_path / 'set'}\n")
    wanted = ("calibration/review", "tracking/review", "accuracy_cost.csv", "report/index.html", "eyes.json",
              "irradiance/0000.parquet", "textures/0000.safetensors", "relit/full/sky", "budget.csv",
              "error_budget", "viewer/index.html", "export", "exports/goliath", "detected/landmarks.png",
              "detected/masks.png", "gaze.parquet")  # fmt: skip
    options = ("--dry-run", "--printshellcmds", "--config", "budget_minutes=60", "--")
    targets = ["results/comparison.csv", "results/someone/metrics.csv", *(f"results/tiny/{name}" for name in wanted)]
    done = workflow.snakemake(*options, *targets)
    pattern = r"^(rule|checkpoint) (\w+):\n(.*?)^Shell command: ([^\n]*)$"
    jobs = re.findall(pattern, done.stdout, re.MULTILINE | re.DOTALL)
    assert {rule for _, rule, _, _ in jobs} == set(STAGES), done.stdout
    # Until a checkpoint has run, its outputs stand for whatever depends on it.
    undecided = {file for kind, _, details, _ in jobs if kind == "checkpoint" for file in declared(details)}
    for _, rule, details, command in jobs:
        files = declared(details)
        files |= undecided if "<TBD>" in files else set()
        folders = {str(parent) for file in files for parent in Path(file).parents}
        folders |= {str(Path(file).with_suffix("")) for file in files}  # A folder beside a table of the same name.
        words = set(re.findall(r"\s(results/\S+)", command.partition(" > ")[0]))
        bits = {f"results/{name}/visibility" for name in ("tiny", "subjectA", "someone")}
        assert words <= files | folders | bits, rule


def declared(details):
    """Inputs and outputs of a job in a plan."""
    lines = re.findall(r"^    (?:input|output): (.*)$", details, re.MULTILINE)
    return {file for line in lines for file in line.split(", ")}


def test_what_is_left_of_a_run_is_told_by_stage(copy_of_project, tmp_path):
    workflow = copy_of_project(tmp_path / "project")
    words = [sys.executable, "-m", "pipeline.workflow.time_left", "results/tiny/metrics.csv", "--cores", "4"]
    done = subprocess.run(words, cwd=workflow.folder, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    planned = workflow.planned("results/tiny/metrics.csv")
    assert {line.split()[0]: int(line.split()[1]) for line in lines[1:-1]} == planned and len(planned) > 8
    assert lines[-1].startswith("at least ") and "on 4 processors; no job is finished" in lines[-1]


def test_workflow_imports_nothing_heavy(repo_root):
    """A plan has to appear at once: what the Snakefile imports pulls in no numerical library."""
    modules = re.findall(
        r"^from (pipeline\S*) import", (repo_root / "workflow/rules/common.smk").read_text(), re.MULTILINE
    )
    heavy = "{'numpy', 'torch', 'pandas', 'cv2', 'tyro'}"
    check = f"import sys, {', '.join(modules)}; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", check], cwd=repo_root, capture_output=True, text=True, check=True)
    assert modules
    assert done.stdout.strip() == "[]"


def test_environments_list_what_the_project_needs(repo_root):
    project = tomllib.loads((repo_root / "pyproject.toml").read_text())["project"]
    packages = {}
    for name in ("cpu", "gpu"):
        content = yaml.safe_load((repo_root / f"envs/{name}.yaml").read_text())
        packages[name] = next(item["pip"] for item in content["dependencies"] if isinstance(item, dict))
    assert packages["cpu"] == project["dependencies"]
    assert packages["gpu"] == [*project["dependencies"], *project["optional-dependencies"]["gpu"]]


def test_profile_is_found_and_compares_content(workflow):
    profile = yaml.safe_load(Path(workflow.folder / "workflow/profiles/default/config.yaml").read_text())
    assert {"max-checksum-file-size", "rerun-incomplete", "show-failed-logs"} <= profile.keys()
    assert "profiles/default" in workflow.refused("results/nobody/metrics.csv")


@pytest.fixture(scope="module")
def with_curves(copy_of_project, tmp_path_factory):
    """A project whose curves and costs are made by hand: at 200 steps 60 s of a processor."""
    workflow = copy_of_project(tmp_path_factory.mktemp("budget") / "project")
    write_curves(workflow.folder / "config/curves")
    write_job_costs(workflow.folder / "config/curves/job_costs.csv")
    made = "source: synthetic\nsynthesize_capture: {cameras: 4, frames: 10, frames_b: 2, width: 40, height: 25}\n"
    (workflow.folder / "config/subjects/someone.yaml").write_text(made)
    (workflow.folder / "config/subjects/stubborn.yaml").write_text(made + "train_avatar: {steps: 400}\n")
    return workflow


def test_budget_chooses_what_nobody_has_set(with_curves):
    shown = ("--dry-run", "--printshellcmds", "--config", "budget_minutes=1.101")
    printed = with_curves.snakemake(*shown, "--", "results/someone/budget.csv").stdout
    assert "--steps 200 " in printed and "check_budget" in printed
    assert "someone: budget 1.1 minutes of one processor, expected 1; errors as measured on measured" in printed
    stubborn = with_curves.snakemake(*shown, "--", "results/stubborn/metrics.csv").stdout
    assert "--steps 400 --seed 0" in stubborn and "train_avatar.steps 400, set by you" in stubborn
    overruled = with_curves.snakemake(*shown, "train_avatar={steps: 100}", "--", "results/stubborn/metrics.csv").stdout
    assert "--steps 100 --seed 0" in overruled


@pytest.mark.parametrize(
    ("budget", "said"),
    [
        ("0.2", "someone: budget_minutes: expected at least"),
        ("0", "budget_minutes: expected greater than 0, found"),
        ("-5", "budget_minutes: expected greater than 0, found"),
    ],
)
def test_budget_that_cannot_be_met_is_refused_before_anything_runs(with_curves, budget, said):
    printed = with_curves.refused("results/someone/metrics.csv", "--config", f"budget_minutes={budget}")
    assert said in printed and "Traceback (most recent call last)" not in printed


def test_table_of_a_budget_needs_a_budget(with_curves):
    assert "expected a budget: --config budget_minutes=10" in with_curves.refused("results/someone/budget.csv")
