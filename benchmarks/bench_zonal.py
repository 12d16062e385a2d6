"""The two forms of point light for zonal transfer against each other: one JSON line per number of lights.

    python -m benchmarks.bench_zonal [--points 20000] [--channels 3] [--repeats 5]

Sides are timed alternately in one process, wall clock, forward and backward, medians; numba and torch use the threads
that NUMBA_NUM_THREADS and OMP_NUM_THREADS allow. `distant` lines compare what `pipeline.lighting.distant` chooses
between, and say what it chose; `near` lines show that lights nearby have nothing to gain (forward only).
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable

import torch

from pipeline.lighting.distant import LIGHTS_THAT_PAY, far_lights, gather_distant, light_harmonics
from pipeline.lighting.environment_sh import COEFFICIENTS, spherical_harmonics
from pipeline.lighting.lobes import unit
from pipeline.lighting.point_lights import PointLights
from pipeline.lighting.zonal import DEGREES, gather_light

COUNTS = (1, 4, 8, 16, 24, 32, 48, 64, 96, 128, 256, 512)
NEAR_COUNTS = (1, 8, 64)


def seconds_of(sides: dict[str, Callable[[], None]], repeats: int) -> dict[str, float]:
    """Median wall clock of each side, taken in turns, after one round that does not count."""
    taken: dict[str, list[float]] = {name: [] for name in sides}
    for turn in range(repeats + 1):
        for name, side in sides.items():
            started = time.perf_counter()
            side()
            if turn:
                taken[name].append(time.perf_counter() - started)
    return {name: statistics.median(times) for name, times in taken.items()}


def gather_near_by_harmonics(points: torch.Tensor, axes: torch.Tensor, lights: torch.Tensor, power: torch.Tensor):
    """`gather_light` with 81 coefficients of every point in place of Legendre polynomials."""
    coefficients = torch.zeros(len(points), COEFFICIENTS, power.shape[1])
    for position, intensity in zip(lights, power, strict=True):
        offset = position - points
        arriving = spherical_harmonics(unit(offset)) / offset.square().sum(-1, keepdim=True)
        coefficients += arriving[..., None] * intensity
    harmonics = spherical_harmonics(axes.mT.reshape(-1, 3)).reshape(len(axes), 3, COEFFICIENTS)
    bands = [slice(degree * degree, (degree + 1) ** 2) for degree in range(DEGREES)]
    return torch.stack([harmonics[..., band] @ coefficients[:, band] for band in bands], -2)


def main() -> None:
    """Print the lines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=20000)
    parser.add_argument("--channels", type=int, default=3)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    generator = torch.Generator().manual_seed(0)
    points = 0.3 * torch.randn(options.points, 3, generator=generator)
    axes = torch.linalg.qr(torch.randn(options.points, 3, 3, generator=generator))[0].requires_grad_()
    here, still = torch.zeros(3), torch.eye(3)
    size = {"points": options.points, "channels": options.channels}
    for count in COUNTS:
        directions = unit(torch.randn(count, 3, generator=generator))
        light = torch.rand(count, options.channels, generator=generator)

        def by_legendre(d: torch.Tensor = directions, e: torch.Tensor = light) -> None:
            gather_light(points, axes, far_lights(here, PointLights(d, e))).sum().backward()

        def by_harmonics(d: torch.Tensor = directions, e: torch.Tensor = light) -> None:
            gather_distant(axes, light_harmonics(here, still, PointLights(d, e))).sum().backward()

        sides = {"legendre": by_legendre, "harmonics": by_harmonics}
        seconds = seconds_of(sides, options.repeats)
        chosen = "legendre" if count < LIGHTS_THAT_PAY else "harmonics"
        line = {f"{name}_ms": round(1e3 * value, 2) for name, value in seconds.items()}
        ratio = round(seconds["legendre"] / seconds["harmonics"], 2)
        print(json.dumps({"case": "distant", **size, "lights": count, **line, "ratio": ratio, "chosen": chosen}))
    for count in NEAR_COUNTS:
        lights = 2.4 * unit(torch.randn(count, 3, generator=generator))
        light = torch.rand(count, options.channels, generator=generator)
        sides = {
            "legendre": lambda p=lights, e=light: gather_light(points, axes.detach(), PointLights(p, e)),
            "harmonics": lambda p=lights, e=light: gather_near_by_harmonics(points, axes.detach(), p, e),
        }
        seconds = seconds_of(sides, options.repeats)
        line = {f"{name}_ms": round(1e3 * value, 2) for name, value in seconds.items()}
        ratio = round(seconds["legendre"] / seconds["harmonics"], 2)
        print(json.dumps({"case": "near", **size, "lights": count, **line, "ratio": ratio, "chosen": "legendre"}))


if __name__ == "__main__":
    main()
