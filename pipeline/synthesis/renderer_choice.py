"""Choice between the scalar renderer and the vectorized one, which needs an LLVM library.

Dr.Jit, under Mitsuba, looks for the library itself: the one that the variable DRJIT_LIBLLVM_PATH names, else the newest
that the system has; here, those of a conda environment are tried, too. It refuses versions before 15, and not every
later one compiles every kernel: LLVM 15 ends the process where it meets AVX-512. So a child process tries, on a picture
that the scalar renderer also makes.
"""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.base.errors import Complaints
from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.geometry.cameras import Camera
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.lens import view_points

log = logging.getLogger(__name__)

Renderer = Literal["scalar", "llvm"]

LIBRARY = "DRJIT_LIBLLVM_PATH"
"""Environment variable that names the library for Dr.Jit."""

WORTH_PATHS = 5e7
"""Light paths of a capture from which on the vectorized renderer is worth its start.

The trial and what is compiled in two workers take about 5 s of CPU time; the scalar renderer takes 0.26 us per path,
13 s for so many.
"""

TRIAL_S = 120.0
"""Longest time that a trial may take. It takes about 2 s."""

AGREEMENT = 0.02
"""Relative difference of mean radiance allowed between the renderers on trial.

They differ by 0.3 %: Mitsuba's low-discrepancy sampler, which the scalar one takes, makes light of later vertices 2 %
brighter than its independent sampler does; the vectorized one agrees with the latter.
"""


def choose_renderer(settings: SynthesizeCapture) -> tuple[Renderer, str]:
    """Choose the renderer of a capture's frames; also the version of LLVM that it uses, if any.

    Sets `LIBRARY` for this process and its children where another library than Dr.Jit's choice is needed.

    Raises:
        InputError: if LLVM is asked for and no library is fit.
    """
    if settings.renderer == "scalar" or settings.material == "translucent" or settings.hair_strands:
        return "scalar", ""
    if settings.renderer == "auto" and light_paths(settings) < WORTH_PATHS:
        return "scalar", ""
    for library in (None, *_conda_libraries()):
        environment = dict(os.environ) if library is None else {**os.environ, LIBRARY: str(library)}
        version = tried_version(environment)
        if version:
            os.environ.update(environment)
            return "llvm", version
    if settings.renderer == "llvm":
        complaints = Complaints("synthesize_capture: renderer")
        complaints.add(
            "settings", "renderer", expected=f"an LLVM library, 16 or newer, that Dr.Jit finds or {LIBRARY} names",
            found="none that renders rightly",
        )  # fmt: skip
        complaints.raise_if_any()
    log.info("no fit LLVM library: the scalar renderer takes several times as long")
    return "scalar", ""


def light_paths(settings: SynthesizeCapture) -> float:
    """Light paths of all frames, about: those of every image pixel."""
    fully = -(-settings.frames // settings.fully_lit_every)
    per_pixel = fully * settings.spp_fully_lit + (settings.frames - fully) * settings.spp
    return float(settings.cameras * settings.width * settings.height * per_pixel)


def _conda_libraries() -> list[Path]:
    """LLVM libraries in this environment, newest names first; none if the user names one."""
    if LIBRARY in os.environ:
        return []
    return sorted((Path(sys.prefix) / "lib").glob("libLLVM*.so*"), reverse=True)[:3]


def tried_version(environment: dict[str, str]) -> str:
    """Version of the LLVM that Dr.Jit finds in an environment; nothing if it is not fit."""
    command = [sys.executable, "-c", "from pipeline.synthesis.renderer_choice import print_trial; print_trial()"]
    try:
        tried = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TRIAL_S, check=False)
        found = json.loads(tried.stdout.splitlines()[-1]) if tried.returncode == 0 else {"ratio": 0.0}
    except (OSError, subprocess.TimeoutExpired, ValueError, IndexError):
        return ""
    return found["version"] if abs(found["ratio"] - 1) < AGREEMENT else ""


def print_trial() -> None:
    """Print, as JSON, the version of LLVM and how bright its picture is.

    That is the ratio of mean radiance to the scalar renderer's.
    """
    scalar = _trial_picture()
    with scenes.llvm_variant():
        import drjit

        vectorized = _trial_picture()
        version = ".".join(map(str, drjit.detail.llvm_version()))
    print(json.dumps({"version": version, "ratio": float(vectorized[..., :3].mean() / scalar[..., :3].mean())}))


def _trial_picture() -> np.ndarray:
    """Two coated squares, a floor and a wall, under two lights."""
    floor = np.array([[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.5, 0.0, 0.5], [-0.5, 0.0, 0.5]])
    wall = np.array([[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.5, 1.0, -0.5], [-0.5, 1.0, -0.5]])
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    texture = np.random.default_rng(0).uniform(0.2, 0.8, (8, 8, 3)).astype(np.float32)
    sides = ((floor, [0.0, 1.0, 0.0], [[0, 2, 1], [0, 3, 2]]), (wall, [0.0, 0.0, 1.0], [[0, 1, 2], [0, 2, 3]]))
    meshes = [
        scenes.coated_mesh(texture, 0.3, square, np.tile(normal, (4, 1)), np.array(faces), uv)
        for square, normal, faces in sides
    ]
    lights, intensities = np.array([[0.3, 1.2, 0.8], [-0.4, 0.8, 1.0]]), np.array([2.0, 1.0])
    R, center = np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.4, 3.0])
    camera = Camera(R, -R @ center, np.array([[60.0, 0, 16], [0, 60.0, 16], [0, 0, 1]]), np.zeros(5), 32, 32)
    view = view_points(camera, np.concatenate([floor, wall]), 1)
    if scenes.mitsuba().variant() == scenes.SCALAR:
        return scenes.render(scenes.lit_scene(meshes, lights, intensities, 4), view, 256, seed=1)
    from pipeline.synthesis import camera_rays, wavefront

    whole = camera_rays.WavefrontView(view, np.ones(view.crop[:1:-1], bool), seed=1)
    return wavefront.render_views(scenes.mesh_scene(meshes), [whole], lights, intensities, 64, 4)[0]
