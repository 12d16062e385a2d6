"""Settings of avatars that differ from that of RFGCA in what one row of the tests is about."""

PAPER = {"shading": "transfer", "deferred": "on"}
VARIANTS = {
    "pbr": {"shading": "microfacet"},
    "combined": {"shading": "combined"},
    "subsurface": {"shading": "subsurface"},
    "traced": {**PAPER, "visibility": "traced", "indirect": "bounce"},
    "ambient": {**PAPER, "indirect": "ambient"},
    "sh": {**PAPER, "shading": "harmonics"},
    "no_shadow": {**PAPER, "shadow": False},
    "mesh_normals": {**PAPER, "normals": "mesh"},
    "no_deferred": {**PAPER, "deferred": False},
    "degree_1": {**PAPER, "transfer_degree": 1},
    "sh_degree_2": {**PAPER, "shading": "harmonics", "transfer_degree": 2},
}
