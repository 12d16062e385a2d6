"""Nanoseconds per point and light of the gloss that training sums, with its gradient.

`PYTHONPATH=CHECKOUT python -m benchmarks.bench_reflections` measures the package of a checkout; run it in turn with two
of them to compare. One thread. Prints one JSON line for each kind of gloss; the sum tells that both computed the same.
"""

from __future__ import annotations

import json
import time

import numba
import torch

from pipeline.lighting.lobes import unit
from pipeline.lighting.microfacet import gather_reflections
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.specular_lobes import gather_specular

POINTS, LIGHTS, REPEATS = 40_000, 60, 5


def main() -> None:
    """Command line."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)

    def random(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    points, normals = 0.1 * random(POINTS, 3), unit(random(POINTS, 3))
    to_camera = unit(normals + 0.7 * random(POINTS, 3))
    alpha = 0.08 + 0.15 * torch.rand(POINTS, generator=generator)
    lights = PointLights(1.3 * unit(random(LIGHTS, 3)), torch.rand(LIGHTS, 3, generator=generator))
    lobe = 2 * (normals * to_camera).sum(-1, keepdim=True) * normals - to_camera
    kinds = {
        "half vectors": lambda normals, alpha: gather_reflections(points, normals, to_camera, alpha, lights, True),
        "GGX": lambda normals, alpha: gather_reflections(points, normals, to_camera, alpha, lights),
        "spherical Gaussian": lambda _, alpha: gather_specular(points, lobe, 1.4 * alpha, lights),
    }
    for kind, gather in kinds.items():
        seconds = []
        for _ in range(REPEATS + 1):  # the first compiles
            variables = normals.clone().requires_grad_(), alpha.clone().requires_grad_()
            started = time.process_time()
            found = gather(*variables)
            found.square().sum().backward()
            seconds.append(time.process_time() - started)
        row = {"gloss": kind, "ns": 1e9 * min(seconds[1:]) / POINTS / LIGHTS, "sum": found.double().sum().item()}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
