"""Points of a surface under lights, of which each sees seven in ten."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from pipeline.lighting.lobes import unit

COUNT, LIGHTS = 40, 9


def points_under_lights() -> tuple[Tensor, ...]:
    """Points, normals, directions to a camera, widths, lights, their power, and a mask [lights, points] of who sees."""
    generator = torch.Generator().manual_seed(3)

    def random(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    normals, to_camera = unit(random(COUNT, 3)), unit(random(COUNT, 3))
    lights = 2 * unit(random(LIGHTS, 3))
    alpha = 0.05 + 0.9 * torch.rand(COUNT, generator=generator)
    seen = torch.rand(LIGHTS, COUNT, generator=generator) < 0.7
    return 0.3 * random(COUNT, 3), normals, to_camera, alpha, lights, torch.rand(LIGHTS, 3, generator=generator), seen


def packed(seen: Tensor) -> np.ndarray:
    """Such a mask in bits, as `PointLights` has it."""
    return np.packbits(seen.numpy(), axis=1)
