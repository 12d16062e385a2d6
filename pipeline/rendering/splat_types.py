"""Arguments of all splatting functions. Gaussians, the camera that sees them, and how they are drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.rendering.splat_conventions import check_splat_inputs


@dataclass(frozen=True)
class Gaussians:
    """Anisotropic Gaussians in the world.

    Attributes:
        means: metres.
        quaternions: (w, x, y, z) of any length; zero means no rotation.
        scales: standard deviations along the rotated axes, metres; may be zero.
        opacities: in [0, 1].
    """

    means: Float[Tensor, "g 3"]
    quaternions: Float[Tensor, "g 4"]
    scales: Float[Tensor, "g 3"]
    opacities: Float[Tensor, " g"]

    def __len__(self) -> int:
        return len(self.means)

    def named(self) -> dict[str, Tensor]:
        """Tensors by name, in the order of the attributes."""
        return {
            "means": self.means, "quaternions": self.quaternions, "scales": self.scales, "opacities": self.opacities
        }  # fmt: skip

    def map(self, change: Callable[[Tensor], Tensor]) -> Gaussians:
        """The same Gaussians with every tensor changed: moved to a device, cast, detached."""
        return Gaussians(*(change(tensor) for tensor in self.named().values()))


@dataclass(frozen=True)
class CameraView:
    """A pinhole camera without distortion, and the size of its picture.

    Attributes:
        R, t: camera from world, metres: x_camera = R x + t.
        K: intrinsics in pixels without skew; the first pixel centre is (0.5, 0.5).
        width, height: pixels.
    """

    R: Float[Tensor, "3 3"]
    t: Float[Tensor, " 3"]
    K: Float[Tensor, "3 3"]
    width: int
    height: int

    @property
    def center(self) -> Float[Tensor, " 3"]:
        """Centre of projection in the world, metres."""
        return -self.R.T @ self.t

    def to(self, *target: torch.dtype | torch.device) -> CameraView:
        """The same view in another number type or on another device, without gradient."""
        R, t, K = (tensor.detach().to(*target) for tensor in (self.R, self.t, self.K))
        return CameraView(R, t, K, self.width, self.height)


@dataclass(frozen=True)
class SplatOptions:
    """Options of drawing Gaussians.

    Attributes:
        dilation_px2: variance added to every footprint, px^2. 0.3 is gsplat's; it makes texels about a pixel wide cover
            each other.
        compensate_opacity: make opacities smaller, so that the dilation spreads a footprint without adding to it; see
            `pipeline.rendering.splat_conventions`.
        near_m: Gaussians whose mean is nearer to the camera plane, or behind it, are not drawn.
        median_depth: `depth` of the picture is the median; see `Splatted`. Not on a GPU.
    """

    dilation_px2: float = 0.1
    compensate_opacity: bool = False
    near_m: float = 0.01
    median_depth: bool = False


@dataclass(frozen=True)
class Supersampling:
    """A picture rendered larger and filtered down.

    Attributes:
        factor: samples per pixel and direction; 1 with the box filter is `splat` itself.
        filter: "box" averages a pixel's own samples. "gaussian" weighs samples by their distance to the pixel centre; a
            margin is rendered around the image so that its border is filtered like its middle.
        filter_std_px: standard deviation of the Gaussian filter, pixels of the final image.
    """

    factor: int = 2
    filter: Literal["box", "gaussian"] = "box"
    filter_std_px: float = 0.6


def check_splat_arguments(gaussians: Gaussians, features: Tensor, view: CameraView, options: SplatOptions) -> None:
    """Raise ValueError, naming the argument, for what would otherwise come out as a wrong image."""
    tensors = {**gaussians.named(), "features": features, "R": view.R, "t": view.t}
    check_splat_inputs(tensors, view.K, view.width, view.height, options.dilation_px2, options.near_m)
