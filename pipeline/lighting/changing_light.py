"""Refusal of captures under constant light, whose avatars have learned no other."""

from __future__ import annotations

from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.files import read_json


def require_changing_light(index: Path | None) -> None:
    """Refuse a capture whose light never changes and is not known, before its avatar is relit.

    Args:
        index: folder of index_capture; None says nothing about the light.

    Raises:
        InputError: if capture.yaml said `constant_light`.
    """
    said = None if index is None else index / "capture.json"
    if said is None or not said.is_file() or not read_json(said).get("constant_light", False):
        return
    raise InputError(
        f"{said}: constant_light: expected a capture under lights that are known and change, found light "
        "that never changes: nothing in it tells the colour of a surface from that of its light. The avatar is scored "
        "in metrics.csv and exported (export_avatar) as it was lit"
    )
