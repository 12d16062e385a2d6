"""Time and noise of synthetic pictures: one JSON line per picture and renderer.

    python -m benchmarks.bench_synthesis --subjects subjectA subjectB --renderers scalar llvm

Photographs a fully lit and a partly lit frame, an eye of a head, a view of the board, and the mirror ball. `cpu_s` is
for one frame of all cameras (an eye: within it), `start_s` what the first frame took beyond that. `rmse` is the root of
the mean squared difference from a reference of many times the paths, image values, over the pixels of the first camera
that the subject covers: all, those wholly inside, those at its edge. `coverage_rmse` is the same of the coverage that
masks are made of. Print and ball have one renderer each; a print's row `traced` is how it was taken before.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml

from pipeline.base.seeds import seed_for
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.stages.synthesize_capture import build_subject
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis import photography
from pipeline.synthesis.frame_rendering import FrameRenderer, LitSubject, LlvmRenderer, ScalarRenderer, Shot
from pipeline.synthesis.lens import LensView, view_points
from pipeline.synthesis.prints import render_print
from pipeline.synthesis.stage_rig import build_stage_rig, light_patterns, segment_for
from pipeline.synthesis.studio import Studio
from pipeline.synthesis.target_photography import SILHOUETTE_SAMPLES, BallJob, photograph_ball
from pipeline.synthesis.targets import board_poses, board_texture, sees_board

MORE_PATHS, MORE_PATHS_CLOSE = 16, 256
"""Times the paths of a picture that its reference has, by the scalar renderer; of a close-up, whose noise has peaks."""

RENDERERS = {"scalar": ScalarRenderer, "llvm": LlvmRenderer}
FRAMES = {"fully lit": 0, "partly lit": 1}


def studio_of(subject: str, root: Path) -> Studio:
    """The studio of a subject of config/subjects."""
    settings = yaml.safe_load(Path(f"config/subjects/{subject}.yaml").read_text())["synthesize_capture"]
    settings = SynthesizeCapture(**settings)
    return Studio(root, subject, settings, build_stage_rig(subject, settings))


def lit_subject(studio: Studio, shown: Any, frame: int) -> LitSubject:
    """The subject as a frame of the capture shows it."""
    settings = studio.settings
    segment, time_s = segment_for(frame, settings)
    patterns = light_patterns(studio.subject, studio.rig, settings)
    on = patterns[patterns.frame == frame].set_index("light").intensity
    positions = np.stack([studio.rig.light_positions[name] for name in on.index])
    paths = settings.spp_fully_lit if len(on) == settings.lights else settings.spp
    return LitSubject(shown, shown.at(time_s, segment), settings, positions, on.to_numpy(), paths)


def errors(found: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """The fields of a row that say how far an image is from its reference."""
    off, coverage = (found - reference)[..., :3], reference[..., 3]
    parts = {"rmse": coverage > 0, "rmse_inside": coverage > 0.9999}
    parts["rmse_edge"] = parts["rmse"] & ~parts["rmse_inside"]
    row = {name: float(np.sqrt((off[part] ** 2).mean())) for name, part in parts.items()}
    row["bias"] = float(off[parts["rmse"]].mean())
    row["coverage_rmse"] = float(np.sqrt(((found - reference)[parts["rmse"]][:, 3] ** 2).mean()))
    return row


def frame_shots(studio: Studio, lit: LitSubject, frame: int, scene: Any) -> dict[str, list[Shot]]:
    """Camera -> the shots that its image of a frame consists of."""
    settings = studio.settings
    shots = {}
    for name, sensor_camera in studio.rig.cameras.items():
        camera = sensor_camera.downsampled(settings.downsample_from_sensor)
        seed = seed_for(studio.subject, "paths", name, frame) % 2**31
        shots[name] = photography.shots_of(camera, lit.moment, scene, settings, seed)
    return shots


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """A result and the CPU seconds it took."""
    start = time.process_time()
    return call(), time.process_time() - start


def frame_rows(studio: Studio, shown: Any, light: str, renderers: list[str]) -> Iterator[dict[str, object]]:
    """A row per renderer and kind of picture of one frame."""
    frame = FRAMES[light]
    lit = lit_subject(studio, shown, frame)
    scalar = ScalarRenderer(lit)
    shots = frame_shots(studio, lit, frame, scalar.scene)
    # The first camera's whole view, and the first eye that any camera sees.
    looked_at = {light: shots[next(iter(shots))][0]}
    looked_at |= {f"{light}, eye": eye for of_camera in shots.values() for eye in of_camera[1:2]}
    references = {}
    for name, shot in looked_at.items():
        more = MORE_PATHS_CLOSE if shot.share > 1 else MORE_PATHS
        references[name] = shot.view.develop(scalar.render([replace(shot, share=more * shot.share, seed=1)])[0])
    every = [shot for of_camera in shots.values() for shot in of_camera]
    for kind in renderers:
        with scenes.llvm_variant() if kind == "llvm" else nullcontext():

            def photograph(kind: str = kind) -> dict[int, np.ndarray]:
                renderer: FrameRenderer = RENDERERS[kind](lit)
                return dict(zip(map(id, every), renderer.render(every), strict=True))

            _, first_s = timed(photograph)
            pictures, cpu_s = timed(photograph)
        for name, shot in looked_at.items():
            found = errors(shot.view.develop(pictures[id(shot)]), references[name])
            yield {"picture": name, "renderer": kind, "cpu_s": cpu_s, "start_s": first_s - cpu_s, **found}


def traced_print(texture: np.ndarray, corners: np.ndarray, view: LensView, samples: int) -> np.ndarray:
    """A print as path tracing sees a rectangle that emits its texture."""
    mi = scenes.mitsuba()
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    light = {"type": "area", "radiance": scenes.bitmap_texture(texture, "nearest")}
    mesh = scenes.triangle_mesh({"type": "diffuse"}, corners, np.array([[0, 2, 1], [0, 3, 2]]), uv, emitter=light)
    scene = mi.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 1}, "print": mesh})
    return scenes.render(scene, view, samples, seed=samples)


def board_rows(studio: Studio) -> Iterator[dict[str, object]]:
    """A view of the board by homography, and path-traced."""
    camera, texture = next(iter(studio.rig.cameras.values())), board_texture(studio.settings)
    corners = next(c for c in board_poses(studio.subject, studio.settings) if sees_board(camera, c))
    view = view_points(camera, corners, studio.settings.supersampling)
    reference = view.develop(traced_print(texture, corners, view, MORE_PATHS**2))
    ways = {
        "homography": lambda: render_print(texture, corners, view),
        "traced": lambda: traced_print(texture, corners, view, SILHOUETTE_SAMPLES),
    }
    for name, way in ways.items():
        rendered, cpu_s = timed(way)
        off = view.develop(rendered)[..., 1] - reference[..., 1]
        rmse = float(np.sqrt((off[reference[..., 3] > 0] ** 2).mean()))
        yield {"picture": "board", "renderer": name, "cpu_s": cpu_s, "rmse": rmse}


def ball_rows(studio: Studio) -> Iterator[dict[str, object]]:
    """The pictures of one position of the mirror ball by one camera."""
    _, cpu_s = timed(lambda: photograph_ball(BallJob(studio, 0, next(iter(studio.rig.cameras)))))
    yield {"picture": "ball", "renderer": "scalar", "cpu_s": cpu_s}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--subjects", nargs="+", default=["subjectA", "subjectB"])
    parser.add_argument("--renderers", nargs="+", default=list(RENDERERS), choices=list(RENDERERS))
    options = parser.parse_args()
    scenes.mitsuba()
    with TemporaryDirectory() as folder:
        for subject in options.subjects:
            studio = studio_of(subject, Path(folder))
            shown = build_subject(subject, studio.settings)
            rows = [board_rows(studio), ball_rows(studio)]
            rows += [frame_rows(studio, shown, light, options.renderers) for light in FRAMES]
            for row in (row for some in rows for row in some):
                rounded = {key: round(value, 5) if isinstance(value, float) else value for key, value in row.items()}
                print(json.dumps({"subject": subject, **rounded}), flush=True)


if __name__ == "__main__":
    main()
