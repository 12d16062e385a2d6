"""Kinds of Goliath's captures: heads, hands and bodies, by the names of their folders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.base.errors import InputError
from pipeline.datasets.goliath_archives import PARTS

RELEASED = "it is part of the release: download it again"

VERTICES = "kinematic_tracking/registration_vertices.zip"

EVERYWHERE = {
    "camera_calibration.json": RELEASED,
    "frame_splits_list.csv": RELEASED,
    "image": "the release has one archive of images per camera there",
}
LIT = {"lights/light_pattern_per_frame.json": RELEASED, "lights/light_pattern_metadata.json": RELEASED}


@dataclass(frozen=True)
class GoliathKind:
    """Contents of captures of one kind.

    Attributes:
        word: in the folder's name.
        figure: what of the subject it is, in the native format.
        files: what has to be there, and where it comes from.
        masks: folder of the archives of masks.
        parts: True if masks number parts, False if they are of the subject as a whole.
        in_head: True if vertices are in the frame of a head, which `head_pose` places; False if in the world.
        lit: True if lights are described, and most frames lit in part; False if all is always lit.
    """

    word: str
    figure: Literal["head", "body"]
    files: dict[str, str]
    masks: str
    parts: bool
    in_head: bool
    lit: bool


HEAD = GoliathKind(
    "Head", "head", EVERYWHERE | LIT | {VERTICES: RELEASED, "head_pose/head_pose.zip": RELEASED},
    PARTS, parts=True, in_head=True, lit=True,
)  # fmt: skip
HANDS = GoliathKind(
    "Hand", "body", EVERYWHERE | LIT, "segmentation_fgbg", parts=False, in_head=False, lit=True
)  # fmt: skip
BODY = GoliathKind("Body", "body", EVERYWHERE | {VERTICES: RELEASED}, PARTS, parts=True, in_head=False, lit=False)

FPS = {"Head": 10.0, "Hand": 5.0, "ClothedBody": 10.0, "Body": 5.0}
"""Frames per second of the release by a word of the name, the first that it has. Recorded were 30, and thinned out:
numbers that go in steps count the recorded ones."""


def kind_of(root: Path) -> GoliathKind:
    """The kind of a capture, by its folder's name, as the set's loader tells it.

    Raises:
        InputError: if the name says none.
    """
    for kind in (HEAD, HANDS, BODY):
        if kind.word in root.name:
            return kind
    raise InputError(
        f"{root}: expected a folder whose name has Head, Hand or Body, by which the set says what it is, "
        f"found {root.name!r}"
    )


def shipped_fps(root: Path) -> float:
    """Frames per second of a capture, as shipped."""
    return next(fps for word, fps in FPS.items() if word in root.name)
