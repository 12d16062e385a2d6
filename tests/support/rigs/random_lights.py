"""Points with axes, and lights around them, at random; for the kernels that gather light."""

import torch

FLOAT32_SUM = 64 * 8 * 6e-8
"""64 lights, values to about 8 after the recurrence, half an ulp each."""


def random_scene(points: int, lights: int, channels: int, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    place = 0.4 * torch.randn(points, 3, generator=generator)
    axes = torch.linalg.qr(torch.randn(points, 3, 3, generator=generator))[0]
    light = 2.4 * torch.nn.functional.normalize(torch.randn(lights, 3, generator=generator), dim=-1)
    return place, axes.contiguous(), light, torch.rand(lights, channels, generator=generator)
