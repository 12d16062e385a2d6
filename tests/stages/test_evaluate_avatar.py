"""The evaluation stage on planted shards, with renderers whose errors are known."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch

from pipeline.avatar.intrinsic_layers import IntrinsicLayers
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.base.errors import InputError
from pipeline.base.files import write_table
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import (
    read_frame_shards,
    read_image_shards,
    write_frame_shard,
    write_image_shard,
)
from pipeline.config.effects import EFFECTS
from pipeline.config.evaluate_avatar import EvaluateAvatar
from pipeline.metrics.ablation_rows import spread_in_a_row
from pipeline.metrics.evaluation import TEST_FLAGS
from pipeline.stages import evaluate_avatar
from tests.support.avatars.sheet import make_sheet

LEVEL = 0.25


class PlantedAvatar(LoadedAvatar):
    """Renders the captured image plus a constant error, and fails on a frame that is not the image's. The error grows
    with the irradiance that the frame carries."""

    def __init__(self, error: float) -> None:
        self.error = error

    def trace(self, frame: FrameRecord) -> FrameRecord:
        return frame

    def render(self, frame: FrameRecord, image: ImageRecord) -> tuple[torch.Tensor, torch.Tensor]:
        assert frame.frame == image.frame
        mask = torch.tensor(image.mask)
        return (torch.full((image.height, image.width, 3), LEVEL + self.error * float(frame.irradiance[0]))) * mask[
            ..., None
        ], mask

    def intrinsic_layers(self, frame: FrameRecord, image: ImageRecord) -> IntrinsicLayers:
        assert frame.frame == image.frame
        color, one = torch.full((image.height, image.width, 3), LEVEL), torch.ones(image.height, image.width, 1)
        normal = torch.tensor([0.0, 0.0, -1.0]).expand_as(color)
        return IntrinsicLayers(color, normal, color, torch.zeros_like(color), one, one, one, shadow=one)


def record(camera: str, frame: int, **flags) -> ImageRecord:
    mask = np.zeros((40, 36), np.float32)
    mask[3:-3, 2:-2] = 1
    held_out = dict.fromkeys(("test_camera", "test_frame", "test_segment", "test_pattern"), False)
    all_flags = {**held_out, "fully_lit": frame % 2 == 0, **flags}
    image, eye = np.full((40, 36, 3), LEVEL, np.float32), np.eye(3)
    return ImageRecord(camera, frame, **all_flags, x0=0, y0=0, width=36, height=40, image=image, mask=mask,
                       K=eye, R=eye, t=np.zeros(3))  # fmt: skip


@pytest.fixture
def results(tmp_path, monkeypatch):
    records = [record("c0", 0, test_camera=True), record("c0", 1, test_camera=True, test_frame=True)]
    records += [record("c1", 1, test_frame=True), record("c1", 2, test_segment=True)]
    write_image_shard(tmp_path / "shards/test/0000.arrow", records)
    write_image_shard(tmp_path / "shards/validation/0000.arrow", [])
    ones = np.ones((2, 3), np.float32)
    share = np.ones(4, np.float32)
    frames = [FrameRecord(f, "a", f % 2 == 0, ones, share, share, ones, ones) for f in range(3)]
    write_frame_shard(tmp_path / "shards/frames/0000.arrow", frames)
    (tmp_path / "effects.json").write_text(json.dumps({name: {"on": name != "shadow"} for name in EFFECTS}))
    errors = {"good": 0.01, "bad": 0.1}
    for position, name in enumerate(errors):
        folder = tmp_path / "avatars" / name
        folder.mkdir(parents=True)
        (folder / "config.json").write_text(json.dumps({"parameters": 10 + position, "built": name, "why": "planted"}))
        pd.DataFrame({"step": [0, 9], "seconds": [0.5, 2.5]}).to_parquet(folder / "log.parquet")
    monkeypatch.setattr(evaluate_avatar, "load_avatar", lambda folder, atlas: PlantedAvatar(errors[folder.name]))
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "no cache"))
    return tmp_path


def evaluate(results, *variants: str, frames=(), **settings):
    evaluate_avatar.run(
        atlas=results / "atlas.safetensors",
        shards=results / "shards",
        effects=results / "effects.json",
        avatars=tuple(results / "avatars" / name for name in variants),
        out=results,
        subject="someone",
        frames=frames,
        settings=EvaluateAvatar(**settings),
    )


class TestSharedByJobs:
    """Two jobs score the images of two and one chunks of frames, a third joins their tables."""

    @pytest.fixture
    def chunks(self, results):
        """The same images, and others of validation, in three chunks of a frame each."""
        folder = results / "shards"
        records = {name: read_image_shards([folder / name])[:] for name in ("test", "validation")}
        records["validation"] = [record("c2", frame, validation=True) for frame in range(3)]
        frames = read_frame_shards([folder / "frames"])
        for frame, held in frames.items():
            for name, images in records.items():
                own = [image for image in images if image.frame == frame]
                write_image_shard(folder / f"new/{name}/{frame:04d}.arrow", own)
            write_frame_shard(folder / f"new/frames/{frame:04d}.arrow", [held])
        folder.rename(results / "before")
        (results / "before/new").rename(folder)
        return results

    def share(self, results, chunk, chunks, variants=("good",)):
        evaluate_avatar.run(
            atlas=results / "atlas.safetensors", shards=results / "shards", effects=results / "effects.json",
            avatars=tuple(results / "avatars" / name for name in variants), out=results / "scores" / variants[0],
            subject="someone", chunk=chunk, chunks=chunks, settings=EvaluateAvatar(pictures=False),
        )  # fmt: skip

    def joined(self, results):
        evaluate_avatar.run(
            atlas=results / "atlas.safetensors", shards=results / "shards", effects=results / "effects.json",
            avatars=(results / "avatars/good",), out=results, subject="someone", scores=results / "scores",
        )  # fmt: skip
        return {path.name: path.read_bytes() for path in self.written(results)}

    def written(self, results):
        names = ("metrics.csv", "metrics_per_image.parquet", "ablations.csv")
        return [*(results / name for name in names), *(results / "images").iterdir()]

    def test_tables_and_pictures_have_the_same_bytes_and_nothing_is_scored_again(self, chunks, monkeypatch):
        evaluate(chunks, "good")
        expected = {path.name: path.read_bytes() for path in self.written(chunks)}
        assert len(pd.read_parquet(chunks / "metrics_per_image.parquet")) == 7
        self.share(chunks, 0, 2)
        self.share(chunks, 2, 1)
        monkeypatch.delattr(evaluate_avatar, "evaluate")
        assert self.joined(chunks) == expected

    def test_lost_and_repeated_scores_are_refused(self, chunks):
        self.share(chunks, 0, 2)
        with pytest.raises(InputError, match=r"expected scores of each of 7 .* found 5 of them, 0 repeated"):
            self.joined(chunks)
        self.share(chunks, 1, 2)
        with pytest.raises(InputError, match="found 4 of them, 3 repeated and 0 of other images; delete the folder"):
            self.joined(chunks)
        shutil.rmtree(chunks / "scores/good")
        with pytest.raises(InputError, match="scores/good: expected tables of scores, found none"):
            self.joined(chunks)

    def test_a_share_is_of_one_avatar(self, chunks):
        with pytest.raises(InputError, match="expected one folder, as a chunk is scored for each alone, found 2"):
            self.share(chunks, 0, 1, ("good", "bad"))


def expected_psnr(error: float) -> float:
    def srgb(v):
        return 1.055 * v ** (1 / 2.4) - 0.055

    return -20 * math.log10(srgb(LEVEL + error) - srgb(LEVEL))


def test_ablations_have_a_row_per_variant_with_scores_and_costs(results):
    evaluate(results, "good", "bad")
    table, metrics, times = (
        pd.read_csv(results / name) for name in ("ablations.csv", "metrics.csv", "avatar_times.csv")
    )
    assert table[["variant", "parameters"]].values.tolist() == [["good", 10], ["bad", 11]]
    assert times[["variant", "training_seconds"]].values.tolist() == [["good", 2.5], ["bad", 2.5]]
    assert (times.render_milliseconds > 0).all()
    assert table.psnr_db_partial.tolist() == pytest.approx([expected_psnr(0.01), expected_psnr(0.1)], abs=0.01)
    row = metrics[(metrics.variant == "bad") & (metrics.split == "test") & (metrics.lit == "full")].iloc[0]
    assert table.ssim_full[1] == pytest.approx(row.ssim) and table.flip_full[1] == pytest.approx(row.flip)
    assert table.lpips_all.isna().all()
    assert table.psnr_db_held_out_lights.tolist() == pytest.approx([expected_psnr(0.01), expected_psnr(0.1)], abs=0.01)
    row = metrics[(metrics.variant == "bad") & (metrics.split == "held_out_segments") & (metrics.lit == "all")].iloc[0]
    assert table.ssim_held_out_segments[1] == pytest.approx(row.ssim)
    lost = expected_psnr(0.1) - expected_psnr(0.01)
    assert table.psnr_db_held_out_lights_gain.tolist() == pytest.approx([0, lost], abs=0.01)


def test_errors_of_ablations_are_those_of_blocks_of_frames():
    """Four frames of one image each are four blocks: the error is that of a mean of four."""
    own, first = np.array([20.0, 22.0, np.nan, 27.0, 24.0]), np.array([19.0, 22.0, 30.0, 25.0, 24.0])
    flags = dict.fromkeys((*TEST_FLAGS, "fully_lit", "validation"), False)
    rows = pd.DataFrame({"frame": [3, 5, 6, 7, 9], "psnr_db": own, "ssim": 0.5, "flip": 0.1}).assign(**flags)
    rows.test_frame = True
    found = spread_in_a_row(rows, rows.assign(psnr_db=first))
    known = np.isfinite(own)
    for name, values in (("_error", own[known]), ("_gain_error", (own - first)[known])):
        expected = values.std(ddof=1) / np.sqrt(len(values))
        assert found[f"psnr_db_held_out_lights{name}"] == pytest.approx(expected)
    assert found["psnr_db_held_out_lights_gain"] == pytest.approx((own - first)[known].mean())
    assert math.isnan(found["psnr_db_validation_error"]) and found["ssim_held_out_lights_error"] == 0


def test_each_avatar_is_lit_by_its_own_frames(results):
    default = results / "shards/frames"
    brighter = [replace(frame, irradiance=2 * frame.irradiance) for frame in read_frame_shards([default]).values()]
    write_frame_shard(results / "own/0000.arrow", brighter)
    evaluate(results, "good", "bad", frames=(default, results / "own"))
    table = pd.read_csv(results / "ablations.csv")
    assert table.psnr_db_all.tolist() == pytest.approx([expected_psnr(0.01), expected_psnr(0.2)], abs=0.01)
    with pytest.raises(InputError, match="a folder for each of 2 avatars, found 1"):
        evaluate(results, "good", "bad", frames=(default,))


def test_the_table_says_what_was_planted(results):
    evaluate(results, "good", "bad")
    table = pd.read_csv(results / "metrics.csv")
    assert table.columns.tolist() == [
        "subject", "variant", "split", "lit", "images", "foreground_pixels", "psnr_db", "ssim", "lpips", "flip",
        "built", "why", "color_space", "region", "protocol", "lpips_net", "lpips_weights",
    ]  # fmt: skip
    assert len(table) == 2 * 10 * 3
    assert set(table.subject) == {"someone"}
    assert set(table.color_space) == {"sRGB"} and set(table.why) == {"planted"}
    assert (table.built == table.variant).all()
    rows = table.set_index(["variant", "split", "lit"])
    assert rows.loc[("good", "test", "all")].psnr_db == pytest.approx(expected_psnr(0.01), abs=0.01)  # float16 of 0.25
    assert rows.loc[("bad", "test_frames", "partial")].psnr_db == pytest.approx(expected_psnr(0.1), abs=0.01)
    assert rows.loc["good"].images.to_dict() == {
        ("test", "all"): 4, ("test", "full"): 2, ("test", "partial"): 2,
        ("test_cameras", "all"): 2, ("test_cameras", "full"): 1, ("test_cameras", "partial"): 1,
        ("test_frames", "all"): 2, ("test_frames", "full"): 0, ("test_frames", "partial"): 2,
        ("test_segments", "all"): 1, ("test_segments", "full"): 1, ("test_segments", "partial"): 0,
        ("validation", "all"): 0, ("validation", "full"): 0, ("validation", "partial"): 0,
        ("test_patterns", "all"): 0, ("test_patterns", "full"): 0, ("test_patterns", "partial"): 0,
        ("held_out_segments", "all"): 1, ("held_out_segments", "full"): 1, ("held_out_segments", "partial"): 0,
        ("held_out_lights", "all"): 1, ("held_out_lights", "full"): 0, ("held_out_lights", "partial"): 1,
        ("novel_view_and_pose", "all"): 1, ("novel_view_and_pose", "full"): 0, ("novel_view_and_pose", "partial"): 1,
        ("novel_view_and_light", "all"): 0, ("novel_view_and_light", "full"): 0, ("novel_view_and_light", "partial"): 0,
    }  # fmt: skip
    empty = rows.loc[("good", "test_frames", "full")]
    assert empty[["psnr_db", "ssim", "lpips", "flip"]].isna().all()
    assert empty.foreground_pixels == 0


def test_lpips_without_weights_is_empty_and_says_why(results):
    evaluate(results, "good", lpips_net="vgg")
    table = pd.read_csv(results / "metrics.csv")
    assert table.lpips.isna().all()
    assert (table.lpips_net == "vgg").all()
    assert table.lpips_weights.str.contains("vgg16-397923af.pth").all()
    single = pd.read_parquet(results / "metrics_per_image.parquet")
    assert len(single) == 4
    assert single.lpips.isna().all()
    assert single.psnr_db.notna().all()


def test_pictures(results):
    evaluate(results, "good", "bad")
    names = sorted(path.name for path in (results / "images").iterdir())
    assert names == [f"{v}_{w}.png" for v in ("bad", "good") for w in ("best", "layers", "median", "worst")]
    evaluate(results, "good", intrinsic_layers=False)
    assert not (results / "images/good_layers.png").exists()


def test_without_pictures_none_are_left(results):
    evaluate(results, "good")
    evaluate(results, "bad", pictures=False)
    assert not (results / "images").exists()
    assert set(pd.read_csv(results / "metrics.csv").variant) == {"bad"}


def test_without_pictures_other_files_stay(results):
    (results / "images").mkdir()
    (results / "images/photograph.png").touch()
    evaluate(results, "good", pictures=False)
    assert [path.name for path in (results / "images").iterdir()] == ["photograph.png"]


def test_no_picture_of_nothing(results):
    for shard in (results / "shards/test").iterdir():
        write_image_shard(shard, [])
    evaluate(results, "good")
    assert (pd.read_csv(results / "metrics.csv").images == 0).all()
    assert not (results / "images").exists()


def test_avatars_must_have_names_of_their_own(results):
    for variants in (("good", "good"), ()):
        with pytest.raises(InputError, match="different names"):
            evaluate(results, *variants)


def test_a_missing_backbone_file_is_an_error(results):
    with pytest.raises(InputError, match="no file"):
        evaluate(results, "good", lpips_backbone=str(results / "absent.pth"))


def test_metric_that_is_asked_for_has_columns_after_the_others(results):
    evaluate(results, "good", metrics=("ms_ssim",))
    table, costs = pd.read_csv(results / "metrics.csv"), pd.read_csv(results / "ablations.csv")
    assert table.columns.tolist()[8:11] == ["lpips", "flip", "ms_ssim"]
    assert table.ms_ssim.isna().all()  # 40 x 36 pixels are fewer than its five scales need
    assert table.region.str.contains("ms_ssim at least 161 px a side").all()
    assert {"ms_ssim_all", "ms_ssim_held_out_lights"} <= set(costs.columns)
    assert "ms_ssim" in pd.read_parquet(results / "metrics_per_image.parquet")


def test_two_eyes_of_the_index_tell_the_face(tmp_path, caplog):
    """Of a square sheet, eyes in two corners of one side: it is as broad as they are apart, and no longer."""
    atlas = make_sheet(8)
    corners = pd.DataFrame({"eye": ["left", "right"], "vertex": [0, 1]})
    write_table(tmp_path / "eyes.parquet", corners)
    assert evaluate_avatar.find_face(atlas, tmp_path) is not None
    write_table(tmp_path / "eyes.parquet", corners[:0])
    assert evaluate_avatar.find_face(atlas, tmp_path) is None
    assert "psnr_face stays empty: the template has no region face" in caplog.text
