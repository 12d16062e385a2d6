"""Write an avatar as a page that relights it in a browser.

In: an avatar of Lambert and GGX, the shards it was trained and scored on, and the lights of the stage. Out: index.html,
one file that asks for no other: it opens from a disk, and computes the light itself. `docs/viewer.md` says what it
shows, and how near it comes to the pipeline's own pictures.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np

from pipeline.avatar.spec.spec_words import describe
from pipeline.avatar.training.checkpoint import load_avatar
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, written_whole
from pipeline.base.progress import progress
from pipeline.base.splits import VALIDATION
from pipeline.base.spread import spread
from pipeline.capture.shards import read_frame_shards, read_image_shards
from pipeline.config.export_viewer import ExportViewer
from pipeline.lighting.changing_light import require_changing_light
from pipeline.lighting.named_lights import read_named_lights
from pipeline.viewer.captured import captured_pictures, choose_cameras
from pipeline.viewer.head_poses import head_sliders
from pipeline.viewer.page import (
    MEGA,
    common_texts,
    facts_of,
    frame_blocks,
    frames_that_fit,
    page_html,
    slider_places,
)
from pipeline.viewer.shown_frame import require_analytic, shown_frame

log = logging.getLogger("export_viewer")


def run(
    *,
    atlas: Path,
    avatar: Path,
    shards: Path,
    lights: Path,
    patterns: Path,
    out: Path,
    subject: str,
    frames: Path | None = None,
    index: Path | None = None,
    settings: ExportViewer = ExportViewer(),
) -> None:
    """Write the page.

    Args:
        atlas: atlas.safetensors of unwrap_atlas.
        avatar: folder of train_avatar.
        shards: folder with train/, test/, validation/ and frames/ of pack_shards.
        lights: calibration/lights.parquet.
        patterns: patterns.parquet of book_patterns.
        out: HTML file to write.
        subject: name of the subject, for the title.
        frames: folder of frame shards, if they are not those in SHARDS/frames.
        index: folder of index_capture; a capture under constant light is refused.
        settings: see the flags below.
    """
    require_changing_light(index)
    loaded = load_avatar(avatar, atlas)
    spec = loaded.avatar.spec
    require_analytic(spec, f"{avatar}/config.json")
    stage, records = read_named_lights(lights, patterns), read_frame_shards([frames or shards / "frames"])
    places = stage.positions.astype(np.float32)
    stage = stage.brightened(loaded.light_gains.of(places)).moved(loaded.light_gains.moved(places) - places)
    if not len(records):
        raise InputError(f"{shards}/frames: expected at least one frame, found none; run pack_shards again")
    images = read_image_shards([shards / folder for folder in ("train", VALIDATION, "test")])

    chosen, common, blocks = spread(sorted(records), settings.timeline_frames), None, []
    for number in progress(chosen, "frames"):
        shown = shown_frame(loaded, records[number], stage.positions)
        common = shown if common is None else common
        blocks.append(frame_blocks(shown, common, stage))
    captured = captured_pictures(images, chosen, choose_cameras(images, chosen, settings.captured_cameras))
    built = read_json(avatar / "config.json").get("built", describe(spec))
    facts, texts = facts_of(subject, built, loaded, stage, captured), common_texts(loaded)
    sliders = head_sliders(loaded, [records[number] for number in chosen], settings.code_axes, settings.slider_steps)
    posed = [
        frame_blocks(shown_frame(loaded, pose.record, stage.positions, pose.code), common, stage, pose.label)
        for pose in progress(slider_places(sliders, 0)[0], "poses")
    ]
    others_mb, posed_mb = len(page_html(facts, texts, [])) / MEGA, sum(one.megabytes for one in posed)
    if posed and others_mb + posed_mb + blocks[0].megabytes > settings.page_mb:
        log.warning("no sliders: their %.0f MB leave no room for a frame; lower slider_steps or code_axes", posed_mb)
        posed, sliders, posed_mb = [], [], 0.0
    room = frames_that_fit(blocks, others_mb + posed_mb, settings.page_mb)
    if room < len(blocks):
        log.info("%d of %d frames fit into %g MB", room, len(blocks), settings.page_mb)
    facts |= {"timeline": room, "sliders": slider_places(sliders, room)[1]}
    page = page_html(facts, texts, [*spread(blocks, room), *posed])
    with written_whole(out) as temporary:
        temporary.write_text(page, "utf-8")
    log.info("%s: %d Gaussians, %d frames, %.1f MB", out.name, loaded.atlas.texel_count, room, len(page) / MEGA)


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
