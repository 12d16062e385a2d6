"""PSNR of the viewer's pictures against the pipeline's own, by kind of light.

    python -m benchmarks.bench_viewer_parity --results results/subjectA results/walker

opens each subject's page in Chromium with software GL, and draws three of its frames as a captured camera sees them:
under the frame's own lights, under a panorama and under two lamps that are placed in the page. `Relighter` draws the
same for the same exposure. Scored are the pixels of the subject, of 8 bits; one row a subject and kind of light. Of a
head also poses of its sliders, in the light of the first frame: at a stop, and half way to one, where the page adds up
what the pipeline decodes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from playwright import sync_api

from pipeline.avatar.relighting.driving_signal import from_record
from pipeline.avatar.relighting.film import Relighter
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.splits import VALIDATION
from pipeline.base.spread import spread
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.export_viewer import ExportViewer
from pipeline.config.trace_irradiance import TraceIrradiance
from pipeline.geometry.camera_paths import orbit
from pipeline.geometry.cameras import Camera
from pipeline.geometry.lenses import BROWN_CONRADY
from pipeline.lighting.environment import Environment
from pipeline.lighting.frame_lights import FrameLights
from pipeline.viewer.head_poses import head_sliders
from pipeline.viewer.shown_frame import SKY_HEIGHT
from tests.support.viewer.relit_page import SETTLED, lamp, launch, open_page, page_picture, pipeline_picture, psnr_db

FRAMES = 3
KINDS = ("the frame's lights", "panorama", "two placed lamps")


def lights_of(kind: str, facts: dict, place: int, page, relighter: Relighter, signal) -> tuple:
    """A frame under one kind of light, and the same lights for the page."""
    stage = facts["lights"]
    if kind == "panorama":
        sky = Environment(np.random.default_rng(place).random((SKY_HEIGHT, 2 * SKY_HEIGHT, 3)).astype(np.float32) ** 4)
        asked = [sky.radiance.ravel().tolist(), SKY_HEIGHT, len(stage)]
        lights = page.evaluate("([radiance, rows, bit]) => skyLamps(radiance, rows, bit)", asked)
        return relighter.under_pixels(signal, sky, np.eye(3)), lights
    if kind == "two placed lamps":
        low, high = (np.array(facts["frames"][0][name]) for name in ("low", "high"))
        middle, reach = (low + high) / 2, np.linalg.norm(high - low)
        lights = [
            lamp(middle + reach * np.array([0.6, 0.3, 0.8]), (4.0, 3.5, 3.0)),
            lamp(middle + reach * np.array([-0.7, 0.1, 0.4]), (1.0, 2.0, 3.0)),
        ]
    else:
        pattern = facts["frames"][place]["pattern"]
        lights = [lamp(stage[light]["position"], rgb, light) for light, *rgb in pattern]
    arrays = (np.array([light[name] for light in lights]) for name in ("position", "intensity"))
    return relighter.under_lights(signal, FrameLights(*arrays)), lights


def scores(results: Path, variant: str, browser) -> pd.DataFrame:
    """PSNR of each kind and frame of a subject."""
    relighter = Relighter(load_avatar(results / "avatars" / variant, results / "atlas.safetensors"), TraceIrradiance())
    frames = read_frame_shards([results / "shards/frames"])
    images = read_image_shards([results / "shards" / folder for folder in ("train", VALIDATION, "test")])
    page = browser.new_page()
    open_page(page, (results / "viewer/index.html").resolve())
    facts = page.evaluate("scene.facts")
    rows = []
    for place in spread(range(facts["timeline"]), FRAMES):
        number = facts["frames"][place]["frame"]
        image = images[int(np.flatnonzero(images.table.frame == number)[0])]
        camera = Camera(
            image.R, image.t, image.K, BROWN_CONRADY.no_distortion(), image.width, image.height
        )  # of a crop, undistorted
        for kind in KINDS:
            frame, lights = lights_of(kind, facts, place, page, relighter, from_record(frames[number]))
            expected, exposure, subject = pipeline_picture(relighter, frame, camera)
            shown = page_picture(page, place, camera, lights, exposure)
            rows.append((results.name, facts["gaussians"], number, kind, psnr_db(shown, expected, subject)))
    page.close()
    return pd.DataFrame(rows, columns=["subject", "gaussians", "frame", "light", "psnr_db"])


def pose_scores(results: Path, variant: str, browser) -> pd.DataFrame:
    """PSNR of a head's poses at a stop and between; none of a body."""
    page = browser.new_page()
    open_page(page, (results / "viewer/index.html").resolve())
    facts = page.evaluate("scene.facts")
    rows, axes = [], sum(slider["unit"] != "degrees" for slider in facts["sliders"])
    loaded = load_avatar(results / "avatars" / variant, results / "atlas.safetensors")
    relighter, frames = Relighter(loaded, TraceIrradiance()), read_frame_shards([results / "shards/frames"])
    chosen = [frames[number] for number in spread(sorted(frames), ExportViewer().timeline_frames)]
    sliders = head_sliders(loaded, chosen, axes, 5) if axes else []
    pattern = facts["frames"][0]["pattern"]
    lights = [lamp(facts["lights"][light]["position"], rgb, light) for light, *rgb in pattern]
    arrays = (np.array([light[name] for light in lights]) for name in ("position", "intensity"))
    shine, low, high = FrameLights(*arrays), *(np.array(facts["frames"][0][name]) for name in ("low", "high"))
    (camera,) = orbit((low + high) / 2, 2 * float(np.linalg.norm(high - low)), 0.0, 0.0, 36.0, 240, 320, 1)
    for k, slider in enumerate(sliders):
        for name, pose, share in (("at a stop", slider.poses[-1], 1.0), ("half way", slider.poses[-2], 0.5)):
            page.locator("#head-sliders input").nth(k).fill(f"{share * slider.farthest:g}")
            page.evaluate(SETTLED)
            frame = relighter.under_lights(replace(from_record(pose.record), code=pose.code), shine)
            expected, exposure, subject = pipeline_picture(relighter, frame, camera)
            shown = page_picture(page, None, camera, lights, exposure)
            rows.append((results.name, slider.name, name, psnr_db(shown, expected, subject)))
        page.locator("#head-sliders input").nth(k).fill("0")
    page.close()
    return pd.DataFrame(rows, columns=["subject", "slider", "pose", "psnr_db"]).astype({"psnr_db": float})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, nargs="+", required=True, help="folders of finished subjects")
    parser.add_argument("--variant", default="full", help="the avatar of the pages")
    arguments = parser.parse_args()
    with sync_api.sync_playwright() as playwright:
        browser = launch(playwright)
        found = pd.concat([scores(results, arguments.variant, browser) for results in arguments.results])
        posed = pd.concat([pose_scores(results, arguments.variant, browser) for results in arguments.results])
        browser.close()
    kept = found.groupby(["subject", "gaussians", "light"], sort=False).psnr_db.agg(["min", "max"])
    print(kept.round(1).reset_index().to_string(index=False))
    if len(posed):
        print(posed.round(1).to_string(index=False))


if __name__ == "__main__":
    main()
