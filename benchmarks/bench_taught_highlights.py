"""Highlights that RGCA's EyeNeRF and Linear learn when nothing else is asked of them, by data and steps.

    python -m benchmarks.bench_taught_highlights --results results/subjectB

The networks of the rows, of one expression, are taught the highlights themselves: GGX on the template at rest, every
texel in sight of a camera, squared errors, in place of pictures in which highlights are a small part. The share of the
squares that they explain is given for what they were taught and for eight cameras and eight patterns that they were
not. "As captured": 10 cameras and 18 patterns; "as filmed": 110 cameras and 460 patterns. All patterns are of three
lamps drawn from the same 460 places.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.bench_decoded_highlights import ggx
from docs.generate.markdown import table
from pipeline.avatar.networks.decoders import FIRST_SIDE, AtlasDecoder
from pipeline.avatar.networks.head_networks import VIEW_FEATURES
from pipeline.avatar.networks.light_linear import LightLinearDecoder
from pipeline.avatar.networks.pose_encoder import linear
from pipeline.avatar.texels.posed_texels import PosedTexels, pose_texels
from pipeline.avatar.training.optimizer import rate_share
from pipeline.config.train_avatar import TrainAvatar
from pipeline.geometry.texels import Atlas, read_atlas
from pipeline.lighting.environment_sh import COEFFICIENTS, even_directions, spherical_harmonics
from pipeline.lighting.lobes import unit

SETTINGS = TrainAvatar()
PLACES, LAMPS = 460, 3
"""Lamps that there are, and of a pattern."""

LOWEST = -0.3
"""Cosine from the front, of lamps; cameras stand in front."""

CAMERA_M = 1.2
BRIGHTNESS = 8.0
"""Of each lamp: highlights are then about as bright as skin."""

Truth = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(camera, lamps) -> radiance and what is seen."""

HELD_OUT = 8
"""Cameras, and patterns, that nothing is taught of."""

RATE = 10 * SETTINGS.learning_rate_network
"""Adam's, at the start. At that of training, the first 200 steps learn nothing at all."""


@dataclass(frozen=True)
class Case:
    """A network and what it is taught."""

    row: str
    data: str
    cameras: int
    patterns: int
    channels: tuple[int, ...] = SETTINGS.decoder_channels


CASES = (
    Case("Linear", "as captured", 10, 18),
    Case("Linear", "as filmed", 110, 460),
    Case("Linear, four times as wide", "as filmed", 110, 460, tuple(4 * n for n in SETTINGS.decoder_channels)),
    Case("EyeNeRF", "as captured", 10, 18),
    Case("EyeNeRF", "as filmed", 110, 460),
)


class Taught(nn.Module):
    """One of the rows' networks for a camera and a light, as `HeadNetworks` builds them."""

    def __init__(self, atlas: Atlas, case: Case, middle: Tensor) -> None:
        super().__init__()
        self.middle, self.code = middle, torch.zeros(SETTINGS.code_size)
        self.direction = linear(3, VIEW_FEATURES)
        sizes = (atlas, SETTINGS.code_size, case.channels)
        if case.row == "EyeNeRF":
            self.network = AtlasDecoder(*sizes, COEFFICIENTS, True, beside=VIEW_FEATURES)
        else:
            self.network = LightLinearDecoder(*sizes, beside=VIEW_FEATURES)

    def forward(self, camera: Tensor, lamps: Tensor) -> Tensor:
        """Radiance of all texels towards the camera, [texels]."""
        light = spherical_harmonics(lamps).sum(0)[:, None]
        seen = self.direction(unit(camera - self.middle))[:, None, None].expand(-1, FIRST_SIDE, FIRST_SIDE)
        if isinstance(self.network, AtlasDecoder):
            return (self.network(self.code, seen) @ light)[:, 0]
        return self.network(self.code, seen, light)[:, 0]


def highlights(posed: PosedTexels, alpha: float, camera: Tensor, lamps: Tensor) -> tuple[Tensor, Tensor]:
    """What is to be learned: radiance of the texels towards a camera, and which of them are seen."""
    turn = posed.tangent_frames.mT
    to_camera = (turn @ unit(camera - posed.points)[..., None])[..., 0]
    each = [ggx((turn @ lamp[:, None])[..., 0], to_camera, alpha) for lamp in lamps]
    seen = to_camera[:, 2] > 0.1
    return BRIGHTNESS * sum(each) * seen, seen


def drawn_patterns(count: int, random: np.random.Generator) -> list[Tensor]:
    """Directions of the lamps of each pattern."""
    places = torch.as_tensor(even_directions(PLACES), dtype=torch.float32)
    places = places[places[:, 2] > LOWEST]
    return [places[torch.as_tensor(random.choice(len(places), LAMPS, replace=False))] for _ in range(count)]


def explained(network: Taught, truth: Truth, cameras: Sequence[Tensor], patterns: Sequence[Tensor]) -> float:
    """Share of the squares, over all pairs."""
    left = whole = 0.0
    with torch.no_grad():
        for camera in cameras:
            for lamps in patterns:
                wanted, seen = truth(camera, lamps)
                left += float(((network(camera, lamps) - wanted) * seen).square().sum())
                whole += float(wanted.square().sum())
    return 1 - left / whole


def taught(atlas: Atlas, posed: PosedTexels, case: Case, alpha: float, marks: Sequence[int]) -> list[list[str]]:
    """A line for each number of steps; the rates fall over all of them, as in a training of the last one."""
    torch.manual_seed(0)
    random, middle = np.random.default_rng(0), posed.points.mean(0)
    truth, network = partial(highlights, posed, alpha), Taught(atlas, case, middle)
    cameras, new_cameras = (
        [middle + CAMERA_M * torch.as_tensor(way, dtype=torch.float32) for way in even_directions(2 * count)[:count]]
        for count in (case.cameras, HELD_OUT)
    )  # the first half of the directions is in front
    patterns, new_patterns = drawn_patterns(case.patterns, random), drawn_patterns(HELD_OUT, random)
    settings = SETTINGS.model_copy(update={"steps": marks[-1]})
    optimizer, lines = torch.optim.Adam(network.parameters(), lr=RATE), []
    for step in range(marks[-1]):
        for group in optimizer.param_groups:
            group["lr"] = RATE * rate_share(step, settings)
        optimizer.zero_grad()
        lamps = patterns[random.integers(len(patterns))]
        for each in random.integers(len(cameras), size=settings.cameras_per_step):
            wanted, seen = truth(cameras[each], lamps)
            (network(cameras[each], lamps) - wanted)[seen].square().mean().backward()
        optimizer.step()
        if step + 1 in marks:
            shown = (cameras[:: max(1, len(cameras) // HELD_OUT)], patterns[:: max(1, len(patterns) // HELD_OUT)])
            shares = (explained(network, truth, *pairs) for pairs in (shown, (new_cameras, new_patterns)))
            counts = f"{case.data}, {case.cameras} x {case.patterns}"
            lines.append([case.row, counts, f"{step + 1:,}", *(f"{100 * share:.0f}" for share in shares)])
            print(*lines[-1], sep=" | ", flush=True)
    return lines


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, required=True, help="folder results/SUBJECT of a head")
    parser.add_argument("--alpha", type=float, default=0.3, help="GGX width of the highlights")
    parser.add_argument(
        "--steps", type=int, nargs="+", default=[200, 1000, 4000], help="steps after which shares are given"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    atlas = read_atlas(options.results / "atlas.safetensors")
    posed = pose_texels(atlas, atlas.rest_vertices)
    lines = [line for case in CASES for line in taught(atlas, posed, case, options.alpha, options.steps)]
    print(table(("row", "cameras x patterns", "steps", "explained of what was taught, %", "of what was not, %"), lines))


if __name__ == "__main__":
    main()
