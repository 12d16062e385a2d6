"""Settings of the avatar that is trained: its parts, on which images, and how fast."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from pipeline.config.effects import Mode
from pipeline.config.settings import Settings

Kind = Literal["body", "head"]
Anchors = Literal["decoded", "tracked", "rigid"]
Highlight = Literal["angular", "half", "cosine", "harmonics"]
AlbedoStart = Literal["auto", "images", "grey"]
TransferStart = Literal["lambertian", "traced"]
Device = Literal["auto", "cpu", "cuda"]
ANALYTIC = ("microfacet", "subsurface", "combined")
"""Shadings by Lambert and GGX, with every light shadowed by itself."""

DepthSource = Literal["expected", "normalised", "median", "traced"]
Fresnel = Literal["schlick", "none"]
ScreenMaps = Literal["normalised", "accumulated"]
ShadowInput = Literal["cosine", "irradiance"]
HarmonicsFrame = Literal["tangent", "head"]
LastLayers = Literal["normalised", "plain"]
CodeStart = Literal["components", "random"]
TexelFrame = Literal["tangent", "head"]
EyeParameters = Literal["texels", "decoded"]
Geometry = Literal["gaussians", "volumes"]
Lids = Literal["traced", "learned"]
Matte = Literal["coated", "lambert"]


class TrainedModel(Settings):
    """Parts of an avatar, and the steps that train it."""

    steps: int = Field(2000, ge=1, description="Optimisation steps [steps]")
    seed: int = Field(
        0, ge=0, description="What a training starts from and draws in: others give avatars that are as good"
    )
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
    shading: Literal["auto", "transfer", "harmonics", "microfacet", "subsurface", "combined", "linear"] = Field(
        "auto",
        description="Zonal transfer and a specular lobe (RFGCA 7-14), the same with unturned SH (RGCA 5), Lambert and "
        "GGX, these and light that spreads below the surface, these and zonal transfer of what they leave over "
        "(combined), or, for heads, a network that is linear in the light; auto: microfacet, or subsurface where "
        "learned_transport is planned",
    )
    albedo_start: AlbedoStart = Field(
        "auto",
        description="Albedo starts as training images show it, or as the same grey everywhere; auto: grey but with "
        "Lambert and GGX alone, as elsewhere colours do not tell it from other light",
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
    harmonics_frame: HarmonicsFrame = Field(
        "head",
        description="SH of a highlight: in the head's frame, from the view decoder's maps (RGCA's baseline), or in "
        "each texel's tangent frame, from tables that texels share",
    )
    fresnel: Fresnel = Field(
        "schlick",
        description="How a lobe about the mirror direction, or of eyes, grows towards grazing views: as on glass, or "
        "not, so that the visibility has to learn it (RFGCA 12, RGCA 8)",
    )
    matte: Matte = Field(
        "coated",
        description="Beside GGX: light that grazes the surface as it comes or goes passes its coat less, by a share "
        "that is learned, one for the subject (Kelemen and Szirmay-Kalos 2001); or Lambert's law alone",
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
        "labelled",
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
    last_layers: LastLayers = Field(
        "normalised",
        description="Last layers of decoders, which start at zero: weight-normalised as the others (RGCA supplement "
        "A), so that at first only lengths have a slope, or plain weights",
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
    supersample: int = Field(3, ge=1, le=4, description="Splat at this many times the image resolution, then average")
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
    cooldown: float = Field(
        0.2,
        ge=0,
        lt=1,
        description="Share of the steps, the last ones, in which rates go down to nothing besides, in a straight line",
    )
