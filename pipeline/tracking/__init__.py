"""Mesh tracking: from keypoints, silhouettes and images to a posed template per frame.

- Inputs: `tracking_inputs` (cameras, keypoints, masks), `keypoint_targets` (where keypoints lie on the template),
  `color_views` (images of some frames), `mask_interpolation` (silhouettes between masks), `left_right_swaps`.
- Rigged templates: `mesh_tracker` over `pose_solver` and `motion_prior`; `keyframe_refinement` and
  `photometric_refinement` fit fully lit frames to their images; `vertex_offsets` adds what a pose cannot follow.
- Unrigged templates: `surface_tracker` over `surface_solver`, `surface_model` and `deformation_basis`.
- Cues, which both share: `cues` (their protocol and rounds), `silhouette_cue`, `image_cue` with `point_colors`.
"""
