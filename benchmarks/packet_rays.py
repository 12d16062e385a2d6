"""The rays of a map by Mitsuba's vectorised path: Embree by packets, compiled by LLVM. What a binding could win."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from pipeline.config.synthesize_capture import SynthesizeCapture
from pipeline.lighting.shadow_rays import Rays
from pipeline.synthesis.renderer_choice import choose_renderer


def packet_tracer(
    vertices: np.ndarray, faces: np.ndarray, rays: Sequence[Rays]
) -> Callable[[], list[np.ndarray]] | None:
    """Function that asks, on one thread, which of the rays meet the mesh; None where no fit LLVM library is.

    Args:
        vertices: in Embree's scaled scene, as `Occluders.scaled` gives them.
        faces: of the mesh.
        rays: already in Mitsuba's memory when the function is called.
    """
    if choose_renderer(SynthesizeCapture(renderer="auto", spp=4096))[0] != "llvm":
        return None
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_rgb")
    drjit.set_thread_count(1)
    mesh = mitsuba.Mesh("mesh", len(vertices), len(faces))
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    scene = mitsuba.load_dict({"type": "scene", "mesh": mesh})
    ready = []
    for some in rays:
        origins, directions = (np.ascontiguousarray(array.T) for array in (some.origins, some.directions))
        ray = mitsuba.Ray3f(
            mitsuba.Point3f(origins), mitsuba.Vector3f(directions), mitsuba.Float(some.lengths.copy()), 0.0, []
        )
        drjit.eval(ray)
        ready.append(ray)

    def trace() -> list[np.ndarray]:
        hits = [scene.ray_test(ray) for ray in ready]
        drjit.eval(hits)
        drjit.sync_thread()
        return [np.array(hit) for hit in hits]

    return trace
