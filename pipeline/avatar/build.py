"""Parts that an avatar is made of, by the names that a spec has for them.

A new part is one module and one line here: a class of `pipeline.avatar.appearance.models` or of
`pipeline.avatar.geometry.primitives`. A name that settings do not know yet joins their choices.
"""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.avatar.appearance.ggx_gloss import GgxGloss
from pipeline.avatar.appearance.indirect_light import AmbientLight, OneBounce
from pipeline.avatar.appearance.lambert import Lambert
from pipeline.avatar.appearance.lambert_and_subsurface import LambertAndSubsurface
from pipeline.avatar.appearance.lambert_and_transfer import LambertAndTransfer
from pipeline.avatar.appearance.light_linear import LightLinear
from pipeline.avatar.appearance.lobes import AngularLobe, CosineLobe, HalfVectorLobe
from pipeline.avatar.appearance.models import (
    DiffuseModel,
    IndirectModel,
    NormalModel,
    ShadowModel,
    SpecularModel,
)
from pipeline.avatar.appearance.normals import GaussianNormals, HeadNormals, MeshNormals, TangentNormals
from pipeline.avatar.appearance.shadows import LearnedShadow, TracedShadow
from pipeline.avatar.appearance.unturned_harmonics import UnturnedHarmonics
from pipeline.avatar.appearance.viewed_harmonics import TangentHarmonics, ViewedHarmonics
from pipeline.avatar.appearance.zonal_transfer import ZonalTransfer
from pipeline.avatar.frames.light_fields import FarField, LightField, NearField
from pipeline.avatar.geometry.gaussians_on_texels import GaussiansInHead, GaussiansOnTexels
from pipeline.avatar.geometry.primitives import Primitives
from pipeline.avatar.geometry.volumes_on_texels import VolumesOnTexels
from pipeline.avatar.spec.avatar_spec import AvatarSpec
from pipeline.avatar.texels.texel_store import TexelStore

START_ALBEDO = 0.4

PRIMITIVES: dict[str, type[Primitives]] = {
    "gaussians": GaussiansOnTexels, "gaussians_in_head": GaussiansInHead, "volumes": VolumesOnTexels
}  # fmt: skip

DIFFUSE: dict[str, type[DiffuseModel]] = {
    "transfer": ZonalTransfer, "harmonics": UnturnedHarmonics, "microfacet": Lambert,
    "subsurface": LambertAndSubsurface, "combined": LambertAndTransfer, "linear": UnturnedHarmonics
}  # fmt: skip

NORMALS: dict[str, type[NormalModel]] = {
    "mesh": MeshNormals, "gaussian": GaussianNormals, "tangent": TangentNormals, "head": HeadNormals
}  # fmt: skip

SPECULAR: dict[str, type[SpecularModel]] = {
    "none": SpecularModel, "angular": AngularLobe, "cosine": CosineLobe, "half": HalfVectorLobe,
    "harmonics": ViewedHarmonics, "ggx": GgxGloss, "tangent_harmonics": TangentHarmonics, "linear": LightLinear,
}  # fmt: skip

SHADOW: dict[str, type[ShadowModel]] = {"none": ShadowModel, "learned": LearnedShadow, "traced": TracedShadow}

INDIRECT: dict[str, type[IndirectModel]] = {"none": IndirectModel, "ambient": AmbientLight, "bounce": OneBounce}


@dataclass(frozen=True)
class Parts:
    """The parts of one avatar."""

    primitives: Primitives
    diffuse: DiffuseModel
    normals: NormalModel
    specular: SpecularModel
    shadow: ShadowModel
    indirect: IndirectModel
    field: LightField


def build_parts(store: TexelStore, spec: AvatarSpec) -> Parts:
    """Build what a spec asks for; parts add their parameters to the store in this order."""
    primitives = PRIMITIVES[spec.primitives](store, spec)
    store.add("albedo", store.fill(START_ALBEDO, 3))
    return Parts(
        primitives,
        DIFFUSE[spec.shading](store, spec),
        NORMALS[spec.normal_model](store, spec),
        SPECULAR[spec.specular_model](store, spec),
        SHADOW[spec.shadow_model](store, spec),
        INDIRECT[spec.indirect](store, spec),
        NearField() if spec.near_field else FarField(),
    )
