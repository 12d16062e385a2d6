"""Settings of avatars that differ from the full one in what one row of the tests is about."""

VARIANTS = {
    "pbr": {"shading": "microfacet", "visibility": "traced", "indirect": "bounce"},
    "traced": {"visibility": "traced", "indirect": "bounce"},
    "ambient": {"indirect": "ambient"},
    "sh": {"shading": "harmonics"},
    "no_shadow": {"shadow": False},
    "mesh_normals": {"normals": "mesh"},
    "no_deferred": {"deferred": False},
    "degree_1": {"transfer_degree": 1},
    "sh_degree_2": {"shading": "harmonics", "transfer_degree": 2},
}
