"""Settings of training."""

from __future__ import annotations

from pydantic import Field

from pipeline.config.settings import Settings


class TrainAvatar(Settings):
    """How an avatar is trained; the loss weights are those of RFGCA 17-18 and its Appendix B where named there."""

    steps: int = Field(2000, ge=1, description="Optimisation steps [steps]")
    cameras_per_step: int = Field(2, ge=1, description="Images of one frame in each step [images]")
    checkpoint_every: int = Field(250, ge=1, description="Steps between two checkpoints [steps]")
    log_every: int = Field(50, ge=1, description="Steps between two rows of the log [steps]")

    specular: bool = Field(True, description="Build the deferred specular lobe (RFGCA 10-14)")
    shadow_width: int = Field(16, ge=1, description="Hidden channels of the shadow network, where shadow is on")
    supersample: int = Field(2, ge=1, le=4, description="Splat at this many times the image resolution, then average")
    dilation_px2: float = Field(0.1, ge=0, description="Variance added to each projected Gaussian [splatted pixel^2]")

    learning_rate_texture: float = Field(1e-2, gt=0, description="Adam's rate of albedo, roughness, opacity")
    learning_rate_transfer: float = Field(4e-3, gt=0, description="Adam's rate of the zonal transfer coefficients")
    learning_rate_shape: float = Field(3e-3, gt=0, description="Adam's rate of log scales, rotations and normals")
    learning_rate_offset: float = Field(1e-4, gt=0, description="Adam's rate of the Gaussians' offsets [m]")
    learning_rate_network: float = Field(1e-3, gt=0, description="Adam's rate of the shadow network")
    final_rate: float = Field(0.05, gt=0, le=1, description="Rates fall exponentially to this share of their start")

    weight_mask: float = Field(0.1, ge=0, description="Weight of the L1 between alpha and mask (lambda_mask)")
    weight_offset: float = Field(0.05, ge=0, description="Weight of the squared offset, in texel sizes (lambda_offset)")
    weight_scale: float = Field(0.01, ge=0, description="Weight of the bounds on scales and roughness (lambda_bound)")
    weight_normal: float = Field(0.05, ge=0, description="Weight of the squared normal offset")
    weight_negative: float = Field(0.01, ge=0, description="Weight of negative colour and negative albedo, squared")
    weight_transfer: float = Field(30.0, ge=0, description="Weight that keeps the transfer near the Lambertian lobe")
