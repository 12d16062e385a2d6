"""Notes of what a Goliath capture gives, what is computed, and what of it is not used."""

from __future__ import annotations

import pandas as pd

from pipeline.datasets.even_light import STANDS_FOR
from pipeline.datasets.goliath_archives import BACKGROUNDS
from pipeline.datasets.goliath_kinds import GoliathKind
from pipeline.datasets.goliath_lights import FULL_DURATION
from pipeline.datasets.imported_capture import Provenance

NOT_USED = {
    "keypoints_3d": "points in space, of no image; nothing says which each is; frames without a mesh have none",
    "scan_mesh": "other vertices in each frame",
    "uv_image": "its texture coordinates are in the set's shared assets, a pickle; textures are baked anew",
}
"""Parts of all captures, and why nothing is taken of them."""


def say_masks(provenance: Provenance, images: pd.DataFrame, folder: str, what: str) -> None:
    """Note how many images have masks; the others get the mesh's outline.

    Args:
        images: the table of images.
        folder: of the masks.
        what: of their values is the subject, after "all".
    """
    masked = int(images.mask_path.notna().sum())
    if masked:
        provenance.given["masks"] = f"{folder} of {masked} images, all {what}"
    if masked < len(images):
        outlines = f"pack_shards: outlines of the meshes, for {len(images) - masked} of {len(images)} images"
        provenance.computed["masks of images that have none"] = outlines


def say_given(provenance: Provenance, kind: GoliathKind, meshes: str, plates: bool) -> None:
    """Note what the set gave, and what is computed here.

    Args:
        provenance: gets the notes.
        kind: of the capture.
        meshes: what they are, and how they agree with the masks.
        plates: True if there are images of the empty stage.
    """
    provenance.given.update(
        {
            "images": "image/cam*.zip, 8-bit linear AVIF, in place"
            + ("; black level 2, 1, 2 of R, G, B" if kind.lit else ", without a black level, as the loader has bodies"),
            "cameras": "camera_calibration.json: K.T counted from pixel centres (half a pixel added), T.T camera from "
            "world in mm, distortion k1 k2 p1 p2",
            "meshes": meshes,
            "splits": "frame_splits_list.csv; the example cameras of the set's loader",
        }
    )
    provenance.computed["texture coordinates"] = "unwrap_atlas"
    provenance.left_out.update(NOT_USED)
    if plates:
        provenance.given["clean plates"] = f"{BACKGROUNDS}; segment_subject masks by them, if use: always asks for it"
    if kind.lit:
        _say_lit(provenance)
    else:
        provenance.computed["lights"] = f"{STANDS_FOR}; avatars are not relit"
        provenance.assumed["light"] = STANDS_FOR
        provenance.assumed["how images store light"] = "linear, as the set's programs show them, which do not say it"
        provenance.left_out["floor_transformation"] = "nothing here stands on a floor"
    turns = "the frame of the head, which turns by slerp" if kind.in_head else "that of the nearest rigid motion"
    if kind.lit:
        provenance.computed["meshes of partially lit frames"] = f"track_mesh: interpolated in {turns}"
    if kind.in_head:
        provenance.computed["mean textures"] = "bake_textures"
    else:
        provenance.computed["motion of the body"] = "track_mesh: the rigid motion nearest to the meshes'"
        provenance.left_out["pose, skeleton_scales"] = "their skeleton is in the set's shared assets, a pickle"


def _say_lit(provenance: Provenance) -> None:
    provenance.given.update(
        {
            "lights": f"lights/light_pattern_metadata.json, mm; intensity = duration / {FULL_DURATION:g}",
            "light patterns": "lights/light_pattern_per_frame.json",
            "colour": "white balance 1.4, 1.1, 1.6 of R, G, B, the same for all cameras",
        }
    )
