"""Words for what an avatar is built of."""

from __future__ import annotations

from pipeline.avatar.spec.avatar_spec import AvatarSpec

DIFFUSE_WORDS = {
    "transfer": "zonal transfer", "harmonics": "harmonic transfer", "microfacet": "Lambert",
    "subsurface": "Lambert with subsurface spread", "combined": "Lambert and zonal transfer",
    "linear": "a light-linear network",
}  # fmt: skip
GLOSS_WORDS = {
    "angular": "angular lobe", "half": "half-vector lobe", "cosine": "cosine lobe", "ggx": "GGX",
    "harmonics": "specular harmonics", "tangent_harmonics": "specular harmonics in tangent frames",
}  # fmt: skip
INDIRECT_WORDS = {"ambient": "ambient light", "bounce": "one bounce"}


def describe(spec: AvatarSpec) -> str:
    """Sentence that says what light is simulated, for tables."""
    where = (" per pixel" if spec.deferred else " per Gaussian") if spec.lobe else ""
    transfer = DIFFUSE_WORDS[spec.shading] + of_regions(spec.transport_regions)
    parts = [("coated " if spec.coated else "") + transfer]
    if spec.specular_model in GLOSS_WORDS:
        parts.append(GLOSS_WORDS[spec.specular_model] + of_regions(spec.gloss_regions) + where)
    if spec.shadow:
        parts.append(f"{spec.shadow_model} shadows" + of_regions(spec.shadow_regions))
    if spec.indirect in INDIRECT_WORDS:
        parts.append(INDIRECT_WORDS[spec.indirect])
    if not spec.near_field:
        parts.append("distant lights")
    if spec.volumes:
        parts.append("volumetric primitives")
    if spec.eyes:
        parts.append("explicit eyes")
    if spec.gaze_features:
        parts.append("gaze features")
    return f"{spec.avatar} with {', '.join(parts)}"


def of_regions(names: tuple[str, ...]) -> str:
    """Words for the regions that have something; none where all have it."""
    return f" ({' and '.join(names)})" if names else ""
