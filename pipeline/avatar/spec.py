"""What of an avatar is built: the choices that its variants differ in."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Literal

from pipeline.base.errors import InputError
from pipeline.base.files import read_json
from pipeline.config.effects import EFFECTS
from pipeline.config.train_avatar import Anchors, DepthSource, Highlight, Kind, TrainAvatar, TransferStart


@dataclass(frozen=True)
class AvatarSpec:
    """What is built; stored beside the parameters.

    Attributes:
        specular: the specular lobe, or the gloss of the microfacets.
        shadow: shadows, in the way that `visibility` says.
        supersample, dilation_px2, compensate_opacity, pixel_filter, filter_std_px: belong to the avatar because it was
            fitted through them.
        avatar: "body" (RFGCA), or "head" (RGCA): parameters follow a latent code of vertices and mean texture.
        shading: "transfer": zonal transfer, turned with each Gaussian, and a spherical Gaussian (RFGCA 7-14);
            "harmonics": spherical harmonics that are not turned, and the same lobe (RGCA 5); "microfacet": Lambert and
            GGX; "linear": a head's network that is linear in the light (row "Linear" of RGCA).
        transfer_start: where unturned harmonics start: "lambertian", or "traced" on the template at rest.
        highlight: the lobe of "transfer" and "harmonics": a spherical Gaussian of the "angle" to the mirror direction
            (RGCA 6), of twice the "half" vector's angle to the normal, or of the cosine; or, for a head, "harmonics"
            that the view decoder gives (row "EyeNeRF" of RGCA).
        visibility: "learned": one factor per texel from the shadow network (RFGCA 15-16); "traced": every pair of
            texel and light.
        indirect: light from other surfaces: "none"; "ambient": a learned share of all light sent to the texel;
            "bounce": traced to the texels it comes from.
        transfer_degree: highest degree of the transfer, zonal or not; above 3 it is monochrome.
        near_field: lights at their distance; if not, one direction and strength each for all texels of a frame.
        deferred: the lobe is evaluated per pixel (RFGCA 11-12), not per Gaussian.
        depth: how far away a pixel's point is; see `pipeline.avatar.pixel_depth`.
        normals: "learned": bent away from the Gaussian's axis (RFGCA 10), "viewed": and by each camera differently
            (RGCA 9), or those of the "mesh".
        anchors: what a head's Gaussians sit on: "decoded" vertices (RGCA 4), those "tracked", or the template moved as
            a "rigid" whole.
        parameters: "texels": one value per texel, whatever the pose; "decoded": and what networks add to it for a pose
            and, to the specular visibility, for a view (RFGCA 3, 4, 14).
        articulation: the subject's limbs move: a code of the body's pose.
        eyes: Gaussians of eyes lie on two spheres per eye that turn with the gaze (RGCA section 3.4).
        face: middle and radius of the face on the template at rest, metres: a code of its own; none if empty.
        pose_points, code_size: points of the surface behind a code, and its numbers.
        decoder_channels: of the map that each layer of a decoder reads; n layers end at 8 * 2^n texels a side.
    """

    specular: bool
    shadow: bool
    shadow_width: int
    supersample: int
    dilation_px2: float
    pixel_filter: Literal["box", "gaussian"] = "box"
    filter_std_px: float = 0.6
    avatar: Kind = "body"
    shading: Literal["transfer", "harmonics", "microfacet", "linear"] = "transfer"
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
    pose_points: int = 64
    code_size: int = 16
    decoder_channels: tuple[int, ...] = (16, 8)
    near_field: bool = True
    transfer_degree: int = 8

    @property
    def degrees(self) -> int:
        """How many degrees the transfer has: 0 to `transfer_degree`; beside a network that is linear in the light, none
        that are monochrome."""
        return 1 + (min(self.transfer_degree, 3) if self.shading == "linear" else self.transfer_degree)

    @property
    def shadow_net(self) -> bool:
        """Whether shadows are predicted."""
        return self.shadow and self.visibility == "learned"

    @property
    def traced(self) -> bool:
        """Whether shadows are traced."""
        return self.shadow and self.visibility == "traced"

    @property
    def head(self) -> bool:
        """Whether a latent code drives the avatar."""
        return self.avatar == "head"

    @property
    def lobe(self) -> bool:
        """Whether the specular lobe of the papers is built."""
        return self.specular and self.shading in ("transfer", "harmonics") and self.highlight != "harmonics"

    @property
    def viewed_harmonics(self) -> bool:
        """Whether each camera has harmonics of its own for what is specular."""
        return self.specular and self.shading == "harmonics" and self.highlight == "harmonics"

    @property
    def viewed_normals(self) -> bool:
        """Whether each camera bends the normals in its own way."""
        return self.normals == "viewed" and self.lobe

    @property
    def gloss(self) -> bool:
        """Whether GGX is built."""
        return self.specular and self.shading == "microfacet"

    @property
    def pixel_depth(self) -> DepthSource | None:
        """Where the depth of pixels comes from, if anything asks for it."""
        return self.depth if self.lobe and self.deferred else None

    @property
    def bent_normals(self) -> bool:
        """Whether normals are learned: only where something is shaded with them."""
        return self.normals != "mesh" and (self.lobe or self.shading == "microfacet")

    @property
    def pose_decoder(self) -> bool:
        """Whether poses change parameters: only where something about them is known to change."""
        return self.parameters == "decoded" and not self.head and (self.articulation or bool(self.face))

    @property
    def view_decoder(self) -> bool:
        """Whether each camera sees the specular visibility, or what a head has in its place, differently."""
        if self.head:
            return self.lobe or self.viewed_harmonics or self.shading == "linear"
        return self.parameters == "decoded" and self.lobe

    @property
    def decoded(self) -> bool:
        """Whether any network of pose, expression or view is built."""
        return self.head or self.pose_decoder or self.view_decoder

    def as_json(self) -> dict:
        """The fields by name, for config.json."""
        return asdict(self)

    @classmethod
    def from_json(cls, stored: dict) -> AvatarSpec:
        """What `as_json` gave, read back from a file."""
        return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in stored.items()})


def read_plan(path: Path) -> set[str]:
    """The effects that are on in effects.json.

    Raises:
        InputError: if it says nothing about some effect.
    """
    effects = read_json(path)
    missing = sorted(set(EFFECTS) - effects.keys())
    if missing:
        raise InputError(f"{path}: expected the effects of this version, found no {missing}; run plan_effects again")
    return {name for name in EFFECTS if effects[name]["on"]}


def spec_of(settings: TrainAvatar, planned: Collection[str], kind: Kind = "body") -> AvatarSpec:
    """What the settings ask for; where they say `auto`, what plan_effects turned on.

    Args:
        planned: the effects that are on in effects.json.
        kind: what the capture is of.

    Raises:
        InputError: if they ask a body for what only heads have, or a head for what it has not.
    """
    decided = settings.decided(planned, kind)
    require_parts(decided)
    chosen = {field.name: getattr(decided, field.name) for field in fields(AvatarSpec)}
    modes = ("specular", "shadow", "near_field", "articulation", "deferred", "eyes")
    spec = AvatarSpec(**chosen | {name: chosen[name] == "on" for name in modes})
    # Light in the root's frame has no place for one texel's shadows.
    turns = spec.articulation or spec.traced
    return spec if turns or spec.shading != "transfer" else replace(spec, shading="harmonics")


def require_parts(decided: TrainAvatar) -> None:
    """Raises:
    InputError: see `spec_of`.
    """
    asked = {
        "shading: linear": decided.shading == "linear",
        "highlight: harmonics": decided.highlight == "harmonics",
        "normals: viewed": decided.normals == "viewed",
    }
    if decided.avatar == "body" and any(asked.values()):
        found = ", ".join(name for name, is_asked in asked.items() if is_asked)
        raise InputError(f"train_avatar: avatar: expected head, found body, with {found}, which only heads have")
    if decided.avatar == "head" and decided.shading not in ("harmonics", "linear"):
        raise InputError(f"train_avatar: shading: expected harmonics or linear for a head, found {decided.shading}")
