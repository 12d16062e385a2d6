"""Files of jobs, from the configuration and what is planned, without Snakemake."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pytest
import yaml

from pipeline.base.errors import InputError
from pipeline.budget.resolved_project import resolve_budgets
from pipeline.config.loading import load_project
from pipeline.workflow.job_files import JobFiles, compared_scores, read_kind, read_planned
from pipeline.workflow.rule_words import NO_NAME, estimate_json, light_file, one_of, subject_pattern

OWN_LIGHT = {"full": {}, "few": {"trace_irradiance": {"samples": "4"}}}


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A function: a project in the current folder with a synthetic subject of three chunks."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "config/subjects"
    folder.mkdir(parents=True)

    def load(**settings):
        made = {"source": "synthetic", "chunk_frames": 10, "synthesize_capture": {"frames": 24}, **settings}
        (folder / "someone.yaml").write_text(yaml.safe_dump(made, sort_keys=False))
        return load_project({}, {}, folder)

    return load


def test_unknown_variant_and_chunk_are_refused_by_name(project):
    loaded = project(variants={"full": {}, "matte": {"specular": False}})
    with pytest.raises(InputError, match="someone: variant 'gloss': expected one of full, matte, found no such"):
        JobFiles(loaded, "someone", "gloss")
    with pytest.raises(InputError, match="someone: chunk '0003': expected 0000 to 0002"):
        JobFiles(loaded, "someone", chunk="0003")


def test_set_is_imported_anew_when_a_file_that_the_settings_name_changes(project, tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set/all_cam.json").write_text("{}")
    named = {"mesh": "egg.obj", "light_patterns": "lights.csv"}
    loaded = project(source="openillumination", path=str(tmp_path / "set"), import_capture=named)
    expected = [str(tmp_path / "set/all_cam.json"), "egg.obj", "lights.csv"]
    assert JobFiles(loaded, "someone").dataset_files() == expected


def test_chunks_of_a_job_are_its_own_or_all(project):
    loaded = project()
    pattern = "tracking/{chunk}.safetensors"
    everything = [f"results/someone/tracking/{chunk}.safetensors" for chunk in ("0000", "0001", "0002")]
    assert JobFiles(loaded, "someone").each_chunk(pattern) == everything
    assert JobFiles(loaded, "someone", chunk="0001").each_chunk(pattern) == everything[1:2]


def test_names_of_a_job_are_files_and_words(project):
    named = JobFiles(project(), "someone", "full", "0001").named()
    assert named["tracking"] == "results/someone/tracking/0001.safetensors"
    assert named["avatar"] == "results/someone/avatars/full" and named["results"] == "results/someone"
    assert (named["capture"], named["chunk"], named["chunk_size"]) == ("captures/someone", "0001", "10")
    assert {"tracking", "avatar", "chunk", "variant"}.isdisjoint(JobFiles(project(), "someone").named())


class TestShards:
    def test_all_chunks_are_expected(self, project):
        found = JobFiles(project(), "someone").shards("shards/train")
        assert found == [f"results/someone/shards/train/{chunk}.arrow" for chunk in ("0000", "0001", "0002")]

    def test_stale_files_are_named_and_refused(self, project):
        folder = Path("results/someone/shards/train")
        folder.mkdir(parents=True)
        for chunk in ("0000", "0003", "0007"):
            (folder / f"{chunk}.arrow").touch()
        stale = re.escape(f"left over from other chunks of frames, delete: {folder}/0003.arrow {folder}/0007.arrow")
        with pytest.raises(InputError, match=stale):
            JobFiles(project(), "someone").shards("shards/train")

    def test_hidden_files_of_killed_stages_are_not_stale(self, project):
        folder = Path("results/someone/shards/train")
        folder.mkdir(parents=True)
        (folder / ".b26333b1.0000.arrow").touch()
        assert len(JobFiles(project(), "someone").shards("shards/train")) == 3


class TestFrames:
    def test_variant_with_other_maps_has_frames_of_its_own(self, project):
        loaded = project(variants=OWN_LIGHT)
        folders = ["results/someone/shards/frames", "results/someone/variants/few/frames"]
        assert JobFiles(loaded, "someone").frame_folders() == folders
        assert JobFiles(loaded, "someone", "few").frame_folders() == folders[1:]
        assert len(JobFiles(loaded, "someone").frame_shards()) == 6

    def test_variants_with_the_subjects_maps_share_one_folder(self, project):
        files = JobFiles(project(variants={"full": {}, "matte": {"specular": False}}), "someone")
        assert files.frame_folders() == ["results/someone/shards/frames"] * 2
        assert len(files.frame_shards()) == 3


class TestPlanned:
    def test_maps_are_traced_where_shadows_are_on(self, project):
        papers = {"shading": "transfer"}
        files = JobFiles(project(variants=OWN_LIGHT, train_avatar=papers), "someone", chunk="0002")
        assert files.traced_irradiance(["shadow"], "body") == ["results/someone/irradiance/0002.parquet"]
        assert files.traced_irradiance([], "body") == []
        own = JobFiles(files.project, "someone", "few", "0002").traced_irradiance(["shadow"], "body")
        assert own == ["results/someone/variants/few/irradiance/0002.parquet"]
        default = JobFiles(project(), "someone", chunk="0002")
        assert default.traced_irradiance(["shadow"], "body") == []  # each light is traced in training

    def test_textures_are_of_heads(self, project):
        files = JobFiles(project(variants={"full": {"avatar": "head"}}), "someone", chunk="0000")
        assert files.mean_textures("head") == ["results/someone/textures/0000.safetensors"]
        assert JobFiles(project(), "someone").mean_textures("body") == []

    def test_eyes_are_of_avatars_that_have_them(self, project):
        files = JobFiles(project(), "someone", "full")
        assert files.fitted_eyes(["eyes"]) == ["results/someone/eyes.json"]
        assert files.fitted_eyes([]) == []

    def test_gaze_is_estimated_for_eyes_without_one(self, project, tmp_path):
        def asked(described, **settings):
            (tmp_path / "capture.json").write_text(json.dumps(described))
            return JobFiles(project(**settings), "someone").estimated_gaze(tmp_path / "capture.json")

        eyes = {"kind": "head", "template": {"eyes": ["left"]}}
        assert asked(eyes | {"gaze": False}) == ["results/someone/gaze.parquet"]
        assert asked(eyes | {"gaze": False}, estimate_gaze={"mode": "off"}) == []
        assert asked(eyes) == asked({"kind": "head", "template": {"eyes": []}, "gaze": False}) == []

    def test_a_variant_waits_for_the_avatar_whose_geometry_it_takes(self, project):
        loaded = project(variants={"full": {}, "pbr": {"geometry_from": "full"}})
        found = JobFiles(loaded, "someone", "pbr").given_geometry()
        assert found == [f"results/someone/avatars/full/{name}" for name in ("avatar.safetensors", "config.json")]
        assert JobFiles(loaded, "someone", "full").given_geometry() == []

    def test_effects_and_kind_are_read_from_their_files(self, tmp_path):
        (tmp_path / "effects.json").write_text(json.dumps({"shadow": {"on": True}, "eyes": {"on": False}}))
        (tmp_path / "capture.json").write_text(json.dumps({"kind": "head"}))
        assert read_planned(tmp_path / "effects.json") == ["shadow"]
        assert read_kind(tmp_path / "capture.json") == "head"


def test_avatars_are_those_of_the_job(project):
    loaded = project(variants=OWN_LIGHT)
    files = ["results/someone/avatars/full/config.json", "results/someone/avatars/few/config.json"]
    assert JobFiles(loaded, "someone").avatars("config.json") == files
    assert JobFiles(loaded, "someone", "few").avatars() == ["results/someone/avatars/few"]


def test_origin_of_a_synthetic_capture_is_code_and_settings(project):
    loaded = project()
    origin = JobFiles(loaded, "someone").capture_origin()
    assert re.fullmatch("[0-9a-f]{32}", origin[0]) and origin[origin.index("--frames") + 1] == "24"
    assert JobFiles(loaded, "recorded").capture_origin() == []


def test_unknown_subject_has_no_capture_files(project):
    with pytest.raises(InputError, match=r"subject 'nobody': expected captures/nobody/capture\.yaml"):
        JobFiles(project(), "nobody").capture_files()


def test_tables_that_drive_and_pictures_are_those_of_the_settings(project):
    loaded = project(relight_avatar={"codes": "a.csv"}, evaluate_avatar={"pictures": False})
    assert JobFiles(loaded, "someone", "full").driving_tables() == ["a.csv"]
    assert JobFiles(loaded, "someone").score_pictures() == []
    assert JobFiles(project(), "someone").score_pictures() == ["results/someone/images"]


def test_optional_files_of_a_report_have_digests_of_their_content(project):
    files = JobFiles(project(), "someone")
    assert files.optional_digests() == {}
    for name in ("results/hard_cases.csv", "results/scaling/a.csv", "results/someone/tracking/review/b.png"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text(name)
    Path("results/someone/other.csv").write_text("not shown")
    found = files.optional_digests()
    assert found == {name: hashlib.sha256(name.encode()).hexdigest() for name in found} and len(found) == 3


def test_pattern_of_subjects_covers_those_without_a_file(project):
    loaded = project(evaluate_avatar={"pictures": False})
    shown = subject_pattern(loaded, lambda settings: settings.evaluate_avatar.pictures)
    hidden = subject_pattern(loaded, lambda settings: not settings.evaluate_avatar.pictures)
    for name, pattern, other in (("anyone", shown, hidden), ("someone", hidden, shown)):
        assert re.match(f"(?:{pattern})/", f"{name}/") and not re.match(f"(?:{other})/", f"{name}/")
    assert one_of([]) == NO_NAME and not re.match(NO_NAME, "anything")


def test_light_is_one_file_of_its_name(project):
    project()
    folder = Path("config/lights")
    folder.mkdir()
    with pytest.raises(InputError, match=r"one file named sky with the suffix \.hdr, .*found 0"):
        light_file("sky")
    (folder / "sky.exr").touch()
    assert light_file("sky") == "config/lights/sky.exr"
    (folder / "sky.csv").touch()
    with pytest.raises(InputError, match="found 2"):
        light_file("sky")


def test_estimate_needs_a_budget(project):
    with pytest.raises(InputError, match=r"results/someone/budget\.csv: expected a budget"):
        estimate_json(resolve_budgets(project(), print), "someone")


def test_comparison_is_of_the_subjects_that_are_named_or_of_all(project):
    loaded = project()
    assert compared_scores(loaded) == ["results/someone/metrics_per_image.parquet"]
    chosen = load_project({"compare_subjects": {"subjects": ["a", "b"]}}, {}, Path("config/subjects"))
    assert compared_scores(chosen) == [f"results/{name}/metrics_per_image.parquet" for name in ("a", "b")]


@pytest.mark.parametrize("beside", [False, True])
def test_pictures_beside_captures_wait_for_all_images_there_are(project, beside):
    """A picture may be of any captured image, whichever split it is in."""
    loaded = project(relight_avatar={"beside_captured": beside})
    found = JobFiles(loaded, "someone", chunk="0001").captured_shards()
    every = [f"results/someone/shards/{split}/0001.arrow" for split in ("train", "validation", "test")]
    assert found == every * beside
