"""Plan which effects to simulate, by cheap measurements on this capture.

Each stands with the number it was decided on.

Reads the tracked meshes, the booked light patterns, the calibrations and a few training images; writes effects.json:
{effect: {"on", "mode", "evidence", "threshold", "why", "cost"}}. An effect whose mode is `auto` is on if its evidence
exceeds its threshold (`pipeline.config.plan_effects` derives them); what is off costs nothing downstream, and "cost"
says how much that spares: jobs, channels, parameters and estimated seconds of training. Where the template names
regions, shadows, gloss and, for bodies, learned transport are decided for each: "regions" of their entries has {region:
{"on", "evidence"}}. That of gloss has "ggx_width", which training starts from.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.avatar.texels.posed_texels import texel_spacing
from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, read_table, write_json
from pipeline.base.seeds import generator_for
from pipeline.capture.images import ImageSource
from pipeline.config.effects import EFFECTS
from pipeline.config.plan_effects import PlanEffects
from pipeline.effects.appearance_evidence import (
    Evidence,
    choose_images,
    deferred_evidence,
    specular_evidence,
    transport_evidence,
)
from pipeline.effects.appearance_fits import explain_colors
from pipeline.effects.effect_costs import effect_cost
from pipeline.effects.scene_evidence import (
    articulation_evidence,
    color_evidence,
    distortion_evidence,
    near_field_evidence,
    read_colors,
    shadow_evidence,
)
from pipeline.effects.seen_texels import SeenTexels, observe_texels
from pipeline.effects.texel_light import light_texels
from pipeline.geometry.cameras import read_cameras
from pipeline.geometry.texel_regions import texels_by_region
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.geometry.tracked import read_tracked
from pipeline.lighting.frame_lights import FrameLights, read_frame_lights
from pipeline.lighting.subsurface import surface_at_rest

log = logging.getLogger("plan_effects")

THRESHOLDS = {
    "shadow": "shadow_percent", "near_field": "near_field_percent", "articulation": "articulation_degrees",
    "specular": "specular_db", "deferred": "deferred_db", "learned_transport": "learned_transport_db",
    "lens_distortion": "lens_distortion_px", "color_correction": "color_correction_percent",
}  # fmt: skip
"""The setting that each effect's evidence is compared with; eyes whose gaze is known need none."""


def run(
    *, capture: Path, index: Path, atlas: Path, tracking: tuple[Path, ...], patterns: Path, booked: Path, lights: Path,
    cameras: Path, color: Path, out: Path, estimated_gaze: Path | None = None,
    settings: PlanEffects = PlanEffects(),
) -> None:  # fmt: skip
    """Measure which effects this capture calls for.

    So many arguments because a command line names each file that it reads.

    Args:
        capture: folder of the capture, for some of its training images.
        index: folder written by index_capture.
        atlas: atlas.safetensors of unwrap_atlas.
        tracking: all chunks of track_mesh.
        patterns: patterns.parquet of book_patterns.
        booked: frames.parquet of book_patterns.
        lights: calibration/lights.parquet.
        cameras: calibration/cameras.json, at sensor resolution.
        color: calibration/color.json.
        out: effects.json.
        estimated_gaze: gaze.parquet of estimate_gaze, where the capture declares none.
        settings: numbers and modes.
    """
    described, texels = read_json(index / "capture.json"), read_atlas(atlas)
    if not tracking:
        raise InputError("--tracking: expected at least one chunk, found none; run track_mesh first")
    chunks = [read_tracked(path, len(texels.rest_vertices)) for path in tracking]
    lit = read_frame_lights(lights, patterns)
    posed = {int(f): v for chunk in chunks for f, v in zip(chunk.frames, chunk.vertices, strict=True) if int(f) in lit}
    random = generator_for(described["subject"], "plan_effects")
    chosen = np.sort(random.permutation(sorted(posed))[: settings.frames])
    sample = [(posed[f], lit[f].positions) for f in chosen.tolist()]
    found = read_cameras(cameras)
    downsample = float(described["images"]["downsample_from_sensor"])
    # Eyes turn with the gaze: without one they are part of the mesh like everything else.
    eyes = read_table(estimated_gaze or index / "gaze.parquet").eye.nunique()
    found_eyes = f"the images show where {eyes or 'no'} eyes look" if estimated_gaze else (
        f"the capture declares {eyes or 'no'} eyes and their gaze"
    )  # fmt: skip
    regions = texels_by_region(texels)
    evidence = {
        "shadow": shadow_evidence(texels, sample, settings.local_radius_percent, settings.rays, random, regions),
        "near_field": near_field_evidence(texels, sample, settings.rays, random),
        "articulation": articulation_evidence(chunks, texels),
        "eyes": Evidence(float(eyes), found_eyes),
        "lens_distortion": distortion_evidence(found, downsample),
        "color_correction": color_evidence(color),
    }
    images = choose_images(
        read_table(index / "images.parquet"), read_table(booked), set(posed), settings.fully_lit_frames,
        settings.partially_lit_frames, settings.views,
    )  # fmt: skip
    small = {name: camera.downsampled(downsample) for name, camera in found.items()}
    some = np.sort(random.permutation(texels.texel_count)[: settings.texels])
    source = ImageSource.from_index(capture, described["images"])
    seen = observe_texels(source, images, small, read_colors(color), texels, some, posed)
    evidence |= appearance_evidence(seen, some, texels, posed, lit, settings, regions)
    effects = {}
    for name in EFFECTS:
        threshold = getattr(settings, THRESHOLDS.get(name, ""), 0.0)
        decided = decide(getattr(settings, name), evidence[name], threshold)
        built = [len(regions[region]) for region, part in decided.get("regions", {}).items() if part["on"]]
        effects[name] = {**decided, "cost": effect_cost(name, texels.texel_count, sum(built) or texels.texel_count)}
    for name, effect in effects.items():
        log.info("%s %s: %s", name, "on" if effect["on"] else "off", effect["why"])
    write_json(out, effects)


def decide(mode: str, evidence: Evidence, threshold: float) -> dict[str, Any]:
    """One entry of effects.json: on where anything that was judged calls for it."""
    exceeds = evidence.value > threshold
    compared = f"{evidence.text}: {'more than' if exceeds else 'within'} the threshold of {threshold:g}"
    entry = {"mode": mode, "evidence": evidence.value, "threshold": threshold}
    if exceeds and evidence.ggx_width is not None:  # else it was fitted to noise
        entry["ggx_width"] = evidence.ggx_width
    if mode != "auto":
        return {"on": mode == "on", **entry, "why": f"forced {mode}; {compared}"}
    if not evidence.regions:
        return {"on": exceeds, **entry, "why": compared}
    regions = {name: {"on": value > threshold, "evidence": value} for name, value in evidence.regions.items()}
    each = ", ".join(f"{name} {value:.2f} {evidence.unit}" for name, value in evidence.regions.items())
    on = any(part["on"] for part in regions.values())
    return {"on": on, **entry, "why": f"{compared}; by region: {each}", "regions": regions}


def appearance_evidence(
    seen: SeenTexels, some: np.ndarray, atlas: Atlas, posed: dict[int, np.ndarray], lit: dict[int, FrameLights],
    settings: PlanEffects, regions: Mapping[str, np.ndarray],
) -> dict[str, Evidence]:  # fmt: skip
    """Evidence of gloss and transport in the training images.

    It is none if no texel is seen well in any.

    Args:
        seen: what these images show of `some` texels.
        some: numbers of the texels.
        atlas: all texels.
        posed: frame -> vertices.
        lit: frame -> lights that are on.
        settings: how many rays bounce.
        regions: texels of each part of the surface that is judged by itself.
    """
    if not len(seen.point):
        nothing = Evidence(0.0, "no training image shows a texel well")
        return dict.fromkeys(("specular", "deferred", "learned_transport"), nothing)
    lights = [lit[int(frame)] for frame in seen.frames]
    light = [
        light_texels(atlas, posed[int(frame)], some, normals, lamps, settings.bounce_rays)
        for frame, normals, lamps in zip(seen.frames, seen.normals, lights, strict=True)
    ]
    spacing = texel_spacing(atlas).numpy().astype(np.float64)
    found = explain_colors(seen, lights, light, surface_at_rest(atlas, spacing), regions)
    return {
        "specular": specular_evidence(found),
        "deferred": deferred_evidence(found, seen, atlas, spacing.mean(1)),
        "learned_transport": transport_evidence(found),
    }


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
