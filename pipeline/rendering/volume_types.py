"""Boxes of voxels, as the functions that march rays through them take them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from pipeline.rendering.splat_conventions import NotFinite
from pipeline.rendering.splat_types import CameraView
from pipeline.rendering.volume_conventions import SMALLEST_HALF_SIZE_M

PLAIN = -1
"""Of a channel's `tinted`: no tint."""


@dataclass(frozen=True)
class Volumes:
    """Boxes of voxels in the world; see `pipeline.rendering.volume_conventions`.

    Features have one value per column of voxels; what of them is colour, the voxels' tint changes in depth.

    Attributes:
        centers: metres.
        rotations: world from box.
        half_sizes: along the rotated axes, metres; may be zero.
        density: of voxels along the box's third, second and first axis; opacity per metre, not negative.
        tint: factors on colours.
    """

    centers: Float[Tensor, "b 3"]
    rotations: Float[Tensor, "b 3 3"]
    half_sizes: Float[Tensor, "b 3"]
    density: Float[Tensor, "b deep rows columns"]
    tint: Float[Tensor, "b deep rows columns 3"]

    def __len__(self) -> int:
        return len(self.centers)

    def named(self) -> dict[str, Tensor]:
        """Tensors by name, in the order of the attributes."""
        return {
            "centers": self.centers, "rotations": self.rotations, "half_sizes": self.half_sizes,
            "density": self.density, "tint": self.tint,
        }  # fmt: skip

    def map(self, change: Callable[[Tensor], Tensor]) -> Volumes:
        """The same boxes with every tensor changed: moved to a device, cast, detached."""
        return Volumes(*(change(tensor) for tensor in self.named().values()))

    def drawn(self) -> Bool[Tensor, " b"]:
        """Boxes that have an extent along all axes."""
        return (self.half_sizes.detach() > SMALLEST_HALF_SIZE_M).all(1)

    def from_world(self) -> Float[Tensor, "b 3 3"]:
        """diag(1 / s) R^T; zero for boxes that are not drawn."""
        drawn = self.drawn()[:, None]
        usable = torch.where(drawn, self.half_sizes, torch.ones_like(self.half_sizes))
        inverse = self.rotations.transpose(1, 2) / usable[:, :, None]
        return torch.where(drawn[:, :, None], inverse, torch.zeros_like(inverse))


@dataclass(frozen=True)
class AnchoredVolumes:
    """Boxes, and the points at which what their columns show is evaluated.

    Attributes:
        means: metres.
    """

    volumes: Volumes
    means: Float[Tensor, "texels 3"]


def check_march_arguments(
    volumes: Volumes, features: Tensor, tinted: tuple[int, ...], view: CameraView, step_m: float
) -> None:
    """Refuse, naming the argument, what would come out as a wrong image, by a ValueError."""
    tensors = {**volumes.named(), "features": features, "R": view.R, "t": view.t, "K": view.K}
    for name, tensor in tensors.items():
        if tensor.device != view.K.device:
            raise ValueError(f"{name}: expected a tensor on {view.K.device} like K, found {tensor.device}")
        if not bool(torch.isfinite(tensor.detach().sum())) and not bool(torch.isfinite(tensor).all()):
            bad = torch.nonzero(~torch.isfinite(tensor))
            raise NotFinite(f"{name}: expected finite numbers, found {len(bad)} others, first at {bad[0].tolist()}")
    if features.shape[:3] != (len(volumes), *volumes.density.shape[2:]):
        found = f"{tuple(features.shape)} for density {tuple(volumes.density.shape)}"
        raise ValueError(f"features: expected a value for each column of voxels, found {found}")
    if len(tinted) != features.shape[3] or any(component not in (PLAIN, 0, 1, 2) for component in tinted):
        raise ValueError(f"tinted: expected -1, 0, 1 or 2 for each of {features.shape[3]} channels, found {tinted}")
    if len(volumes) and bool((volumes.density < 0).any()):
        raise ValueError(f"density: expected none below 0, found {float(volumes.density.min())}")
    if view.K[0, 1] != 0 or view.K[0, 0] <= 0 or view.K[1, 1] <= 0:
        raise ValueError(f"K: expected positive focal lengths and no skew, found {view.K[:2, :2].tolist()}")
    if view.width < 1 or view.height < 1:
        raise ValueError(f"width, height: expected at least 1, found {view.width}, {view.height}")
    if not 0 < step_m < math.inf:
        raise ValueError(f"step_m: expected a positive number, found {step_m}")


def rays(view: CameraView) -> tuple[Float[Tensor, "pixels 3"], Float[Tensor, " pixels"]]:
    """Unit directions through the pixels' centres, row by row.

    Then the camera depth of a metre along each.
    """
    like = {"dtype": view.K.dtype, "device": view.K.device}
    y, x = torch.meshgrid(torch.arange(view.height, **like), torch.arange(view.width, **like), indexing="ij")
    slope_x, slope_y = (x + 0.5 - view.K[0, 2]) / view.K[0, 0], (y + 0.5 - view.K[1, 2]) / view.K[1, 1]
    inside = torch.stack([slope_x, slope_y, torch.ones_like(x)], -1).reshape(-1, 3)
    length = inside.norm(dim=1)
    return inside @ view.R / length[:, None], 1 / length
