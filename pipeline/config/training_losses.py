"""Settings of what training minimises."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.settings import Settings

Edges = Literal["captured", "ignored"]
Bound = Literal["log", "paper"]
LossSpace = Literal["srgb", "linear"]
LossMean = Literal["subject", "picture"]


class TrainingLosses(Settings):
    """Losses of training.

    Weights are those of RFGCA 17-18 and its Appendix B, or RGCA 11-15 where named.
    """

    edges: Edges = Field(
        "captured",
        description="Pixels just outside the mask: as captured (the background is dark) or ignored (it is not)",
    )
    loss_space: LossSpace = Field("srgb", description="What pictures are compared as: sRGB, or linear light")
    loss_mean: LossMean = Field(
        "subject", description="Errors of a picture are divided by the subject's pixels, or by all of the crop's"
    )
    bound: Bound = Field(
        "log",
        description="Bounds on scales and roughness: squared logarithms of what is beyond, or as printed (RFGCA B.2 in "
        "metres; heads RGCA 14 and 16 in millimetres)",
    )
    offset_unit: Literal["texel", "metre"] = Field("texel", description="What weight_offset takes offsets in")
    weight_photometric: float = Field(1.0, ge=0, description="Weight of the L1 between pictures (lambda_l1)")
    weight_ssim: float = Field(0.0, ge=0, description="Weight of D-SSIM, (1 - SSIM) / 2, of pictures (lambda_ssim)")
    weight_geometry: float = Field(
        1.0, ge=0, description="Heads: weight of squared errors of decoded vertices, per variance (lambda_geo)"
    )
    weight_kl: float = Field(
        2e-4, ge=0, description="Heads: weight of the latent code's divergence from a standard normal (lambda_kl)"
    )
    weight_mask: float = Field(0.01, ge=0, description="Weight of the L1 between alpha and mask (lambda_mask)")
    weight_offset: float = Field(0.05, ge=0, description="Weight of squared offsets, see offset_unit (lambda_offset)")
    weight_scale: float = Field(0.01, ge=0, description="Weight of the bounds on scales (lambda_bound, lambda_s)")
    weight_roughness: float | None = Field(
        None, ge=0, description="Weight of the bounds on roughness; null: as weight_scale (RGCA has none)"
    )
    weight_normal: float = Field(0.05, ge=0, description="Weight of the squared normal offset (lambda_normal)")
    normal_steps: int = Field(
        0, ge=0, description="Steps over which weight_normal falls to zero; 0: it stays as it is [steps]"
    )
    weight_normal_orient: float = Field(
        0.0, ge=0, description="Weight of blended normals that face away from the camera (lambda_normal_orient)"
    )
    weight_volume: float = Field(
        0.01,
        ge=0,
        description="Volumes: weight of the boxes' half sizes, multiplied and summed, in quarters of a metre",
    )
    weight_size: float = Field(0.0, ge=0, description="Weight of the L1 of Gaussian scales (L_scale) [1/m]")
    weight_alpha_sparsity: float = Field(
        0.0, ge=0, description="Weight of the L1 between alpha and the nearer of 0 and 1 (lambda_alpha_sparsity)"
    )
    weight_albedo: float = Field(0.0, ge=0, description="Weight of the L1 of the albedo (lambda_albedo)")
    weight_lpips: float = Field(0.1, ge=0, description="Weight of LPIPS, if its backbone is given (lambda_LPIPS)")
    lpips_net: Literal["alex", "vgg"] = Field("vgg", description="LPIPS backbone for training")
    lpips_backbone: str = Field(
        "",
        description="File with the backbone's ImageNet weights, as for evaluate_avatar; empty: no LPIPS in the loss; "
        "download: fetched",
    )
    weight_st_lpips: float = Field(
        0.0, ge=0, description="Weight of shift-tolerant LPIPS (Ghildyal and Liu 2022); needs no file"
    )
    weight_eye_scale: float = Field(
        0.01,
        ge=0,
        description="Weight of scales of eye Gaussians that are larger than needed, squared (lambda_es) [1/mm^2]",
    )
    weight_eye_opacity: float = Field(
        1e-4, ge=0, description="Weight of transparency of eye Gaussians, squared (lambda_eo)"
    )
    weight_eye_visibility: float = Field(
        1e-4, ge=0, description="Weight of what eyes lack of a specular visibility of 1, squared (lambda_ev)"
    )
    weight_gloss: float = Field(0.01, ge=0, description="Weight that keeps the gloss of GGX near a dielectric's")
    weight_negative: float = Field(
        10.0,
        ge=0,
        description="Weight of negative colour and negative albedo, squared (lambda_c-): there is no such light",
    )
    weight_negative_albedo: float | None = Field(
        None, ge=0, description="Of these, the weight of negative albedo; null: as weight_negative (RGCA has none)"
    )
    weight_smooth: float = Field(
        0.6,
        ge=0,
        description="Weight of the total variation of albedo, normals and gloss over the atlas, divided by the number "
        "of training images: texels are finer than pixels, and few images do not tell all of them",
    )
    weight_transfer: float = Field(30.0, ge=0, description="Weight that keeps the transfer near the Lambertian lobe")
    weight_leftover: float = Field(
        0.1, ge=0, description="For combined: weight that keeps the transfer beside Lambert near nothing"
    )
