"""The smallest synthetic subject through every stage, killed once on the way; then what reruns and what does not."""

from __future__ import annotations

import os
import re
import subprocess
import time

import pandas as pd
import pytest

from docs.generate.flowchart import FLOW
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.color import srgb_from_linear
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.workflow.termination import running_stages
from tests.support.chaos.sound_run import differences, digests
from tests.support.network import system_calls
from tests.support.viewer.relit_page import CHROMIUM, lamp, launch, open_page, page_picture, psnr_db
from tests.support.workflow.read_files import declared, read_results, undeclared
from tests.support.workflow.stage_server import StageServer

TARGET = "results/tiny/metrics.csv"
DEADLINE_S = 900
"""Far more than the run takes (about 80 s of one core): for machines that do much else."""

COMMITTED_DB, SAME_DB = 19.561, 0.05
"""PSNR of tiny's test images, and how far roundings of another processor may move it: 60 steps are few enough for them
not to grow. A change that moves it further has a reason, which belongs into the commit that changes the number."""

ENOUGH, PARITY_DB = 20, 45.0
"""Held-out images that the viewer's page is compared on, and how near it has to come: it rounds to 8 bits, 59 dB."""

STAGES = {
    "synthesize_capture",
    "index_capture",
    "calibrate_cameras",
    "calibrate_color",
    "calibrate_lights",
    "book_patterns",
    "track_mesh",
    "unwrap_atlas",
    "plan_effects",
    "trace_irradiance",
    "pack_shards",
    "train_avatar",
    "evaluate_avatar",
}


def kill_training(workflow):
    """Start the workflow and kill the training process when its first checkpoint is there; return what was printed."""
    log = workflow.folder / "first.log"
    checkpoint = workflow.folder / "results/tiny/avatars/full/checkpoint.safetensors"
    with open(log, "w") as file:
        running = subprocess.Popen(workflow.command("--", TARGET), cwd=workflow.folder, stdout=file, stderr=file)
    last = time.monotonic() + DEADLINE_S
    while not checkpoint.exists() and running.poll() is None and time.monotonic() < last:
        time.sleep(0.02)
    for stage in running_stages(running.pid) if running.poll() is None else []:
        stage.kill()
    code = running.wait(DEADLINE_S)
    printed = log.read_text()
    assert code != 0, printed
    assert "Error in rule train_avatar" in printed, printed
    return printed


@pytest.fixture(scope="module")
def made(copy_of_project, tmp_path_factory):
    """The project after a run that was killed while training and a second one that finished; and what both printed."""
    workflow = copy_of_project(tmp_path_factory.mktemp("tiny") / "project")
    first = kill_training(workflow)
    avatar = workflow.folder / "results/tiny/avatars/full"
    assert (avatar / "checkpoint.safetensors").exists(), first
    assert not (avatar / "avatar.safetensors").exists(), first
    second = workflow.snakemake("--", TARGET)
    assert second.returncode == 0, second.stdout
    return workflow, first, second.stdout


@pytest.fixture
def workflow(made):
    """The finished project; what a test writes into it is undone by `unchanged`."""
    return made[0]


@pytest.fixture
def unchanged(workflow):
    """Restores the file that a test edits."""
    path = workflow.folder / "config/subjects/tiny.yaml"
    text = path.read_text()
    yield
    path.write_text(text)


def test_every_stage_ran_once_and_killed_training_went_on(made):
    workflow, first, second = made
    finished = [
        re.findall(r"^Finished jobid: \d+ \(Rule: (\w+)\)", printed, re.MULTILINE) for printed in (first, second)
    ]
    assert set(finished[0]) == STAGES - {"train_avatar", "evaluate_avatar"}
    assert finished[1] == ["train_avatar", "evaluate_avatar"]
    log = (workflow.folder / "results/tiny/logs/train_avatar.full.log").read_text()
    assert int(re.search(r"continuing after (\d+) steps", log)[1]) >= 10
    assert not (workflow.folder / "results/tiny/avatars/full/checkpoint.safetensors").exists()


@pytest.fixture(scope="module")
def again(copy_of_project, tmp_path_factory):
    """A second run, from nothing and on one core, and strace's file of it; none where it cannot trace."""
    folder = tmp_path_factory.mktemp("again")
    trace = None if system_calls.why_not() else folder / "trace"
    with StageServer(trace) as server:
        project = copy_of_project(folder / "project").with_stages_of(server)
        run = project.snakemake("--cores", "1", "--", TARGET)
    assert run.returncode == 0, run.stdout
    return project.folder, trace


def test_one_core_from_nothing_gives_the_same_bytes(workflow, again):
    """Those of two cores, of processes of their own, and of a training that was killed and went on."""
    assert not differences(digests(workflow.folder), digests(again[0]))


def test_no_stage_opens_a_connection(again):
    """Not even where compiled code does it, which Python's own hooks do not see."""
    if reason := system_calls.why_not():
        pytest.skip(reason)
    trace = again[1].read_text()
    assert "AF_UNIX" in trace  # Of the server that forks the stages.
    assert not system_calls.beyond_this_machine(trace)


def test_stages_read_no_file_that_their_rules_do_not_declare(again):
    """Whatever else they read could change, and nothing would run again."""
    if reason := system_calls.why_not():
        pytest.skip(reason)
    folder, trace = again
    read = read_results(trace.read_text(), folder, STAGES)
    assert set(read) >= STAGES - {"synthesize_capture", "index_capture"}
    assert undeclared(read, declared(folder)) == []


def test_metrics_have_a_row_per_variant_split_and_light(workflow):
    table = pd.read_csv(workflow.folder / TARGET)
    assert set(table.subject) == {"tiny"}
    assert set(table.variant) == {"full"}
    assert {"test", "test_cameras", "test_frames", "test_segments"} <= set(table.split)
    scored = table[table.images > 0]
    assert len(scored)
    assert scored[["psnr_db", "ssim", "flip"]].notna().all(axis=None)
    per_image = pd.read_parquet(workflow.folder / "results/tiny/metrics_per_image.parquet")
    assert len(per_image) >= scored.images.max()


def test_scores_are_those_that_were_committed(workflow):
    """A change that costs, or gains, more than roundings shows here; `make results/comparison.csv` then says where."""
    table = pd.read_csv(workflow.folder / TARGET).set_index(["split", "lit"])
    assert table.psnr_db["test", "all"] == pytest.approx(COMMITTED_DB, abs=SAME_DB)


def test_every_stage_left_a_log_and_a_benchmark(workflow):
    for kind in ("logs", "benchmarks"):
        found = {path.name.split(".")[0] for path in (workflow.folder / "results/tiny" / kind).iterdir()}
        assert found == STAGES


def test_finished_run_has_nothing_to_do(workflow):
    assert workflow.planned(TARGET) == {}


def test_touched_files_and_comments_rerun_nothing(made, tmp_path):
    workflow = made[0].copied(tmp_path / "project").with_own_code()
    for path in [*workflow.folder.glob("results/tiny/**/*.*"), *workflow.folder.glob("captures/tiny/**/*.*")]:
        os.utime(path)
    workflow.append("pipeline/stages/track_mesh.py", "# A comment.\n")
    assert workflow.planned(TARGET) == {}


@pytest.mark.usefixtures("unchanged")
@pytest.mark.parametrize(
    ("section", "change", "expected"),
    [
        ("evaluate_avatar", "pictures: false", {"evaluate_avatar_without_pictures"}),
        ("train_avatar", "weight_mask: 0.2", {"train_avatar", "evaluate_avatar"}),
        ("pack_shards", "margin_px: 9", {"pack_shards", "train_avatar", "evaluate_avatar"}),
    ],
)
def test_changed_setting_reruns_its_stage_and_what_follows(workflow, section, change, expected):
    path = workflow.folder / "config/subjects/tiny.yaml"
    if f"\n{section}:\n" in path.read_text():
        workflow.edit("config/subjects/tiny.yaml", f"\n{section}:\n", f"\n{section}:\n  {change}\n")
    else:
        workflow.append("config/subjects/tiny.yaml", f"{section}: {{{change}}}\n")
    assert set(workflow.planned(TARGET)) == expected


def test_flowchart_is_the_rule_graph(workflow):
    """The page of stages shows the rule graph without the edges that a longer way implies."""
    done = workflow.snakemake("--rulegraph", "mermaid-js", "--", TARGET)
    names = dict(re.findall(r"(id\d+)\[(\w+)\]", done.stdout))
    edges = {(names[a], names[b]) for a, b in re.findall(r"(id\d+) --> (id\d+)", done.stdout)}

    def ways(start):
        nexts = [b for a, b in edges if a == start]
        return set(nexts).union(*(ways(b) for b in nexts))

    reduced = {(a, b) for a, b in edges if not any(b in ways(c) for x, c in edges if x == a and c != b)}
    rules = set(names.values())
    shown = {(before, stage) for stage, waits in FLOW.items() for before in waits if {before, stage} <= rules}
    assert shown == reduced


def test_report_and_snakemakes_own_of_a_finished_run(workflow, stage_server, tmp_path):
    copy = workflow.copied(tmp_path / "project").with_stages_of(stage_server)
    target = "results/tiny/report/index.html"
    assert copy.ran(target) == ["write_report"]
    page = (copy.folder / target).read_text()
    missing = re.findall(r'<p class="missing"><b>Missing:</b> (.*?)\. To make it: <code>make (.*?)</code>', page)
    assert [command for _, command in missing] == [
        "results/tiny/relit/VARIANT/LIGHT",
        "effects",
        "results/tiny/calibration/review",
        "results/tiny/tracking/review",
        "results/tiny/accuracy_cost.csv",
        "results/tiny/error_budget",
        "scaling",
        "hard-cases",
    ]
    assert all(f">{stage}<" in page for stage in STAGES)
    done = copy.snakemake("--report", "snakemake.html", "--", target)
    assert done.returncode == 0, done.stdout
    shown = re.findall(r"^Adding (\S+)", done.stdout, re.MULTILINE)
    assert sorted(shown) == ["ablations.csv", "atlas.png", "index.html", "metrics.csv", "sync.png"]
    assert (copy.folder / "snakemake.html").stat().st_size > 1e6


def test_viewer_of_an_analytic_variant_is_the_pipelines_picture(workflow, stage_server, tmp_path):
    """The workflow trains the variant and writes its page; a browser shows what the evaluation would render."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="the Python package playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium: apt-get install chromium")
    copy = workflow.copied(tmp_path / "project").with_stages_of(stage_server)
    target = "results/tiny/viewer/index.html"
    short = "steps: 10, steps_together: 1"  # the two pictures have to be one of any avatar
    copy.append("config/subjects/tiny.yaml", f"variants: {{analytic: {{shading: microfacet, {short}}}}}\n")
    assert {"train_avatar", "export_viewer"} <= set(copy.ran(target))
    results = copy.folder / "results/tiny"
    loaded = load_avatar(results / "avatars/analytic", results / "atlas.safetensors")
    frames = read_frame_shards([results / "shards/frames"])
    images = read_image_shards([results / "shards/test"])
    with sync_api.sync_playwright() as playwright:
        page = launch(playwright).new_page()
        assert open_page(page, copy.folder / target) == "open"
        facts = page.evaluate("scene.facts")
        places = {frame["frame"]: place for place, frame in enumerate(facts["frames"])}
        scores = []
        for image in images[:ENOUGH]:
            place = places[image.frame]
            lit = [
                lamp(facts["lights"][light]["position"], rgb, light)
                for light, *rgb in facts["frames"][place]["pattern"]
            ]
            rgb, alpha = (tensor.numpy() for tensor in loaded.render(frames[image.frame], image))
            shown = page_picture(page, place, image, lit, 1.0)
            scores.append(psnr_db(shown, srgb_from_linear(rgb.clip(0, 1)), alpha > 0.5))
    assert len(scores) == min(ENOUGH, len(images))
    assert min(scores) >= PARITY_DB, scores
