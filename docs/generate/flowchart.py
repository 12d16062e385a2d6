"""The flowchart of the stages as SVG, drawn here so that no page loads anything from elsewhere."""

from __future__ import annotations

FLOW: dict[str, tuple[str, ...]] = {
    "synthesize_capture": (),
    "import_capture": (),
    "index_capture": ("synthesize_capture", "import_capture"),
    "calibrate_cameras": ("index_capture",),
    "calibrate_color": ("index_capture",),
    "unwrap_atlas": ("calibrate_cameras",),
    "calibrate_lights": ("calibrate_cameras",),
    "book_patterns": ("calibrate_lights",),
    "track_mesh": ("book_patterns",),
    "estimate_gaze": ("track_mesh", "unwrap_atlas"),
    "plan_effects": ("calibrate_color", "track_mesh", "unwrap_atlas", "estimate_gaze"),
    "trace_irradiance": ("track_mesh", "unwrap_atlas"),
    "fit_eyes": ("track_mesh", "unwrap_atlas", "estimate_gaze"),
    "bake_textures": ("plan_effects",),
    "pack_shards": ("plan_effects", "trace_irradiance", "bake_textures"),
    "train_avatar": ("pack_shards", "fit_eyes"),
    "evaluate_avatar": ("train_avatar",),
    "relight_avatar": ("train_avatar",),
}
"""Stage -> the stages whose output it waits for. What also follows along another path of stages that every subject has
is left out. A test of the workflow holds it against the rules."""

PLACES: dict[str, tuple[float, float]] = {
    "synthesize_capture": (0.5, 0), "import_capture": (1.5, 0), "index_capture": (1, 1),
    "calibrate_cameras": (0, 2), "calibrate_color": (2, 2),
    "calibrate_lights": (0, 3), "unwrap_atlas": (1, 3), "book_patterns": (0, 4),
    "track_mesh": (0, 5), "estimate_gaze": (1, 5.5), "plan_effects": (2, 6),
    "trace_irradiance": (0, 7), "fit_eyes": (1, 7), "bake_textures": (2, 7),
    "pack_shards": (2, 8), "train_avatar": (1, 9), "evaluate_avatar": (0.5, 10), "relight_avatar": (1.5, 10),
}  # fmt: skip
"""Column and row of each box."""

OPTIONAL = {
    "synthesize_capture", "import_capture", "estimate_gaze", "trace_irradiance", "bake_textures", "fit_eyes",
    "relight_avatar",
}  # fmt: skip
"""Stages that not every subject has: drawn with dashes."""

WIDTH, HEIGHT, ACROSS, DOWN, MARGIN = 172, 34, 204, 62, 12


def flowchart() -> str:
    """The drawing: a box per stage, an arrow from what it waits for."""
    shapes = [_arrow(before, stage) for stage, waits in FLOW.items() for before in waits]
    shapes += [_box(stage) for stage in FLOW]
    width, height = 2 * ACROSS + WIDTH + 2 * MARGIN, 10 * DOWN + HEIGHT + 2 * MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
        'font-family="sans-serif" font-size="14">\n'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#555"/></marker></defs>\n'
        f'<rect width="{width}" height="{height}" fill="#fff"/>\n' + "".join(shapes) + "</svg>\n"
    )


def _corner(stage: str) -> tuple[float, float]:
    column, row = PLACES[stage]
    return MARGIN + column * ACROSS, MARGIN + row * DOWN


def _box(stage: str) -> str:
    x, y = _corner(stage)
    dashes = ' stroke-dasharray="5 3"' if stage in OPTIONAL else ""
    return (
        f'<rect x="{x:g}" y="{y:g}" width="{WIDTH}" height="{HEIGHT}" rx="5" fill="#eef3f8" stroke="#3b6ea5"{dashes}/>'
        f'<text x="{x + WIDTH / 2:g}" y="{y + HEIGHT / 2 + 5:g}" text-anchor="middle">{stage}</text>\n'
    )


def _arrow(before: str, stage: str) -> str:
    (x0, y0), (x1, y1) = _corner(before), _corner(stage)
    start, end = (x0 + WIDTH / 2, y0 + HEIGHT), (x1 + WIDTH / 2, y1)
    turn = end[1] - (DOWN - HEIGHT) / 2
    return (
        f'<path d="M{start[0]:g} {start[1]:g} V{turn:g} H{end[0]:g} V{end[1]:g}" fill="none" stroke="#555" '
        'marker-end="url(#tip)"/>\n'
    )
