"""Choices that variants of an avatar differ in."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

from pipeline.config.trained_model import (
    ANALYTIC,
    Anchors,
    CodeStart,
    DepthSource,
    EyeParameters,
    Fresnel,
    Geometry,
    HarmonicsFrame,
    Highlight,
    Kind,
    LastLayers,
    Lids,
    Matte,
    ScreenMaps,
    ShadowInput,
    TexelFrame,
    TransferStart,
)

GivenGeometry = Literal["", "texels", "decoded"]


@dataclass(frozen=True)
class AvatarSpec:
    """Choices of one avatar, stored beside its parameters.

    Attributes:
        specular: the specular lobe, or the gloss of the microfacets.
        shadow: shadows, in the way that `visibility` says.
        supersample, dilation_px2, compensate_opacity, pixel_filter, filter_std_px: belong to the avatar because it was
            fitted through them.
        avatar: "body" (RFGCA), or "head" (RGCA): parameters follow a latent code of vertices and mean texture.
        shading: "transfer": zonal transfer, turned with each Gaussian, and a spherical Gaussian (RFGCA 7-14);
            "harmonics": spherical harmonics that are not turned, and the same lobe (RGCA 5); "microfacet": Lambert and
            GGX; "subsurface": these, and light that entered the surface elsewhere; "combined": Lambert, GGX and zonal
            transfer of what they leave over; "linear": a head's network that is linear in the light (row "Linear" of
            RGCA).
        transfer_start: where unturned harmonics start: "lambertian", or "traced" on the template at rest.
        highlight: the lobe of "transfer" and "harmonics": a spherical Gaussian of the "angle" to the mirror direction
            (RGCA 6), of twice the "half" vector's angle to the normal, or of the cosine; or, for a head, "harmonics"
            that the view decoder gives (row "EyeNeRF" of RGCA).
        visibility: "learned": one factor per texel from the shadow network (RFGCA 15-16); "traced": every pair of
            texel and light.
        indirect: light from other surfaces: "none"; "ambient": a learned share of all light sent to the texel;
            "bounce": traced to the texels it comes from.
        transfer_degree: highest degree of the transfer, zonal or not; above 3 it is monochrome.
        fresnel: how a lobe about the mirror direction, or of eyes, grows towards grazing views.
        screen_maps: roughness and shadow of a pixel, divided by alpha or "accumulated" (RFGCA 11, 16).
        cull_backs: Gaussians whose surface faces away from the camera are left out.
        texel_frame: what a head keeps offsets, rotations and normals' offsets in: the "tangent" frame, or the "head"'s.
        code_start: where a head's encoder and vertex decoder start: "components" of the vertices, or "random".
        gaze_features: a head's decoders see where the eyes look (RGCA 3, 9).
        eye_parameters: of eyes: one value per "texels", or "decoded" for gaze, head and view (RGCA 10).
        lids: what they hide from eyes: "traced", or "learned" by the eyes' decoders.
        geometry: "gaussians" on all texels, or "volumes", boxes of voxels on patches of them (Lombardi et al. 2021).
        box_voxels, ray_step_m: of these, voxels along each side of a box, and the way between samples of a ray.
        eye_channels: of the map between each two layers of those; n of them end at 8 * 2^n texels a side.
        shadow_input: what the shadow network reads: the "cosine" visibility, too, or the "irradiance" alone.
        shadow_levels: times that the shadow network halves its map.
        near_field: lights at their distance; if not, one direction and strength each for all texels of a frame.
        deferred: the lobe is evaluated per pixel (RFGCA 11-12), not per Gaussian.
        depth: how far away a pixel's point is; see `pipeline.avatar.geometry.pixel_depth`.
        normals: "learned": bent away from the Gaussian's axis (RFGCA 10), "viewed": and by each camera differently
            (RGCA 9), or those of the "mesh".
        anchors: what a head's Gaussians sit on: "decoded" vertices (RGCA 4), those "tracked", or the template moved as
            a "rigid" whole.
        parameters: "texels": one value per texel, whatever the pose; "decoded": and what networks add to it for a pose
            and, to the specular visibility, for a view (RFGCA 3, 4, 14).
        articulation: the subject's limbs move: a code of the body's pose.
        eyes: Gaussians of eyes lie on two spheres per eye that turn with the gaze (RGCA section 3.4).
        face: middle and radius of the face on the template at rest, metres: a code of its own; none if empty.
        face_code: without it, "labelled": the template's labels say where the face is; "off": it has no code.
        pose_points, code_size: points of the surface behind a code, and its numbers.
        decoder_channels: of the map that each layer of a decoder reads; n layers end at 8 * 2^n texels a side.
        given_geometry: where the Gaussians are and how opaque was learned by another avatar and stays: one value per
            "texels", or "decoded" from the pose; "": it is this avatar's own.
        harmonics_frame: frame of a highlight's harmonics: each texel's "tangent" frame, or the "head"'s.
        last_layers: of decoders, weight-"normalised" as the others, or "plain"; they start at zero.
        matte: what is not gloss, beside GGX: as "lambert" has it, or "coated", so that grazing light passes less.
        start_ggx_width: width of the gloss of GGX that training starts from.
        gloss_regions, transport_regions, shadow_regions: regions of the template that have GGX, light below the
            surface, and traced visibility and bounces; all if empty.
    """

    specular: bool
    shadow: bool
    shadow_width: int
    supersample: int
    dilation_px2: float
    pixel_filter: Literal["box", "gaussian"] = "box"
    filter_std_px: float = 0.6
    avatar: Kind = "body"
    shading: Literal["transfer", "harmonics", "microfacet", "subsurface", "combined", "linear"] = "transfer"
    transfer_start: TransferStart = "lambertian"
    highlight: Highlight = "angular"
    visibility: Literal["learned", "traced"] = "learned"
    indirect: Literal["none", "ambient", "bounce"] = "none"
    deferred: bool = True
    depth: DepthSource = "traced"
    compensate_opacity: bool = False
    normals: Literal["viewed", "learned", "mesh"] = "learned"
    anchors: Anchors = "decoded"
    parameters: Literal["texels", "decoded"] = "texels"
    articulation: bool = False
    eyes: bool = False
    face: tuple[float, ...] = ()
    face_code: Literal["labelled", "off"] = "labelled"
    pose_points: int = 64
    code_size: int = 16
    decoder_channels: tuple[int, ...] = (16, 8)
    near_field: bool = True
    transfer_degree: int = 8
    fresnel: Fresnel = "schlick"
    screen_maps: ScreenMaps = "normalised"
    cull_backs: bool = True
    texel_frame: TexelFrame = "tangent"
    code_start: CodeStart = "components"
    gaze_features: bool = False
    eye_parameters: EyeParameters = "texels"
    lids: Lids = "traced"
    eye_channels: tuple[int, ...] = (16, 8)
    shadow_input: ShadowInput = "cosine"
    shadow_levels: int = 0
    geometry: Geometry = "gaussians"
    box_voxels: int = 8
    ray_step_m: float = 2e-3
    given_geometry: GivenGeometry = ""
    harmonics_frame: HarmonicsFrame = "head"
    last_layers: LastLayers = "normalised"
    matte: Matte = "lambert"
    start_ggx_width: float = 0.4
    gloss_regions: tuple[str, ...] = ()
    transport_regions: tuple[str, ...] = ()
    shadow_regions: tuple[str, ...] = ()

    @property
    def degrees(self) -> int:
        """Number of degrees of the transfer, 0 to `transfer_degree`.

        Beside a network that is linear in the light, none that are monochrome.
        """
        return 1 + (min(self.transfer_degree, 3) if self.shading == "linear" else self.transfer_degree)

    @property
    def analytic(self) -> bool:
        """Lambert and GGX are built."""
        return self.shading in ANALYTIC

    @property
    def coated(self) -> bool:
        """Matte light passes a coat: what shines has one."""
        return self.analytic and self.specular and self.matte == "coated"

    @property
    def head(self) -> bool:
        """A latent code drives the avatar."""
        return self.avatar == "head"

    @property
    def primitives(self) -> str:
        """Name of the primitives that stand on texels."""
        if self.volumes:
            return "volumes"
        return "gaussians_in_head" if self.texel_frame == "head" else "gaussians"

    @property
    def volumes(self) -> bool:
        """Boxes of voxels stand in the place of Gaussians."""
        return self.geometry == "volumes"

    @property
    def culls(self) -> bool:
        """Gaussians that face away are left out; boxes hide them by themselves."""
        return self.cull_backs and not self.volumes

    @property
    def lobe(self) -> bool:
        """The specular lobe of the papers is built."""
        return self.specular and self.shading in ("transfer", "harmonics") and self.highlight != "harmonics"

    @property
    def specular_model(self) -> str:
        """Name of the model of light that depends on the view."""
        if self.shading == "linear":
            return "linear"
        if not self.specular or (self.highlight == "harmonics" and self.shading == "transfer"):
            return "none"
        if self.highlight == "harmonics" and self.harmonics_frame == "tangent" and not self.analytic:
            return "tangent_harmonics"
        return "ggx" if self.analytic else self.highlight

    @property
    def shadow_model(self) -> str:
        """Name of the model of shadows."""
        return self.visibility if self.shadow else "none"

    @property
    def normal_model(self) -> str:
        """Name of the model of normals: learned only where something is shaded with them."""
        if self.normals == "mesh" or not (self.lobe or self.analytic):
            return "mesh"
        return self.texel_frame if self.head else "gaussian"

    @property
    def shadow_net(self) -> bool:
        """Shadows are predicted, from traced irradiance maps."""
        return self.shadow_model == "learned"

    @property
    def traced(self) -> bool:
        """Shadows are traced."""
        return self.shadow_model == "traced"

    @property
    def viewed_harmonics(self) -> bool:
        """Each camera has harmonics of its own for what is specular."""
        return self.specular_model == "harmonics"

    @property
    def viewed_normals(self) -> bool:
        """Each camera bends the normals in its own way."""
        return self.normals == "viewed" and self.lobe

    @property
    def pixel_depth(self) -> DepthSource | None:
        """Source of the depth of pixels, if anything asks for it."""
        return self.depth if self.lobe and self.deferred else None

    @property
    def pose_decoder(self) -> bool:
        """Poses change parameters: only where something about them is known to change."""
        return self.parameters == "decoded" and not self.head and (self.articulation or bool(self.face))

    @property
    def view_decoder(self) -> bool:
        """Each camera of a body sees the specular visibility differently."""
        return self.parameters == "decoded" and self.lobe

    @property
    def reads_eyes(self) -> bool:
        """Something of it asks for fitted eyes."""
        return self.eyes or self.gaze_features

    @property
    def decoded(self) -> bool:
        """Any network of pose, expression or view is built."""
        return self.head or self.pose_decoder or self.view_decoder or self.given_geometry == "decoded"

    def as_json(self) -> dict:
        """The fields by name, for config.json."""
        return asdict(self)

    @classmethod
    def from_json(cls, stored: dict) -> AvatarSpec:
        """Read back from a file what `as_json` gave."""
        return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()})
