"""The splatting kernels against the same image made with torch operations, side by side: one JSON line per ratio.

    python -m benchmarks.bench_splatting [--repeats 5]

Each line compares two ways, timed alternately in one process, so that what else the machine does hits both alike.
Comparisons on one thread count CPU time, which busy neighbours hardly change; those of thread counts the wall clock.
"""

from __future__ import annotations

import argparse
import functools
import json
import statistics
import time
from collections.abc import Callable

import numba
import torch
from torch import Tensor

from pipeline.rendering.projection_kernels import TILE
from pipeline.rendering.splat import splat
from pipeline.rendering.splat_conventions import MIN_ALPHA, Splatted
from pipeline.rendering.splat_reference import (
    Footprints,
    blend_weights,
    footprint_alphas,
    project_footprints,
    splat_reference,
)
from pipeline.rendering.splat_types import CameraView, Gaussians, SplatOptions
from pipeline.rendering.supersample import splat_supersampled

CHANNELS = 12


def make_scene(count: int, size: int) -> tuple[dict[str, Tensor], dict]:
    """Gaussians spread over the image so that each covers about 35 pixels, and each pixel is covered by 9 or so."""
    draws = torch.Generator().manual_seed(count)
    means = (torch.rand(count, 3, generator=draws) - 0.5) * torch.tensor([2.0, 2.0, 1.0]) + torch.tensor(
        [0.0, 0.0, 3.0]
    )
    gaussians = {
        "means": means,
        "quaternions": torch.randn(count, 4, generator=draws),
        "scales": 2.0 / count**0.5 * (0.3 + torch.rand(count, 3, generator=draws)),
        "opacities": 0.05 + 0.95 * torch.rand(count, generator=draws),
        "features": torch.rand(count, CHANNELS, generator=draws),
    }
    K = torch.tensor([[1.2 * size, 0, size / 2], [0, 1.2 * size, size / 2], [0, 0, 1]])
    camera = {"R": torch.eye(3), "t": torch.zeros(3), "K": K, "width": size, "height": size}
    return {name: a.requires_grad_() for name, a in gaussians.items()}, camera


def splat_tiled_torch(gaussians: Gaussians, features: Tensor, view: CameraView) -> Splatted:
    """What the kernels do, in torch operations and autograd: per tile, its Gaussians against its pixels."""
    seen, width, height = project_footprints(gaussians, view, SplatOptions()), view.width, view.height
    channels = torch.cat([features[seen.index], seen.depth_m[:, None]], dim=1)
    with torch.no_grad():
        variance = (seen.factor**2).sum(dim=2) + seen.dilation_px2
        reach = torch.sqrt(2 * torch.log(seen.opacity.clamp(min=MIN_ALPHA) / MIN_ALPHA)[:, None] * variance)
        low, high = seen.center_px - reach, seen.center_px + reach
    rows_of_tiles = []
    for top in range(0, height, TILE):
        tiles = []
        for left in range(0, width, TILE):
            bottom, right = min(top + TILE, height), min(left + TILE, width)
            inside = (high[:, 0] > left) & (low[:, 0] < right) & (high[:, 1] > top) & (low[:, 1] < bottom)
            own = torch.nonzero(inside)[:, 0]
            subset = Footprints(
                own, seen.center_px[own], seen.factor[own], seen.dilation_px2, seen.opacity[own], seen.depth_m[own]
            )
            y, x = torch.meshgrid(torch.arange(top, bottom) + 0.5, torch.arange(left, right) + 0.5, indexing="ij")
            weights, light = blend_weights(footprint_alphas(subset, torch.stack([x, y], 2).reshape(-1, 2)))
            tile = torch.cat([weights @ channels[own], 1 - light[:, None]], 1)
            tiles.append(tile.reshape(bottom - top, right - left, -1))
        rows_of_tiles.append(torch.cat(tiles, dim=1))
    image = torch.cat(rows_of_tiles)
    return Splatted(image[..., :-2], image[..., -1], image[..., -2])


def on_gpu(tensors: dict) -> dict:
    """The same there; gradients end there, too."""
    return {
        name: a.detach().cuda().requires_grad_(a.requires_grad) if torch.is_tensor(a) else a
        for name, a in tensors.items()
    }


def step(render: Callable[..., Splatted], gaussians: dict, camera: dict, backward: bool, threads: int) -> Callable:
    """One call to be timed: the image, and if asked all gradients."""
    upstream = torch.rand(camera["height"], camera["width"], CHANNELS, generator=torch.Generator().manual_seed(0))
    upstream = upstream.to(camera["K"].device)

    scene = Gaussians(*(gaussians[name] for name in ("means", "quaternions", "scales", "opacities")))
    view = CameraView(**camera)

    def run() -> None:
        numba.set_num_threads(threads)
        torch.set_num_threads(threads)
        out = render(scene, gaussians["features"], view)
        if backward:
            torch.autograd.backward(
                [out.features, out.alpha, out.depth], [upstream, upstream[..., 0], upstream[..., 1]]
            )
        if upstream.is_cuda:
            torch.cuda.synchronize()

    return run


def compare(
    name: str, fast: Callable, slow: Callable, repeats: int, clock: Callable[[], float], **facts: object
) -> None:
    """Print slow / fast, the median over interleaved repeats; the first run of each, which may compile, is left out."""
    seconds: dict[str, list[float]] = {"fast": [], "slow": []}
    for k in range(repeats + 1):
        for label, run in (("fast", fast), ("slow", slow)):
            start = clock()
            run()
            if k:
                seconds[label].append(clock() - start)
    medians = {f"{label}_ms": round(1e3 * statistics.median(values), 2) for label, values in seconds.items()}
    ratio = statistics.median(s / f for f, s in zip(seconds["fast"], seconds["slow"], strict=True))
    print(json.dumps({"ratio": name, "value": round(ratio, 2), **medians, "repeats": repeats, **facts}), flush=True)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5, help="timed runs of each side")
    repeats = parser.parse_args().repeats
    threads = numba.get_num_threads()
    alone, together = time.process_time, time.perf_counter
    for count, size in ((4096, 128), (16384, 256), (65536, 512)):
        gaussians, camera = make_scene(count, size)
        facts = {"gaussians": count, "size": size, "channels": CHANNELS}
        for backward in (False, True):
            what = "forward and backward" if backward else "forward"
            make = functools.partial(step, gaussians=gaussians, camera=camera, backward=backward)
            if size <= 256:
                tiled = make(splat_tiled_torch, threads=1)
                compare(f"tiled torch / kernels, {what}", make(splat, threads=1), tiled, repeats, alone, **facts)
            one, all_of_them = make(splat, threads=1), make(splat, threads=threads)
            compare(f"one thread / {threads} threads, {what}", all_of_them, one, 3 * repeats, together, **facts)
            if torch.cuda.is_available():
                there = step(splat, on_gpu(gaussians), on_gpu(camera), backward, threads)
                compare(f"kernels, {threads} threads / gsplat, {what}", there, all_of_them, repeats, together, **facts)
    gaussians, camera = make_scene(4096, 128)
    facts = {"gaussians": 4096, "size": 128, "channels": CHANNELS}
    make = functools.partial(step, gaussians=gaussians, camera=camera, backward=True, threads=1)
    twice = make(splat_supersampled)
    compare("supersampled twice / once, forward and backward", make(splat), twice, repeats, alone, **facts)
    compare("dense torch / kernels, forward and backward", make(splat), make(splat_reference), 1, alone, **facts)


if __name__ == "__main__":
    main()
