"""What of an avatar is built: the choices that its variants differ in."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, fields
from typing import Literal

from pipeline.config.train_avatar import DepthSource, TrainAvatar


@dataclass(frozen=True)
class AvatarSpec:
    """What is built; stored beside the parameters.

    Attributes:
        specular: the specular lobe, or the gloss of the microfacets.
        shadow: shadows, in the way that `visibility` says.
        supersample, dilation_px2, compensate_opacity, pixel_filter, filter_std_px: belong to the avatar because it was
            fitted through them.
        shading: "transfer": zonal transfer, turned with each Gaussian, and a spherical Gaussian (RFGCA 7-14);
            "harmonics": spherical harmonics that are not turned, and the same lobe; "microfacet": Lambert and GGX.
        visibility: "learned": one factor per texel from the shadow network (RFGCA 15-16); "traced": every pair of
            texel and light.
        indirect: light from other surfaces: "none"; "ambient": a learned share of all light sent to the texel;
            "bounce": traced to the texels it comes from.
        deferred: the lobe is evaluated per pixel (RFGCA 11-12), not per Gaussian.
        depth: how far away a pixel's point is; see `pipeline.avatar.pixel_depth`.
        normals: "learned": bent away from the Gaussian's axis (RFGCA 10), or those of the "mesh".
    """

    specular: bool
    shadow: bool
    shadow_width: int
    supersample: int
    dilation_px2: float
    pixel_filter: Literal["box", "gaussian"] = "box"
    filter_std_px: float = 0.6
    shading: Literal["transfer", "harmonics", "microfacet"] = "transfer"
    visibility: Literal["learned", "traced"] = "learned"
    indirect: Literal["none", "ambient", "bounce"] = "none"
    deferred: bool = True
    depth: DepthSource = "traced"
    compensate_opacity: bool = False
    normals: Literal["learned", "mesh"] = "learned"

    @property
    def shadow_net(self) -> bool:
        """Whether shadows are predicted."""
        return self.shadow and self.visibility == "learned"

    @property
    def traced(self) -> bool:
        """Whether shadows are traced."""
        return self.shadow and self.visibility == "traced"

    @property
    def lobe(self) -> bool:
        """Whether the specular lobe of the papers is built."""
        return self.specular and self.shading != "microfacet"

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
        return self.normals == "learned" and (self.specular or self.shading == "microfacet")

    def as_json(self) -> dict:
        """The fields by name, for config.json."""
        return asdict(self)


def spec_of(settings: TrainAvatar, planned: Collection[str]) -> AvatarSpec:
    """What the settings ask for; shadows only if the plan turned them on as well."""
    wanted = {field.name: getattr(settings, field.name) for field in fields(AvatarSpec)}
    return AvatarSpec(**{**wanted, "shadow": settings.shadow and "shadow" in planned})
