"""Gaussians as the .ply file of the reference 3DGS implementation.

Kerbl et al. 2023; splat viewers open it.

Little-endian float32 per Gaussian, in this order: x, y, z, nx, ny, nz, f_dc_0..2, opacity, scale_0..2, rot_0..3. A
viewer shows SH_0 f_dc + 1/2 as it is, so colours are stored as sRGB; opacities as logits, scales as logarithms,
quaternions w first. Without f_rest: degree 0, one colour from all sides. Positions stay as they are, metres, y up;
viewers made for COLMAP scenes expect y down and may show the subject on its head. Viewers blend what they show, in
sRGB, dilate by 0.3 px^2 and draw the far side of the body, too: edges and thin places look a little different there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.base.color import linear_from_srgb, srgb_from_linear
from pipeline.base.errors import InputError
from pipeline.base.files import written_whole
from pipeline.rendering.splat_conventions import MIN_QUATERNION_NORM

SH_0 = 0.5 / math.sqrt(math.pi)
"""The spherical harmonic of degree 0, 0.28209479."""

SMALLEST_DOUBT = 1e-6
"""Opacities are kept this far from 0 and 1, where their logits are infinite: less than a viewer's 8 bits tell apart."""

SMALLEST_SCALE_M = 1e-7
"""Scales below this are stored as this: their logarithm stays finite, and no pixel is that small."""

PROPERTIES = (
    "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
)  # fmt: skip
"""Names in the order of the reference implementation's `save_ply`, f_rest left out."""


@dataclass(frozen=True)
class Splats:
    """Gaussians with one colour each.

    Attributes:
        means: metres. normals: of the surface, unit length; viewers ignore them.
        rgb_linear: what a viewer can show lies in [0, 1].
        opacities: in [0, 1]. scales: metres. quaternions: w, x, y, z.
    """

    means: Float[Tensor, "g 3"]
    normals: Float[Tensor, "g 3"]
    rgb_linear: Float[Tensor, "g 3"]
    opacities: Float[Tensor, " g"]
    scales: Float[Tensor, "g 3"]
    quaternions: Float[Tensor, "g 4"]


@dataclass(frozen=True)
class StoredSplats:
    """Gaussians in the numbers that files of splats share, NumPy.

    Attributes:
        means: metres. normals: of the surface, unit length.
        coefficients: of the spherical harmonic of degree 0; SH_0 f + 1/2 is sRGB.
        opacities: in [0, 1]. log_scales: of metres. quaternions: w, x, y, z, of unit length.
    """

    means: Float[np.ndarray, "g 3"]
    normals: Float[np.ndarray, "g 3"]
    coefficients: Float[np.ndarray, "g 3"]
    opacities: Float[np.ndarray, " g"]
    log_scales: Float[np.ndarray, "g 3"]
    quaternions: Float[np.ndarray, "g 4"]


def stored_splats(splats: Splats) -> StoredSplats:
    """The numbers of a file of splats; colours are clipped to [0, 1] and encoded as sRGB."""
    srgb = srgb_from_linear(splats.rgb_linear.clamp(0, 1))
    norm = splats.quaternions.norm(dim=1, keepdim=True).clamp_min(MIN_QUATERNION_NORM)
    tensors = (
        splats.means, splats.normals, (srgb - 0.5) / SH_0, splats.opacities,
        splats.scales.clamp_min(SMALLEST_SCALE_M).log(), splats.quaternions / norm,
    )  # fmt: skip
    return StoredSplats(*(tensor.detach().cpu().numpy() for tensor in tensors))


def write_splats(path: Path, splats: Splats) -> None:
    """Write a .ply; colours are clipped to [0, 1] and encoded as sRGB."""
    stored = stored_splats(splats)
    logits = torch.logit(splats.opacities.detach().cpu(), SMALLEST_DOUBT).numpy()[:, None]
    columns = [
        stored.means, stored.normals, stored.coefficients, logits, stored.log_scales, stored.quaternions
    ]  # fmt: skip
    rows = np.concatenate(columns, 1).astype("<f4")
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    header = "\n".join([*lines, *(f"property float {name}" for name in PROPERTIES), "end_header", ""])
    with written_whole(path) as temporary:
        temporary.write_bytes(header.encode("ascii") + rows.tobytes())


def read_splats(path: Path) -> Splats:
    """Read what `write_splats` wrote.

    Raises:
        InputError: if the file is missing or of another layout.
    """
    try:
        header, found, body = Path(path).read_bytes().partition(b"end_header\n")
    except OSError as error:
        raise InputError(f"{path}: expected a .ply file, found: {error.strerror}") from error
    words = [line.split() for line in header.decode("ascii", "replace").splitlines()]
    names = tuple(line[2] for line in words if line[:2] == ["property", "float"] and len(line) == 3)
    if not found or names != PROPERTIES or len(body) % (4 * len(PROPERTIES)):
        raise InputError(f"{path}: expected the float properties {PROPERTIES}, found {names}, {len(body)} bytes")
    rows = torch.from_numpy(np.frombuffer(body, "<f4").reshape(-1, len(PROPERTIES)).astype(np.float32))
    means, normals, dc, opacity, scales, quaternions = rows.split([3, 3, 3, 1, 3, 4], 1)
    rgb = linear_from_srgb(SH_0 * dc + 0.5)
    return Splats(means, normals, rgb, torch.sigmoid(opacity[:, 0]), scales.exp(), quaternions)
