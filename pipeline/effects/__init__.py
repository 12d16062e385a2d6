"""Evidence for the effects that a capture calls for, from its own images and geometry.

- `scene_evidence` over `light_evidence`: geometry, lights, lenses and colours, without images of the subject.
- `appearance_evidence` over `appearance_fits` over `shared_fits`: gloss, deferred shading and transport, from some
  training images; `seen_texels` looks texels up in images, `texel_light` is the light on them, `appearance_columns`
  what they would show.
- `effect_costs`: what an effect costs where it is simulated.
- `mean_textures`: average colours of texels in fully lit frames.
"""
