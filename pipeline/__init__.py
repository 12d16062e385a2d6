"""Raw light-stage capture to relightable avatar, one file-to-file stage per module.

Stages, in data order: synthesize_capture, index_capture, calibrate_cameras, calibrate_color, calibrate_lights,
book_patterns, track_mesh, unwrap_atlas, plan_effects, fit_eyes, trace_irradiance, pack_shards, train_avatar,
evaluate_avatar.
Below them lies the library; imports point down only:
base <- config, geometry, metrics <- capture, lighting <- rendering <- avatar <- stages.
"""
