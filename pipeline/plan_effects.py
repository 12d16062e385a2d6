"""Cheap measurements on this capture -> which effects to simulate, each with the number it was decided on.

Reads the tracked meshes, the booked light patterns and the calibrations; writes effects.json: {effect: {"on", "mode",
"evidence", "threshold", "why"}}. An effect whose mode is `auto` is on if its evidence exceeds its threshold
(`pipeline.config.plan_effects` derives them); what is off costs nothing downstream.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float64

from pipeline.base.command import run_as_command
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.base.seeds import generator_for
from pipeline.config.plan_effects import PlanEffects
from pipeline.geometry.cameras import Camera, read_cameras
from pipeline.geometry.rotations import conjugate_quaternion, multiply_quaternions, rotation_vector_from_quaternion
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.geometry.tracked import TrackedChunk, read_tracked
from pipeline.lighting.evidence import PosedFrame, blocked_from_afar, falloff_spread
from pipeline.lighting.frame_lights import read_frame_lights

log = logging.getLogger("plan_effects")

PERCENTILE = 95.0
"""Evidence is taken at this percentile, not the maximum: one frame tracked badly must not switch an effect on."""

GRID = 33
"""Points per image side at which distortion is evaluated, corners included: it is smooth, and largest at the
corners."""


@dataclass(frozen=True)
class Evidence:
    """One measured number and the sentence that says what it is."""

    value: float
    text: str


def run(
    *, index: Path, atlas: Path, tracking: tuple[Path, ...], patterns: Path, lights: Path, cameras: Path, color: Path,
    out: Path,
    settings: PlanEffects = PlanEffects(),
) -> None:  # fmt: skip
    """Measure which effects this capture calls for.

    Args:
        index: folder written by index_capture.
        atlas: atlas.safetensors of unwrap_atlas.
        tracking: all chunks of track_mesh.
        patterns: patterns.parquet of book_patterns.
        lights: calibration/lights.parquet.
        cameras: calibration/cameras.json, at sensor resolution.
        color: calibration/color.json.
        out: effects.json.
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
    evidence = {
        "shadow": shadow_evidence(texels, sample, settings, random),
        "articulation": articulation_evidence(chunks),
        "near_field": near_field_evidence(texels, sample, settings, random),
        "lens_distortion": distortion_evidence(
            read_cameras(cameras), float(described["images"]["downsample_from_sensor"])
        ),
        "color_correction": color_evidence(color),
    }
    thresholds = {
        "shadow": settings.shadow_percent, "articulation": settings.articulation_degrees,
        "near_field": settings.near_field_percent, "lens_distortion": settings.lens_distortion_px,
        "color_correction": settings.color_correction_percent,
    }  # fmt: skip
    effects = {name: decide(getattr(settings, name), found, thresholds[name]) for name, found in evidence.items()}
    for name, effect in effects.items():
        log.info("%s %s: %s", name, "on" if effect["on"] else "off", effect["why"])
    write_json(out, effects)


def decide(mode: str, evidence: Evidence, threshold: float) -> dict[str, object]:
    """One entry of effects.json."""
    exceeds = evidence.value > threshold
    on = exceeds if mode == "auto" else mode == "on"
    compared = f"{evidence.text}: {'more than' if exceeds else 'within'} the threshold of {threshold:g}"
    why = compared if mode == "auto" else f"forced {mode}; {compared}"
    return {"on": on, "mode": mode, "evidence": evidence.value, "threshold": threshold, "why": why}


def shadow_evidence(
    atlas: Atlas, frames: list[PosedFrame], settings: PlanEffects, random: np.random.Generator
) -> Evidence:
    """Share, in percent, of pairs of a texel and a light facing each other that a distant surface blocks."""
    if not frames:
        return Evidence(0.0, "no tracked frame has a light on")
    extent = float(np.ptp(atlas.rest_vertices, axis=0).max())
    radius = settings.local_radius_percent / 100 * extent
    blocked, facing = blocked_from_afar(atlas, frames, radius, -(-settings.rays // len(frames)), random)
    share = blocked / max(facing, 1)
    error = np.sqrt(share * (1 - share) / max(facing, 1))
    text = (
        f"{100 * share:.2f} % (standard error {100 * error:.2f}) of {facing} facing texel-light pairs in {len(frames)} "
        f"frames are blocked by a surface further than {1e3 * radius:.0f} mm"
    )
    return Evidence(100 * share, text)


def near_field_evidence(
    atlas: Atlas, frames: list[PosedFrame], settings: PlanEffects, random: np.random.Generator
) -> Evidence:
    """Change of I / d^2 over the subject against its centre, in percent."""
    if not frames:
        return Evidence(0.0, "no tracked frame has a light on")
    spread = 100 * falloff_spread(atlas, frames, -(-settings.rays // len(frames)), random, PERCENTILE)
    text = f"{PERCENTILE:g} % of the light arriving at texels is within {spread:.1f} % of that at the subject's centre"
    return Evidence(spread, text)


def articulation_evidence(chunks: list[TrackedChunk]) -> Evidence:
    """Largest spread, over joints, of the local rotation around its mean, in degrees."""
    if any(chunk.joint_rotations is None or not chunk.joint_rotations.shape[1] for chunk in chunks):
        return Evidence(0.0, "the template has no joints")
    spreads = rotation_spread_deg(np.concatenate([chunk.joint_rotations for chunk in chunks]))
    joint = int(spreads.argmax())
    spread = float(spreads[joint])
    text = f"{PERCENTILE:g} % of rotations of joint {joint}, the liveliest, are within {spread:.1f} degrees of its mean"
    return Evidence(spread, text)


def rotation_spread_deg(rotations: Float[np.ndarray, "frames joints 4"]) -> Float64[np.ndarray, " joints"]:
    """Per joint, a percentile of the angle to the mean rotation, degrees. The mean is the eigenvector of the largest
    eigenvalue of sum q q^T (Markley et al. 2007, Averaging Quaternions), blind to the sign of q."""
    q = rotations.astype(np.float64)
    mean = np.linalg.eigh(np.einsum("fji,fjk->jik", q, q))[1][..., -1]
    away = rotation_vector_from_quaternion(multiply_quaternions(conjugate_quaternion(mean), q))
    return np.percentile(np.degrees(np.linalg.norm(away, axis=-1)), PERCENTILE, axis=0)


def distortion_evidence(cameras: dict[str, Camera], downsample: float) -> Evidence:
    """Largest displacement by the calibrated distortion inside any image, in pixels of the images used."""
    sizes = {name: largest_displacement_px(camera) / downsample for name, camera in cameras.items()}
    worst = max(sizes, key=lambda name: sizes[name])
    text = f"the lens of {worst} moves a point of the image by up to {sizes[worst]:.2f} image pixels"
    return Evidence(sizes[worst], text)


def largest_displacement_px(camera: Camera) -> float:
    """Largest distance in the camera's pixels between where a pinhole and where this lens images a point."""
    x, y = np.meshgrid(np.linspace(0, camera.width, GRID), np.linspace(0, camera.height, GRID))
    pinhole = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    in_camera = np.linalg.solve(camera.K, pinhole.T).T
    pixels, _ = camera.project((in_camera - camera.t) @ camera.R)
    return float(np.linalg.norm(pixels - pinhole[:, :2], axis=1).max())


def color_evidence(path: Path) -> Evidence:
    """Largest deviation of a camera's colour matrix from the identity, in percent."""
    matrices = {name: np.array(matrix, np.float64) for name, matrix in read_json(path).get("cameras", {}).items()}
    wrong = sorted(name for name, matrix in matrices.items() if matrix.shape != (3, 3) or not np.isfinite(matrix).all())
    if wrong:
        raise InputError(
            f"{path}: cameras {wrong}: expected 3x3 finite numbers, found others; run calibrate_color again"
        )
    sizes = {name: 100 * float(np.abs(matrix - np.eye(3)).max()) for name, matrix in matrices.items()}
    if not sizes:
        return Evidence(0.0, "no camera has a colour matrix")
    worst = max(sizes, key=lambda name: sizes[name])
    return Evidence(
        sizes[worst], f"the colour matrix of {worst} departs from the identity by up to {sizes[worst]:.2f} %"
    )


def main() -> None:
    """Command line of this stage."""
    run_as_command(run)


if __name__ == "__main__":
    main()
