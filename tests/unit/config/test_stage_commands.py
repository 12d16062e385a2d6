"""Command lines of stages against the stages' own signatures."""

from __future__ import annotations

import ast

import pytest

from pipeline import STAGES
from pipeline.config.stage_commands import ARGUMENTS, FILES, THREADED, stage_arguments, subject_files

BY_HAND = {
    "index_capture": {"inspected", "chunk", "chunks", "chunk_size"},
    "calibrate_cameras": {"found", "share", "shares"},
    "calibrate_lights": {"measured", "share", "shares"},
    "evaluate_avatar": {"scores", "chunk", "chunks"}, "pack_shards": {"only_frames"},
    "trace_irradiance": {"environment"}, "relight_avatar": {"keyframes"},
}  # fmt: skip
"""Flags that no file of the results feeds."""
OF_THE_MACHINE = {"threads", "workers", "processes", "cache_mb", "scratch"}
"""Flags that say what a machine lends; they change no result, so a rule adds them beside the words of the listing."""


@pytest.mark.parametrize("stage", STAGES)
def test_flags_are_those_of_the_stage(repo_root, stage):
    """All that a stage must be told is told, nothing else; settings and what a machine lends come from elsewhere."""
    tree = ast.parse((repo_root / f"pipeline/stages/{stage}.py").read_text())
    (run,) = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "run")
    known = {argument.arg for argument in run.args.kwonlyargs} - {"settings", *BY_HAND.get(stage, ())}
    flags = {part.partition("=")[0] for part in ARGUMENTS[stage].split()}
    assert known - OF_THE_MACHINE == flags
    assert ("threads" in known) == (stage in THREADED)


def test_words_are_flags_with_the_files_that_feed_them():
    values = {**subject_files("results/someone", chunk="0002"), "capture": "c", "chunk": "0002", "chunk_size": "64"}
    assert stage_arguments("track_mesh", values) == [
        "--capture",
        "c",
        "--index",
        "results/someone/index",
        "--cameras",
        "results/someone/calibration/cameras.json",
        "--lights",
        "results/someone/calibration/lights.parquet",
        "--patterns",
        "results/someone/patterns.parquet",
        "--chunk",
        "0002",
        "--chunk-size",
        "64",
        "--out",
        "results/someone/tracking",
    ]


def test_several_files_follow_one_flag_and_none_leave_it_out():
    values = {**subject_files("r"), "tracking": ["a", "b"]}
    words = stage_arguments("fit_eyes", values)
    assert words[words.index("--tracking") :] == ["--tracking", "a", "b", "--out", "r/eyes.json"]
    assert "--tracking" not in stage_arguments("fit_eyes", {**values, "tracking": []})


def test_file_that_nobody_named_is_an_error():
    with pytest.raises(KeyError, match="tracking"):
        stage_arguments("fit_eyes", subject_files("r"))


def test_files_of_chunks_and_variants_need_one():
    assert FILES.keys() - subject_files("r").keys() == {"tracking", "irradiance", "baked", "textures", "avatar"}
    assert subject_files("r", "0001", "full")["avatar"] == "r/avatars/full"
    assert subject_files("r", "0001")["textures"] == "r/textures/0001.safetensors"
