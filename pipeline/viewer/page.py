"""The page: the built viewer, and the avatar's numbers as blocks of text in it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from html import escape
from importlib.resources import files
from typing import Any

from pipeline.avatar.frames.inputs import BOUNCE_RAYS
from pipeline.avatar.training.checkpoint import LoadedAvatar
from pipeline.base.errors import InputError
from pipeline.geometry.texels import adjoining_texels
from pipeline.lighting.named_lights import NamedLights
from pipeline.viewer.head_poses import HeadPose, HeadSlider
from pipeline.viewer.packing import agree, block, differences_down, table_bytes, visibility_words
from pipeline.viewer.shown_frame import (
    LOG_SCALES,
    SKY_HEIGHT,
    ShownFrame,
    left_out,
    surface_matter,
    texel_anchors,
)

BUNDLE = "bundle/page.html"
"""The page without an avatar, in this package. `viewer/` has its sources and builds it."""

TITLE, DATA = "<!-- title -->", "<!-- data -->"
"""Places in the page where an avatar goes in."""

RENDERING = ("supersample", "pixel_filter", "filter_std_px", "dilation_px2", "compensate_opacity")
"""Choices of a spec that the page draws by."""

MEGA = 1e6


@dataclass(frozen=True)
class Blocks:
    """Text of one frame.

    Attributes:
        facts: its number, box, pattern and number of hits.
        texts: blocks by name.
    """

    facts: dict[str, Any]
    texts: dict[str, str]

    @property
    def megabytes(self) -> float:
        """Size of the text."""
        return sum(map(len, self.texts.values())) / MEGA


def frame_blocks(shown: ShownFrame, common: ShownFrame, stage: NamedLights, pose: str = "") -> Blocks:
    """Blocks of a frame; its shapes only if they differ from those of `common`, which all share.

    `pose` names one that no camera saw: it has no number, and the light of the frame that it was made from.
    """
    contents = {
        "place": table_bytes(shown.place),
        "seen": visibility_words(shown.visibility_bits, len(shown.place)),
        "hit_counts": shown.hit_counts.tobytes(),
        "hits": shown.hits.astype("<u4").tobytes(),
        "vertices": table_bytes(shown.vertices),
    }
    if shown is common or not agree(shown.shape, common.shape):
        contents["shape"] = table_bytes(shown.shape)
    facts = {
        "frame": None if pose else shown.frame, "label": pose or f"frame {shown.frame}",
        "low": shown.low.tolist(), "high": shown.high.tolist(), "hits": len(shown.hits),
        "pattern": stage.pattern(shown.frame),
    }  # fmt: skip
    return Blocks(facts, {name: block(content) for name, content in contents.items()})


def slider_places(sliders: Sequence[HeadSlider], first: int) -> tuple[list[HeadPose], list[dict[str, Any]]]:
    """Poses of sliders, each once, and where each slider finds its own among the page's frames.

    Args:
        sliders: of a head.
        first: place of the first pose: behind the frames of the timeline.
    """
    poses: list[HeadPose] = []
    for pose in (pose for slider in sliders for pose in slider.poses):
        if not any(pose is other for other in poses):
            poses.append(pose)
    places = {id(pose): first + k for k, pose in enumerate(poses)}
    return poses, [
        {
            "name": one.name, "places": [places[id(pose)] for pose in one.poses], "farthest": one.farthest,
            "unit": one.unit,
        }
        for one in sliders
    ]  # fmt: skip


def frames_that_fit(frames: Sequence[Blocks], others_mb: float, page_mb: float) -> int:
    """Number of frames for which the page has room, if each is as large as the largest.

    Raises:
        InputError: if there is none for one.
    """
    largest = max(frame.megabytes for frame in frames)
    count = int((page_mb - others_mb) / largest)
    if count < 1:
        raise InputError(
            f"--page-mb: expected room for one frame, {others_mb + largest:.0f} MB, found {page_mb:g}; give it more, "
            "or lower captured_cameras"
        )
    return min(count, len(frames))


def facts_of(
    subject: str, built: str, loaded: LoadedAvatar, stage: NamedLights, captured: list[dict[str, Any]]
) -> dict[str, Any]:
    """Everything that is no table, for the page's JSON."""
    spec, atlas = loaded.avatar.spec, loaded.atlas
    chosen = asdict(spec)
    lights = [
        {"name": name, "position": position.tolist(), "intensity": intensity.tolist()}
        for name, position, intensity in zip(stage.names, stage.positions, stage.intensities, strict=True)
    ]
    return {
        "subject": subject, "built": built, "left_out": left_out(spec), "gaussians": atlas.texel_count,
        "vertices": len(atlas.rest_vertices), "rendering": {name: chosen[name] for name in RENDERING},
        "log_scales": list(LOG_SCALES), "sky_height": SKY_HEIGHT,
        "shadow": spec.traced, "bounce": spec.indirect == "bounce", "bounce_rays": BOUNCE_RAYS, "lights": lights,
        "captured": captured,
    }  # fmt: skip


def common_texts(loaded: LoadedAvatar) -> dict[str, str]:
    """Blocks of all frames: matter, texels that share rays, and the mesh that casts shadows."""
    atlas = loaded.atlas
    contents = {
        "matter": table_bytes(surface_matter(loaded.avatar)), "anchors": table_bytes(texel_anchors(atlas)),
        "adjoining": differences_down(adjoining_texels(atlas)), "faces": atlas.faces.astype("<u4").tobytes(),
    }  # fmt: skip
    return {name: block(content) for name, content in contents.items()}


def page_html(facts: dict[str, Any], common: dict[str, str], frames: Sequence[Blocks]) -> str:
    """The whole page.

    Raises:
        InputError: if the viewer was not built.
    """
    try:
        empty = files("pipeline.viewer").joinpath(BUNDLE).read_text("utf-8")
    except OSError as error:
        raise InputError(f"pipeline/viewer/{BUNDLE}: expected the built viewer, found: {error}; make viewer") from error
    described = facts | {"frames": [frame.facts | {"blocks": list(frame.texts)} for frame in frames]}
    texts = dict(common)
    for place, frame in enumerate(frames):
        texts |= {f"{name}-{place}": text for name, text in frame.texts.items()}
    stored = [script("facts", "application/json", json.dumps(described, allow_nan=False).replace("<", "\\u003c"))]
    stored += [script(name, "text/plain", text) for name, text in texts.items()]
    return empty.replace(TITLE, escape(facts["subject"])).replace(DATA, "\n".join(stored))


def script(name: str, kind: str, text: str) -> str:
    """An element of text that a browser neither runs nor shows."""
    return f'<script type="{kind}" id="{name}">{text}</script>'
