"""Settings of training."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

from pydantic import Field, model_validator

from pipeline.config.effects import Mode
from pipeline.config.settings import Settings

Edges = Literal["captured", "ignored"]
Kind = Literal["body", "head"]
Anchors = Literal["decoded", "tracked", "rigid"]
Highlight = Literal["angular", "half", "cosine", "harmonics"]
TransferStart = Literal["lambertian", "traced"]
Device = Literal["auto", "cpu", "cuda"]
ANALYTIC = ("microfacet", "combined")
"""Shadings by Lambert and GGX, with every light shadowed by itself."""

DepthSource = Literal["expected", "normalised", "median", "traced"]
Fresnel = Literal["schlick", "none"]
ScreenMaps = Literal["normalised", "accumulated"]
ShadowInput = Literal["cosine", "irradiance"]
CodeStart = Literal["components", "random"]
TexelFrame = Literal["tangent", "head"]
Bound = Literal["log", "paper"]
EyeParameters = Literal["texels", "decoded"]
Geometry = Literal["gaussians", "volumes"]
Lids = Literal["traced", "learned"]
LossSpace = Literal["srgb", "linear"]
LossMean = Literal["subject", "picture"]


class TrainAvatar(Settings):
    """Training of an avatar.

    Loss weights are those of RFGCA 17-18 and its Appendix B, or RGCA 11-15 where named.
    """

    steps: int = Field(1500, ge=1, description="Optimisation steps [steps]")
    cameras_per_step: int = Field(2, ge=1, description="Images of each frame in a step [images]")
    frames_per_step: int = Field(
        1, ge=1, description="Frames whose gradients are averaged in each step, each with its cameras_per_step [frames]"
    )
    steps_together: int = Field(
        2,
        ge=1,
        description="Steps whose gradients are taken at the same parameters, then applied one after the other; so many "
        "processes can work side by side [steps]",
    )
    checkpoint_every: int = Field(250, ge=1, description="Steps between two checkpoints [steps]")
    log_every: int = Field(50, ge=1, description="Steps between two rows of the log [steps]")
    preview_every: int = Field(
        500,
        ge=0,
        description="Steps between two preview images, or more, so that they stay few; 0: none [steps]",
    )
    device: Device = Field("auto", description="Where to train; auto: on a GPU if there is one for each process")

    cameras: int = Field(0, ge=0, description="Train on so many cameras, spread over the stage; 0: on all [cameras]")
    light_share: float = Field(
        1.0, gt=0, le=1, description="Train on this share of the partially lit patterns, and on all fully lit frames"
    )

    refine_lights: bool = Field(
        True,
        description="Refine the calibrated brightness of the lights on training images while training, where it helps "
        "on images that had no part in finding it",
    )
    light_gain_sigma: float = Field(0.1, gt=0, description="Typical relative error of a light's calibrated brightness")
    refine_light_places: bool = Field(
        False,
        description="Refine the lights' calibrated places, where it takes half a percent off the squared errors of "
        "images that had no part in finding it",
    )
    light_place_sigma_m: float = Field(
        3e-3, gt=0, description="Typical error of a light's calibrated place along each axis [m]"
    )
    refine_cameras: bool = Field(
        False,
        description="Refine the calibrated poses of the cameras of training images, on the same condition",
    )
    camera_turn_sigma: float = Field(
        3e-4, gt=0, description="Typical error of a camera's calibrated orientation about each axis [rad]"
    )
    camera_shift_sigma_m: float = Field(
        5e-4, gt=0, description="Typical error of a camera's calibrated place along each axis [m]"
    )
    avatar: Literal["auto", "body", "head"] = Field(
        "auto",
        description="body (RFGCA): texels turn with the limbs; head (RGCA): a latent code of vertices and mean texture "
        "changes all texels, light is unturned SH of the head's frame; auto: what the capture is of",
    )
    geometry: Geometry = Field(
        "gaussians",
        description="What is drawn: a Gaussian on each texel, or, for heads, boxes of voxels on patches of texels "
        "(MVP, rows F, G and H of RGCA), which have no explicit eyes",
    )
    geometry_from: str = Field(
        "",
        description="Bodies: another variant of the subject, whose Gaussians' places, sizes, turns and opacities this "
        "one takes and does not change; empty: it learns its own",
    )
    box_voxels: int = Field(8, ge=2, le=32, description="Volumes: voxels along each side of a box [voxels]")
    ray_step_m: float = Field(2e-3, gt=0, description="Volumes: way between two samples of a ray [m]")
    shading: Literal["auto", "transfer", "harmonics", "microfacet", "combined", "linear"] = Field(
        "auto",
        description="Zonal transfer and a specular lobe (RFGCA 7-14), the same with unturned SH (RGCA 5), Lambert and "
        "GGX, these and zonal transfer of what they leave over (combined), or, for heads, a network that is linear in "
        "the light; auto: microfacet, or where learned_transport is planned combined, for heads harmonics",
    )
    transfer_start: TransferStart = Field(
        "lambertian",
        description="Unturned SH start at, and are held near, the Lambertian lobe, or that lobe without the directions "
        "that the template at rest hides",
    )
    highlight: Literal["auto", "angular", "half", "cosine", "harmonics"] = Field(
        "auto",
        description="The lobe: a spherical Gaussian of the angle to the mirror direction (RGCA 6), of twice the half "
        "vector's angle to the normal, of the cosine, or, for heads, SH that the view decoder gives (EyeNeRF); auto: "
        "half for heads, angular for bodies, which environment maps can light through prefiltered panoramas then",
    )
    fresnel: Fresnel = Field(
        "schlick",
        description="How a lobe about the mirror direction, or of eyes, grows towards grazing views: as on glass, or "
        "not, so that the visibility has to learn it (RFGCA 12, RGCA 8)",
    )
    specular: Mode = Field("auto", description="The specular lobe (RFGCA 10-14), or GGX")
    shadow: Mode = Field("auto", description="Shadows cast by distant parts of the subject (RFGCA 15-16)")
    near_field: Mode = Field("auto", description="Lights at their distance; off: one direction per light and frame")
    articulation: Mode = Field("auto", description="Transfer that turns with the limbs; off: SH in the root's frame")
    deferred: Mode = Field("auto", description="Evaluate the lobe per pixel (RFGCA 11-12), not per Gaussian")
    eyes: Mode = Field(
        "auto",
        description="Eyes as two spheres each that turn with the gaze (RGCA section 3.4), as fit_eyes finds them",
    )
    eye_parameters: EyeParameters = Field(
        "texels",
        description="Parameters of eyes: a value per texel, and an albedo by view; or what decoders add for gaze, pose "
        "of the head, and view (RGCA 10)",
    )
    lids: Lids = Field(
        "traced", description="What lids hide from eyes: traced past the skin, or left to the eyes' decoders (RGCA 10)"
    )
    eye_channels: tuple[int, ...] = Field(
        (16, 8),
        min_length=1,
        description="Channels between the layers of an eye's decoders; n of them decode 8 * 2^n texels a side",
    )
    depth: DepthSource = Field(
        "traced",
        description="How far a pixel's point is that the lobe is evaluated at: splatted depth as it is, divided by "
        "alpha, the depth that half of the light gets past, or the depth of the posed mesh",
    )
    screen_maps: ScreenMaps = Field(
        "normalised",
        description="Roughness and shadow of a pixel: divided by its alpha, or as blending accumulates them (RFGCA 11, "
        "16)",
    )
    cull_backs: bool = Field(
        True, description="Leave out Gaussians whose surface faces away from the camera; the papers blend them, too"
    )
    transfer_degree: int = Field(
        8, ge=1, le=8, description="Highest degree of the transfer (RFGCA 7-9, RGCA 5); above 3 it is monochrome"
    )
    normals: Literal["auto", "viewed", "learned", "mesh"] = Field(
        "auto",
        description="Normals for shading: seen differently by each camera (RGCA 9, heads alone), learned (RFGCA 10) or "
        "mesh; auto: viewed for heads, else learned",
    )
    anchors: Anchors = Field(
        "decoded",
        description="Heads: what the Gaussians sit on: vertices decoded from the code (RGCA 4), those tracked, or the "
        "template at rest, moved rigidly",
    )
    texel_frame: TexelFrame = Field(
        "tangent",
        description="Heads: the frame that offsets, rotations and normals' offsets are kept in: the surface's, or the "
        "head's (RGCA 3, 9)",
    )
    code_start: CodeStart = Field(
        "components",
        description="Heads: where encoder and decoder of the vertices start: at their principal components, or as any "
        "network (RGCA 3, 4)",
    )
    gaze_features: bool = Field(
        False,
        description="Heads: features of each eye's gaze at its place in the decoders' maps (RGCA 3, 9, supplement A)",
    )
    visibility: Literal["auto", "learned", "traced"] = Field(
        "auto",
        description="Where shadow is on: a factor per texel from a network (RFGCA 15-16), or traced per light; auto: "
        "traced for microfacet, else learned",
    )
    indirect: Literal["auto", "none", "ambient", "bounce"] = Field(
        "auto",
        description="Light from other surfaces: a learned share of all light sent, or traced one bounce back; auto: "
        "bounce for microfacet with shadows, else none",
    )
    parameters: Literal["texels", "decoded"] = Field(
        "texels",
        description="One value per texel for all poses, or what networks add to it for a pose and a view (RFGCA 3-14)",
    )
    face: tuple[float, ...] = Field(
        (),
        description="For networks: x y z and radius of the face on the template at rest; none: no code for it [m]",
    )
    face_code: Literal["labelled", "off"] = Field(
        "off",
        description="For networks: a code for what the template labels as face, or else for what the joint of its "
        "keypoint head moves most; off: only for `face`, if that is given",
    )
    pose_points: int = Field(64, ge=4, description="Points of the surface that the networks know a pose by [points]")
    code_size: int = Field(16, ge=1, description="Numbers that a pose is encoded to")
    decoder_channels: tuple[int, ...] = Field(
        (16, 8),
        min_length=1,
        description="Channels that each layer of a decoder reads; n layers decode 8 * 2^n texels a side",
    )
    shadow_width: int = Field(16, ge=1, description="Hidden channels of the shadow network, where shadow is on")
    shadow_input: ShadowInput = Field(
        "cosine",
        description="What the shadow network reads: the cosine visibility, at which it starts, and the irradiance; or "
        "the irradiance alone (RFGCA 15-16)",
    )
    shadow_levels: int = Field(
        0,
        ge=0,
        description="Times that the shadow network halves its map: it sees 7 texels a side at 0, and about twice as "
        "far with each",
    )
    supersample: int = Field(2, ge=1, le=4, description="Splat at this many times the image resolution, then average")
    pixel_filter: Literal["box", "gaussian"] = Field(
        "gaussian", description="How splatted samples are averaged to a pixel"
    )
    filter_std_px: float = Field(0.5, gt=0, description="Standard deviation of the Gaussian pixel filter [pixel]")
    dilation_px2: float = Field(0.03, ge=0, description="Variance added to each projected Gaussian [splatted pixel^2]")
    compensate_opacity: bool = Field(
        False,
        description="Lower opacities so that the dilation spreads Gaussians without adding to them: 2.5 dB better "
        "without supersampling at 0.3 px^2, even with the defaults",
    )

    learning_rate_texture: float = Field(3e-2, gt=0, description="Adam's rate of albedo, roughness, opacity")
    learning_rate_transfer: float = Field(4e-3, gt=0, description="Adam's rate of the zonal transfer coefficients")
    learning_rate_shape: float = Field(6e-3, gt=0, description="Adam's rate of log scales, rotations and normals")
    learning_rate_offset: float = Field(3e-4, gt=0, description="Adam's rate of the Gaussians' offsets [m]")
    learning_rate_network: float = Field(1e-3, gt=0, description="Adam's rate of the shadow network")
    final_rate: float = Field(0.05, gt=0, le=1, description="Rates fall exponentially to this share of their start")

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

    def decided(self, planned: Collection[str], kind: Kind = "body") -> TrainAvatar:
        """Settings with what a plan decided in place of every `auto`.

        Whatever else they say is obeyed.

        Args:
            planned: the effects that are on.
            kind: what the capture is of.
        """
        avatar = kind if self.avatar == "auto" else self.avatar
        shading = self.shading
        if shading == "auto":
            learned = "harmonics" if avatar == "head" else "combined"
            shading = learned if "learned_transport" in planned else "microfacet"
        if avatar == "head" and shading == "transfer":
            shading = "harmonics"
        if avatar == "head" and shading not in ANALYTIC:
            planned = set(planned) - {"shadow"}  # RGCA 5: what hides a light is in the transfer
        modes: dict[str, object] = {
            name: "on" if name in planned else "off"
            for name in ("specular", "shadow", "near_field", "articulation", "deferred", "eyes")
            if getattr(self, name) == "auto"
        }
        if self.eyes == "auto" and self.geometry == "volumes":
            modes["eyes"] = "off"
        if self.normals == "auto":
            modes["normals"] = "viewed" if avatar == "head" else "learned"
        if self.highlight == "auto":
            modes["highlight"] = "half" if avatar == "head" else "angular"
        if self.visibility == "auto":
            modes["visibility"] = "traced" if shading in ANALYTIC else "learned"
        if self.indirect == "auto":
            # Where nothing is in the way of a light, nothing sends light to another part either.
            shadow = modes.get("shadow", self.shadow)
            modes["indirect"] = "bounce" if shading in ANALYTIC and shadow == "on" else "none"
        # A capture that declares no eyes has no gaze to tell.
        modes["gaze_features"] = self.gaze_features and ("eyes" in planned or self.eyes == "on")
        return self.model_copy(update=modes | {"avatar": avatar, "shading": shading})

    def reads_irradiance(self, planned: Collection[str], kind: Kind = "body") -> bool:
        """True if an avatar with these settings has a shadow network."""
        decided = self.decided(planned, kind)
        return decided.shadow == "on" and decided.visibility == "learned"

    def reads_textures(self, kind: Kind = "body") -> bool:
        """True if an avatar with these settings is encoded from mean textures."""
        return self.decided((), kind).avatar == "head"

    def reads_eyes(self, planned: Collection[str]) -> bool:
        """True if an avatar with these settings has explicit eyes, or is told where they look."""
        decided = self.decided(planned)
        return decided.eyes == "on" or decided.gaze_features

    @model_validator(mode="after")
    def _lids_are_learned_by_decoders(self) -> TrainAvatar:
        if self.lids == "learned" and self.eye_parameters != "decoded":
            raise ValueError("lids: learned: expected eye_parameters: decoded, which learn them, found texels")
        return self

    @model_validator(mode="after")
    def _volumes_stand_on_skin_in_tangent_frames(self) -> TrainAvatar:
        needed = {"eyes": "off", "texel_frame": "tangent"} if self.geometry == "volumes" else {}
        for name, value in needed.items():
            found = getattr(self, name)
            if found not in (value, "auto"):
                raise ValueError(f"geometry: volumes: expected {name}: {value}, which boxes have, found {found}")
        if self.geometry == "volumes" and self.depth == "median":
            raise ValueError(
                "geometry: volumes: expected depth: traced, normalised or expected, found median: rays have no median"
            )
        return self

    @model_validator(mode="after")
    def _gpu_knows_no_median_depth(self) -> TrainAvatar:
        lobe = self.shading in ("transfer", "harmonics") and self.highlight != "harmonics"
        per_pixel = lobe and self.specular != "off" and self.deferred != "off"
        if self.device == "cuda" and self.depth == "median" and per_pixel:
            raise ValueError("device: cuda: expected depth: traced, normalised or expected, found median")
        return self

    @model_validator(mode="after")
    def _light_in_harmonics_has_no_visibility(self) -> TrainAvatar:
        if self.shading == "harmonics" and self.visibility == "traced":
            raise ValueError("shading: harmonics: expected visibility: learned, found traced, which it cannot use")
        return self
