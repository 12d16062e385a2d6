"""Jobs of `benchmarks.bench_limits`: the pipeline's own kernels with their operations and bytes, and bare twins.

Operations are additions, multiplications, comparisons and choices of float32, a fused pair as two, a division or root
as one; what loops and addresses take is not counted. Bytes are those that have to pass between memory and processor if
nothing is read or written twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from unittest import mock

import numpy as np
import torch
from numba import njit

from benchmarks.bench_splatting import CHANNELS, make_scene
from benchmarks.bench_splatting import step as splatting_step
from benchmarks.irradiance_poses import make_pose
from pipeline.avatar.networks.shadow_net import ShadowNet
from pipeline.config.train_avatar import TrainAvatar
from pipeline.lighting import zonal
from pipeline.rendering import splat
from pipeline.rendering.blending_kernels import reach, row_range
from pipeline.rendering.projection_kernels import FOOTPRINT_COLUMNS, MOMENT_COLUMNS, TILE

FLOAT = 4
"""Bytes of a float32."""


@dataclass(frozen=True)
class Kernel:
    """A job that does known operations on known bytes.

    Attributes:
        what: its name.
        size: in words.
        run: the job.
        operations, bytes: of one run.
    """

    what: str
    size: str
    run: Callable[[], object]
    operations: float
    bytes: float


EXPONENTIAL = 17
"""Operations of `exp_nonpositive`: limit and scale, round (a difference, two conversions), the rest, six steps of two
operations of the polynomial, the product; whole numbers are not counted."""

BLENDED = 3 + 4 + EXPONENTIAL + 4 + 2 + 4 + 3 + 2
"""Operations per pixel of `_blend_row`: e; the exponent; its exponential; opacity, limit and cut-off; the light behind;
the end, and whether it is reached; weight and light chosen; two sums."""

UNBLENDED = 3 + 4 + EXPONENTIAL + 4 + 2 + 2 + 2 + 2 + 1
"""Operations per pixel of `_unblend_row`: as above; the end; 1 / (1 - alpha); light and weight; raw; the sum."""

MOMENTS = 3 + 3 + 2 + 2 + (1 + 2 + 3 + 2 + 3 + 3)
"""Operations per pixel of `_add_moments`: e; the slope; what is behind; dL/dq; six moments."""


def blending() -> list[Kernel]:
    """Blending forward and backward, with the arguments that splatting of a known scene gives them."""
    gaussians, side = 16384, 256
    seen: dict[str, tuple] = {}
    kernels = {name: getattr(splat, name) for name in ("blend", "blend_backward")}

    def kept(name: str) -> Callable:
        return lambda *arguments: (seen.update({name: arguments}), kernels[name](*arguments))

    with mock.patch.multiple(splat, **{name: kept(name) for name in kernels}):
        splatting_step(splat.splat, *make_scene(gaussians, side), backward=True, threads=1)()
    footprints, channels, starts, entries, across = seen["blend"][:5]
    forward, backward = count_strips(footprints, starts, entries, across, seen["blend"][-1])
    layers, pixels = channels.shape[1], side * side
    listed = len(entries) * (FLOAT * (1 + layers) + 8 * FOOTPRINT_COLUMNS)
    slots = len(entries) * FLOAT * (layers + MOMENT_COLUMNS)
    size = f"{gaussians:,} Gaussians, {side} x {side} pixels, {CHANNELS} channels, {forward:,} strips of {TILE}"
    return [
        Kernel("blending, forward", size, lambda: kernels["blend"](*seen["blend"]),
               forward * TILE * (BLENDED + 2 * layers), listed + pixels * FLOAT * (layers + 2)),
        Kernel("blending, backward", size, lambda: kernels["blend_backward"](*seen["blend_backward"]),
               backward * TILE * (UNBLENDED + 4 * layers + MOMENTS),
               listed + slots + pixels * FLOAT * (layers + 3)),
    ]  # fmt: skip


@njit
def count_strips(footprints, starts, entries, across, ends):
    """Rows of sixteen pixels that blending works on, forward and backward: reached, and not yet opaque."""
    forward, backward = 0, 0
    for tile in range(starts.shape[0] - 1):
        top, left = (tile // across) * TILE, (tile % across) * TILE
        rows = min(TILE, ends.shape[0] - top)
        for i in range(starts[tile + 1] - starts[tile]):
            footprint = footprints[entries[starts[tile] + i]]
            first, last = row_range(footprint, top, rows)
            for row in range(first, last):
                reached = reach(footprint, top + row, left)[3]
                end = ends[top + row, left : left + TILE].max()
                forward += reached and i <= end  # The Gaussian that ends the last pixel is still looked at.
                backward += reached and i < end
    return forward, backward


def gathering() -> list[Kernel]:
    """Light of 24 white lamps along the axes of 20,000 Gaussians, forward and backward, without splatting's torch."""
    points, lights, channels, degrees = 20_000, 24, 1, zonal.DEGREES
    draws = np.random.default_rng(0)
    places = 0.3 * draws.normal(size=(points, 3)).astype(np.float32)
    axes = np.linalg.qr(draws.normal(size=(points, 3, 3)))[0].astype(np.float32)
    lamps = (2.4 * np.linalg.qr(draws.normal(size=(lights, 3, 3)))[0][:, 0]).astype(np.float32)
    strengths = np.ones((lights, channels), np.float32)
    seen, norms = np.full((lights, (points + 7) // 8), 255, np.uint8), zonal.NORMALISATION
    out = np.empty((points, 3, degrees, channels), np.float32)
    upstream, to_points, to_axes = np.ones_like(out), np.empty_like(places), np.empty_like(axes)
    given = (places, axes, lamps, strengths)
    # Per light: way, squared distance, limit, root, two divisions; per axis the cosine; per degree the light, its sum
    # and Bonnet's recurrence; backward, its derivative and the sums of both.
    forward = 3 + 5 + 1 + 2 + 1 + 3 * (5 + 1 + degrees * (1 + 2 * channels + 4))
    backward = 3 + 5 + 1 + 2 + 3 + 1 + 3 * (5 + degrees * (2 * channels + 4 + 4 + 3 + 2) + 13) + 25
    read, written = FLOAT * points * 12, FLOAT * out.size
    size = f"{points:,} points, {lights} lamps, {channels} channel, {degrees} degrees"
    return [
        Kernel("gathering light, forward", size, lambda: zonal.gather_forward(*given, seen, norms, out),
               points * lights * forward, read + written),
        Kernel("gathering light, backward", size,
               lambda: zonal.gather_backward(*given, upstream, seen, norms, to_points, to_axes),
               points * lights * backward, 2 * read + written),
    ]  # fmt: skip


def shadow_network() -> list[Kernel]:
    """The shadow network on a map of 256 x 256 texels, forward and backward."""
    side, width = 256, TrainAvatar().shadow_width
    atlas = make_pose(side).atlas
    torch.manual_seed(0)
    network, maps = ShadowNet(atlas, width), torch.rand(2, atlas.texel_count)
    weights = 9 * (3 * width + width * width + width)
    # Forward, by weights, by inputs: two operations per weight and texel; the first layer's inputs need no gradient.
    operations = 2 * side * side * (3 * weights - 9 * 3 * width)
    # Each map is written once and read once: forward before and after its activation; backward read again, and its
    # gradient before and after.
    floats = 3 + 4 * 2 * width + 1 + (3 + 2 * width) + 4 * 2 * width + 1
    size = f"{side} x {side} texels, {width} channels"
    run = lambda: network(*maps).sum().backward()  # noqa: E731
    return [Kernel("shadow network, both ways", size, run, operations, side * side * FLOAT * floats)]


def adam() -> list[Kernel]:
    """A fused step of Adam on more parameters than the caches hold."""
    tensors, each = 16, 2**18
    parameters = [torch.randn(each).requires_grad_() for _ in range(tensors)]
    for parameter in parameters:
        parameter.grad = torch.randn(each)
    optimizer = torch.optim.Adam(parameters, fused=True)
    # Both moments (3 and 4), their corrections (2), root, quotient, sum and step (5). All are read, all but gradients
    # written.
    return [Kernel("Adam", f"{tensors * each:,} parameters", optimizer.step, tensors * each * 14,
                   tensors * each * FLOAT * 7)]  # fmt: skip


def roofs() -> dict[str, Kernel]:
    """What the machine can do: products of large matrices by the better of two libraries, and a sum in memory."""
    side, length = 1536, 2**24
    a, b = (np.random.default_rng(seed).random((side, side), np.float32) for seed in (0, 1))
    ta, tb = torch.from_numpy(a), torch.from_numpy(b)
    x, y = np.ones(length, np.float32), np.ones(length, np.float32)
    products, size = 2.0 * side**3, f"{side} x {side}"
    return {
        "numpy": Kernel("sgemm, NumPy", size, lambda: a @ b, products, 3 * a.nbytes),
        "torch": Kernel("sgemm, torch", size, lambda: ta @ tb, products, 3 * a.nbytes),
        "memory": Kernel("x + s y", f"{length:,} floats", lambda: add_scaled(x, y), 2.0 * length, 3.0 * x.nbytes),
    }


@njit(fastmath=True)
def add_scaled(x, y):
    """x += y / 2: two reads and a write of each number, and no line that is fetched only to be overwritten."""
    for i in range(x.shape[0]):
        x[i] += np.float32(0.5) * y[i]
