"""Renderers of a frame: one ray at a time, or all rays of all cameras in compiled kernels.

Both are Mitsuba's and agree within noise. The second needs an LLVM library, and surfaces that light does not enter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float32

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.synthesis import mitsuba_scenes as scenes
from pipeline.synthesis.hair import hair_mesh
from pipeline.synthesis.lens import LensView
from pipeline.synthesis.subject import Moment, Subject, vertex_normals
from pipeline.synthesis.target_photography import SILHOUETTE_SAMPLES
from pipeline.synthesis.translucency import Medium, translucent_mesh

LEAST_POSITIONS, CLOSE_POSITIONS = 4, 32
"""Places in a fine pixel at which the vectorized renderer looks at all lights; for close-ups, of glints, more.

With so many it leaves less noise than the scalar one, inside and at edges (benchmarks/bench_synthesis.py).
"""


@dataclass(frozen=True)
class LitSubject:
    """A subject at one moment, and the lights that are on.

    Attributes:
        positions: metres.
        intensities: radiant, all positive.
        paths: light paths to spend on each image pixel, about.
    """

    shown: Subject
    moment: Moment
    settings: SynthesizeCapture
    positions: np.ndarray
    intensities: np.ndarray
    paths: int


@dataclass(frozen=True)
class Shot:
    """A view to render.

    Attributes:
        share: paths per image pixel, times the subject's usual number: more than 1 for a close-up.
    """

    view: LensView
    seed: int
    share: float = 1.0


@runtime_checkable
class FrameRenderer(Protocol):
    """A renderer of one lit subject.

    Attributes:
        scene: the subject, to be asked what rays hit.
    """

    scene: Any

    def render(self, shots: Sequence[Shot]) -> list[Float32[np.ndarray, "crop_height crop_width 4"]]:
        """Render the windows of views: radiance and coverage."""
        ...


class ScalarRenderer:
    """Mitsuba's variant `scalar_rgb`; for translucent subjects, too."""

    def __init__(self, subject: LitSubject) -> None:
        self._subject = subject
        self._translucent = subject.settings.material == "translucent"
        self.scene = self._lit_scene(self._translucent)
        # Light may cross a translucent body as if it were not there, so its coverage comes from the opaque one.
        self._opaque = self._lit_scene(False) if self._translucent else None

    def render(self, shots: Sequence[Shot]) -> list[np.ndarray]:
        """Render one view after the other."""
        return [self._picture(shot) for shot in shots]

    def _picture(self, shot: Shot) -> np.ndarray:
        """Render a shot under all lights that are on."""
        settings, intensities = self._subject.settings, self._subject.intensities
        samples = max(1, round(shot.share * self._subject.paths)) / settings.supersampling**2
        if settings.light_choice == "drawn":
            image = scenes.render(self.scene, shot.view, max(1, round(samples)), shot.seed)
        else:
            each = max(1, round(samples / len(intensities)))
            image = scenes.render_each_light(
                self.scene, shot.view, self._subject.positions, intensities, each, shot.seed
            )
        if self._opaque is not None:
            image[..., 3] = scenes.render(self._opaque, shot.view, SILHOUETTE_SAMPLES, shot.seed)[..., 3]
        return image

    def _lit_scene(self, translucent: bool) -> Any:
        settings = self._subject.settings
        # Lights that are looked at one by one are one that is moved.
        few = slice(1 if settings.light_choice == "all" else None)
        return scenes.lit_scene(
            subject_meshes(self._subject, translucent), self._subject.positions[few], self._subject.intensities[few],
            settings.max_depth, "volpath" if translucent else "path",
        )  # fmt: skip


class LlvmRenderer:
    """Mitsuba's variant `llvm_ad_rgb` (`wavefront`); make and use it within `llvm_variant`."""

    def __init__(self, subject: LitSubject) -> None:
        self._subject = subject
        self.scene = scenes.mesh_scene(subject_meshes(subject, False))

    def render(self, shots: Sequence[Shot]) -> list[np.ndarray]:
        """Render all whole views at once, and all close-ups."""
        images: dict[int, np.ndarray] = {}
        for share in dict.fromkeys(shot.share for shot in shots):
            alike = [index for index, shot in enumerate(shots) if shot.share == share]
            images |= zip(alike, self._pictures([shots[index] for index in alike], share), strict=True)
        return [images[index] for index in range(len(shots))]

    def _pictures(self, shots: Sequence[Shot], share: float) -> list[np.ndarray]:
        from pipeline.synthesis import camera_rays, wavefront

        subject, settings = self._subject, self._subject.settings
        vertices, faces = subject.moment.vertices, subject.shown.faces
        # A position and a light make a path.
        lights = settings.supersampling**2 * len(subject.intensities)
        positions = max(CLOSE_POSITIONS if share > 1 else LEAST_POSITIONS, round(share * subject.paths / lights))
        views = [
            camera_rays.WavefrontView(shot.view, camera_rays.traced_pixels(shot.view, vertices, faces), shot.seed)
            for shot in shots
        ]
        return wavefront.render_views(
            self.scene, views, subject.positions, subject.intensities, positions, settings.max_depth
        )


def subject_meshes(subject: LitSubject, translucent: bool) -> list[Any]:
    """Mitsuba meshes of a subject, of the variant that `mitsuba` is."""
    shown, settings, moment = subject.shown, subject.settings, subject.moment
    vertices = moment.vertices if moment.photographed is None else moment.photographed
    cut, normals = shown.unwrapped, vertex_normals(vertices, shown.faces)
    medium = Medium(settings.mean_free_path_m, settings.scattering_albedo)
    meshes = []
    for material in shown.materials:
        geometry = (vertices[cut.source], normals[cut.source], cut.faces[material.faces], cut.uv)
        if translucent and material.solid:
            painted = (settings.painted_share, shown.texture) if settings.painted_share else None
            meshes.append(translucent_mesh(medium, material.gloss_alpha, *geometry, painted=painted))
        else:
            meshes.append(scenes.coated_mesh(shown.texture, material.gloss_alpha, *geometry))
    for surface in moment.surfaces:
        geometry = (surface.vertices, surface.normals, surface.faces, surface.uv, surface.ior)
        meshes.append(scenes.coated_mesh(surface.texture, surface.gloss_alpha, *geometry))
    return meshes if moment.strands is None else [*meshes, hair_mesh(moment.strands)]
