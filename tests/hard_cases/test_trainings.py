"""Whole trainings on captures that lack something: they end with finite numbers, and the log says what is missing."""

from __future__ import annotations

import dataclasses
import json
import logging
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch

import pipeline.stages.train_avatar as stage
from pipeline.avatar.geometry.gaussians_on_texels import START_OPACITY
from pipeline.avatar.texels import posed_texels, texel_store
from pipeline.avatar.training.checkpoint import LoadedAvatar, load_avatar
from pipeline.avatar.training.picture_equations import PictureEquations
from pipeline.base.files import read_table
from pipeline.capture.records import FrameRecord, ImageRecord
from pipeline.capture.shards import write_frame_shard, write_image_shard
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import Atlas, write_atlas
from tests.support.avatars.sheet import SIDE_M, make_frame, make_image, make_sheet
from tests.support.avatars.sheet_subject import stage_arguments
from tests.support.results.hard_case import HardCase, worst

TEXELS, PIXELS, STEPS = 16, 16, 20
"""A side of the sheet and of the images; enough steps to see that it learns."""

ALBEDO = np.array([0.7, 0.4, 0.2])
LIGHTS = [[0.5, 0.3, 1.5], [-0.6, 0.0, 1.2], [0.1, -0.5, 1.4]]

SETTINGS = {
    "shading": "microfacet", "indirect": "none", "steps": STEPS, "steps_together": 1, "log_every": 1,
    "preview_every": 0, "device": "cpu",
}  # fmt: skip

LEARNED = 0.2
"""Median error of the pictures that were learned, of their brightest pixel; at the start it is a third or so."""

ROUNDED = 1e-5
"""Of the brightest pixel, between pictures of subjects of two sizes after one step: some hundred roundings of 6e-8, as
a pixel blends dozens of texels, each placed, scaled and lit with a few."""

SIGNS = 0.02
"""The same after all steps. L1 has kinks: where a rounding decides on which side a pixel is, Adam takes the whole step
the other way. One of 3e-2 for an albedo of 0.5, of one texel of the dozen that a pixel shows, is 0.5 %."""


def frames_of(lights: Sequence[Sequence[Sequence[float]]], power: float = 3.0) -> list[FrameRecord]:
    """A frame for each list of lights, not taken for fully lit, so that lights are refined."""
    sheet = make_sheet(TEXELS)
    frames = [
        make_frame(sheet, np.array(lit), np.full((len(lit), 3), power / len(lit)), i) for i, lit in enumerate(lights)
    ]
    return [dataclasses.replace(frame, fully_lit=False) for frame in frames]


def images_of(frames: Sequence[FrameRecord], shifts: Sequence[float] = (-0.2, 0.2)) -> list[ImageRecord]:
    return [make_image(frame, ALBEDO, shift, PIXELS) for frame in frames for shift in shifts]


def darkened(image: ImageRecord) -> ImageRecord:
    return dataclasses.replace(image, image=np.zeros_like(image.image))


@dataclasses.dataclass(frozen=True)
class Trained:
    """What a training left: avatar, photometric errors of all steps, and what it warned of."""

    loaded: LoadedAvatar
    photometric: np.ndarray
    said: str

    def not_finite(self) -> int:
        """Number of parameters and losses that are not finite."""
        parameters = [p.detach().numpy() for p in self.loaded.avatar.parameters()]
        return sum(int((~np.isfinite(values)).sum()) for values in [*parameters, self.photometric])

    def pictures(self, frames: Sequence[FrameRecord], images: Sequence[ImageRecord]) -> np.ndarray:
        """Linear RGB of all images as the avatar has them."""
        return np.stack([self.loaded.render(frames[image.frame], image)[0].numpy() for image in images])

    def error(self, frames: Sequence[FrameRecord], images: Sequence[ImageRecord]) -> float:
        """Median error of the subject's pixels, of the brightest; NaN if any is not finite."""
        wanted, subject = np.stack([image.image for image in images]), np.stack([image.mask > 0 for image in images])
        off = np.abs(self.pictures(frames, images) - wanted)
        return float(np.median(off[subject])) / (float(wanted.max()) or 1.0) if np.isfinite(off).all() else np.nan


Train = Callable[..., Trained]


@pytest.fixture
def train(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> Train:
    """Train on frames and images by the stage, from its files."""

    def run(frames: list[FrameRecord], images: list[ImageRecord], atlas: Atlas | None = None, **settings: object):
        folder = tmp_path / f"subject{len(list(tmp_path.iterdir()))}"
        write_atlas(folder / "atlas.safetensors", atlas or make_sheet(TEXELS))
        write_frame_shard(folder / "shards/frames/0000.arrow", frames)
        write_image_shard(folder / "shards/train/0000.arrow", images, "float32")
        off = {"eyes", "shadow"}
        (folder / "effects.json").write_text(json.dumps({name: {"on": name not in off} for name in EFFECTS}))
        caplog.clear()
        with caplog.at_level(logging.WARNING):
            chosen = TrainAvatar(**{**SETTINGS, **settings})
            stage.run(**stage_arguments(folder), settings=chosen, out=folder / "avatar", processes=1)
        photometric = read_table(folder / "avatar/log.parquet").photometric.to_numpy()
        return Trained(load_avatar(folder / "avatar", folder / "atlas.safetensors"), photometric, caplog.text)

    return run


def test_enough_cameras_and_lights(case: HardCase, train: Train) -> None:
    """What is not hard: nothing is said to be lacking."""
    frames = frames_of([[light] for light in LIGHTS])
    done = train(frames, images := images_of(frames))
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert not done.said


def test_one_camera(case: HardCase, train: Train) -> None:
    frames = frames_of([[light] for light in LIGHTS])
    done = train(frames, images := images_of(frames, (0.1,)))
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert "all images are seen from one place (x0.1)" in done.said


def test_one_light(case: HardCase, train: Train) -> None:
    frames = frames_of([LIGHTS[:1]] * 3)
    done = train(frames, images := images_of(frames))
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert "one light lights all frames: how the subject looks under others is a guess" in done.said


def test_one_camera_and_one_image_under_one_light(case: HardCase, train: Train) -> None:
    frames = frames_of([LIGHTS[:1]])
    done = train(frames, images := images_of(frames, (0.1,)))
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert "all images are seen from one place" in done.said
    assert "one light lights all frames" in done.said


def test_no_light_is_ever_on(case: HardCase, train: Train) -> None:
    """Black by right: the pictures are exactly black, and nothing pulls at colours."""
    frames = frames_of([[light] for light in LIGHTS])
    nothing = np.zeros((0, 3), np.float32)
    dark = [dataclasses.replace(f, light_positions=nothing, light_intensities=nothing) for f in frames]
    done = train(dark, [darkened(image) for image in images_of(frames)])
    case.check(done.not_finite(), 0)
    case.check(np.abs(done.photometric).max(), 0)
    assert "no light is on in 3 of 3 frames: 0, 1, 2" in done.said


def test_all_images_are_black(case: HardCase, train: Train) -> None:
    frames = frames_of([[light] for light in LIGHTS])
    lit = images_of(frames)
    done = train(frames, images := [darkened(image) for image in lit], steps=2 * STEPS)
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), np.median([np.median(i.image[i.mask > 0]) for i in lit]) / 3)
    assert "6 of 6 images are black where the subject is: x-0.2/0, x-0.2/1" in done.said


def test_some_images_are_black(case: HardCase, train: Train) -> None:
    frames = frames_of([[light] for light in LIGHTS])
    images = images_of(frames)
    done = train(frames, [darkened(images[0]), *images[1:]])
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert "1 of 6 images are black where the subject is: x-0.2/0" in done.said


def test_texels_beyond_the_border_of_all_images(case: HardCase, train: Train) -> None:
    """Of a sheet whose right half no camera has in its image, texels there keep what they began with."""
    frames = frames_of([[light] for light in LIGHTS])
    half = PIXELS // 2
    cropped = [
        dataclasses.replace(i, width=half, image=i.image[:, :half].copy(), mask=i.mask[:, :half].copy())
        for i in images_of(frames, (0.0, 0.05))
    ]
    done = train(frames, cropped)
    case.check(done.not_finite(), 0)
    avatar = done.loaded.avatar
    # A footprint and the pixel filter reach 10 cm from what is seen, the last of them by a millionth.
    beyond = avatar.atlas.texel[:, 1] >= 14 / 16 * TEXELS
    case.check(worst(avatar.opacity[beyond].sigmoid(), np.full(beyond.sum(), START_OPACITY)), 1e-6)
    assert re.search(
        r"\d+ of 256 texels are in no picture: they are as at the start, or as their neighbours", done.said
    )


def test_images_without_a_subject(case: HardCase, train: Train) -> None:
    """The mean over a subject without pixels, as one writes it first, is no number."""
    frames = frames_of([[light] for light in LIGHTS])
    empty = [dataclasses.replace(darkened(i), mask=np.zeros_like(i.mask)) for i in images_of(frames)]
    done = train(frames, empty)
    case.check(done.not_finite(), 0)
    mask = torch.zeros(PIXELS, PIXELS)
    case.naive_fails((mask * mask).sum() / mask.sum())
    assert "6 of 6 images are without a subject" in done.said


def edge_on(image: ImageRecord) -> ImageRecord:
    """The image of a camera in the sheet's plane, 1 m beside it: it sees nothing of it."""
    R = np.array([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])
    t = -R @ np.array([-1.0, 0, 0])
    return dataclasses.replace(darkened(image), camera="edge", R=R, t=t, mask=np.zeros_like(image.mask))


@pytest.mark.parametrize("parameters", ["texels", "decoded"])
def test_a_plane_that_one_camera_sees_edge_on(case: HardCase, train: Train, parameters: str) -> None:
    """A subject without volume, with and without networks that know poses by its points."""
    frames = frames_of([[light] for light in LIGHTS])
    images = images_of(frames)
    done = train(frames, [*images, *map(edge_on, images[::2])], parameters=parameters)
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert "3 of 9 images are without a subject: edge/0, edge/1, edge/2" in done.said


def added_at(self: PictureEquations, half: int, matrix, vector, errors: float, which=slice(None)) -> None:
    """As NumPy adds to places by number: of two additions to one place, the second alone counts."""
    at = np.arange(self.vector.shape[1])[which]
    self.matrix[half][np.ix_(at, at)] += matrix
    self.vector[half][at] += vector
    self.errors[half] += errors


@pytest.mark.parametrize("places", ["as calibrated", "refined"])
def test_two_lights_in_one_place(case: HardCase, train: Train, places: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are one light of their sum, and refined as that: 15 % brighter than calibrated beside the others."""
    settings = {"refine_light_places": places == "refined", "normals": "mesh"}
    twice = frames_of([[LIGHTS[0], LIGHTS[0]], LIGHTS[1:2], LIGHTS[2:]])
    once = frames_of([LIGHTS[:1], LIGHTS[1:2], LIGHTS[2:]])
    brighter = [dataclasses.replace(once[0], light_intensities=1.15 * once[0].light_intensities), *once[1:]]
    images = images_of(brighter, (-0.2, 0.0, 0.2))
    one, two = train(once, images, **settings), train(twice, images, **settings)
    case.check(two.not_finite(), 0)
    lights = once[0].light_positions
    gains = one.loaded.light_gains.of(lights)
    assert gains > 1.01
    case.check(worst(two.loaded.light_gains.of(lights), gains), ROUNDED)
    assert "several lights stand in one place in 1 of 3 frames: they count as one" in two.said
    monkeypatch.setattr(PictureEquations, "add", added_at)
    naive = train(twice, images, **settings)
    case.naive_fails(worst(naive.loaded.light_gains.of(lights), gains))


def test_two_lights_that_are_always_on_together(case: HardCase, train: Train) -> None:
    """A micrometre apart: what either sends is not told, and neither leaves its calibration."""
    x, y, z = LIGHTS[0]
    frames = frames_of([[[x, y, z], [x + 1e-6, y, z]], LIGHTS[1:2], LIGHTS[2:]])
    done = train(frames, images := images_of(frames))
    case.check(done.not_finite(), 0)
    case.check(done.error(frames, images), LEARNED)
    assert "images tell only 3 of 4 lights apart: the others' light is like theirs, or not seen" in done.said


def scaled(scale: float) -> tuple[list[FrameRecord], list[ImageRecord], Atlas]:
    """The sheet under its lights, `scale` metres a side, as bright as at any other size."""
    size, sheet = scale / SIDE_M, make_sheet(TEXELS)
    frames = frames_of([[light] for light in LIGHTS])
    images = [dataclasses.replace(image, t=size * image.t) for image in images_of(frames)]
    larger = [
        dataclasses.replace(
            frame, vertices=np.float32(size) * frame.vertices, light_positions=np.float32(size) * frame.light_positions,
            light_intensities=np.float32(size**2) * frame.light_intensities,
        )
        for frame in frames
    ]  # fmt: skip
    return larger, images, dataclasses.replace(sheet, rest_vertices=np.float32(size) * sheet.rest_vertices)


@pytest.mark.parametrize("exponent", [-10, 7])
def test_a_subject_of_another_size(
    case: HardCase, train: Train, exponent: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1 mm and 128 m, powers of two so that scaling itself rounds nothing: the pictures of a subject of 1 m."""
    subject, small = scaled(1.0), scaled(2.0**exponent)
    for steps in (1, STEPS):
        metre = train(*subject, steps=steps)
        wanted = metre.pictures(*subject[:2])
        done = train(*small, steps=steps)
        case.check(done.not_finite(), 0)
        case.check(worst(done.pictures(*small[:2]), wanted), ROUNDED if steps == 1 else SIGNS)
        assert "expected 0.1 to 10" in done.said and not metre.said
    if exponent < 0:  # At 128 m, metres as they are cost 3.5 % of the brightest pixel; at 1 mm, the picture.
        for module in (texel_store, posed_texels):
            monkeypatch.setattr(module, "length_unit_m", lambda atlas: 1.0)
        case.naive_fails(worst(train(*small).pictures(*small[:2]), wanted))
