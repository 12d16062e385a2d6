"""Learned diffuse transfer: coefficients, start, product with light (RFGCA 7-9, RGCA 5)."""

from __future__ import annotations

from abc import abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor

from pipeline.avatar.appearance.models import DiffuseModel
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_parameters import TexelParameters
from pipeline.avatar.texels.texel_store import TexelStore
from pipeline.lighting.environment_sh import spherical_harmonics
from pipeline.lighting.zonal import DEGREES, clamped_cosine_coefficients

COLOR_DEGREES = 4
"""Degrees 0..3 of the transfer are coloured, 4..8 monochrome (RGCA section 3.3, RFGCA 9)."""

UNTURNED_SCALE = 3.43
"""Unturned coefficients are stored this much larger. The harmonics of a light's direction have absolute values that sum
to 18.0 on average, those that three zonal lobes multiply, to 5.25: with the ratio taken out, a step of Adam moves both
kinds of transfer as far, and both are held to their start about as strongly."""


def start_transfer(degrees: int = DEGREES) -> tuple[Float[Tensor, "3 color 3"], Float[Tensor, "3 mono"]]:
    """Zonal coefficients of a Lambertian texel, coloured and monochrome.

    Tangent and bitangent lobes are empty.

    `degrees`: 0, 1 and so on to one less than this; above `COLOR_DEGREES` they are monochrome.
    """
    transfer = torch.zeros(3, degrees)
    transfer[2] = torch.as_tensor(clamped_cosine_coefficients()[:degrees])
    return transfer[:, :COLOR_DEGREES, None].repeat(1, 1, 3), transfer[:, COLOR_DEGREES:].clone()


def start_harmonics(
    normals: Float[Tensor, "texels 3"],
    degrees: int = DEGREES,
) -> tuple[Float[Tensor, "texels color 3"], Float[Tensor, "texels mono"]]:
    """SH coefficients of a Lambertian texel, z_l Y_lm(n), times `UNTURNED_SCALE`. In the frame of its normal n."""
    lobe = torch.as_tensor(clamped_cosine_coefficients()[:degrees], dtype=torch.float32)
    orders = torch.arange(1, 2 * degrees, 2)
    transfer = UNTURNED_SCALE * spherical_harmonics(normals, degrees) * lobe.repeat_interleave(orders)
    return transfer[:, : COLOR_DEGREES**2, None].repeat(1, 1, 3), transfer[:, COLOR_DEGREES**2 :].clone()


def shade_diffuse(
    albedo: Float[Tensor, "texels 3"],
    transfer_color: Float[Tensor, "texels 3 color 3"],
    transfer_mono: Float[Tensor, "texels 3 mono"] | None,
    light: Float[Tensor, "texels 3 degrees channels"],
) -> Float[Tensor, "texels 3"]:
    """Diffuse light by zonal transfer (RFGCA 7-9).

    c_d = albedo * sum over axes a and degrees l of z_al times the light gathered there.
    """
    color = (transfer_color * light[:, :, :COLOR_DEGREES]).sum((1, 2))
    if transfer_mono is None:
        return albedo * color
    mono = (transfer_mono[..., None] * light[:, :, COLOR_DEGREES:]).sum((1, 2))
    return albedo * (color + mono)


def shade_harmonics(
    albedo: Float[Tensor, "texels 3"],
    transfer_color: Float[Tensor, "texels color 3"],
    transfer_mono: Float[Tensor, "texels mono"] | None,
    light: Float[Tensor, "#texels coefficients channels"],
) -> Float[Tensor, "texels 3"]:
    """Diffuse light by unturned harmonics, in the frame of `light` (RGCA 5).

    At degree 8 they are 113 per texel instead of 51 zonal ones; these are stored times `UNTURNED_SCALE`. Without
    monochrome ones, degrees above 3 of the light are not seen.
    """
    color = (transfer_color * light[:, : COLOR_DEGREES**2]).sum(1)
    if transfer_mono is None:
        return albedo / UNTURNED_SCALE * color
    mono = (transfer_mono[..., None] * light[:, COLOR_DEGREES**2 :]).sum(1)
    return albedo / UNTURNED_SCALE * (color + mono)


class LearnedTransfer(DiffuseModel):
    """Coefficients that every texel learns, held to where they started.

    Buffers `start_*` of the store keep where that is.

    Attributes:
        starts_alike: all texels start at the same coefficients.
    """

    starts_alike = False

    def __init__(self, store: TexelStore, spec: AvatarSpec) -> None:
        self.store, self.degrees = store, spec.degrees
        for name, values in zip(TRANSFER, self.start(spec), strict=True):
            if not values.numel():  # of monochrome ones there may be none
                continue
            # What the atlas says is not stored twice.
            store.register_buffer(f"start_{name}", values, persistent=self.starts_alike)
            repeats = (len(store.spacing), *[1] * values.ndim) if self.starts_alike else [1] * values.ndim
            store.add(name, values.repeat(repeats))

    @abstractmethod
    def start(self, spec: AvatarSpec) -> tuple[Tensor, Tensor]:
        """Coloured and monochrome coefficients of a new avatar, of all texels or of each."""

    def penalties(self, parameters: TexelParameters) -> dict[str, Tensor]:
        """Mean squared distance of the coefficients from their start."""
        distances = [own - self.store.get_buffer(f"start_{name}") for name, own in parameters.named(TRANSFER).items()]
        return {"transfer": sum(distance.square().mean() for distance in distances)}


TRANSFER = ("transfer_color", "transfer_mono")
"""Names of the coefficients, coloured and monochrome."""
