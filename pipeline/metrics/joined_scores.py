"""Scores of single images, written by several jobs, joined to those of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.files import read_table

KEY = ["camera", "frame"]
"""Columns that name an image."""


def joined_scores(folder: Path, images: pd.DataFrame) -> pd.DataFrame:
    """Join the tables of a folder into one with a row for each image.

    It is what `pipeline.metrics.evaluation.evaluate` would have returned.

    Args:
        folder: of tables that `evaluate` returned for some of the images, each image in one of them.
        images: camera and frame of all, in their order, from which `index` is counted.

    Raises:
        InputError: if an image is in no table, or in two, or a table has another one.
    """
    tables = [read_table(path) for path in sorted(folder.glob("[!.]*.parquet"))]
    filled = [table for table in tables if len(table)] or tables[:1]
    if not filled:
        raise InputError(f"{folder}: expected tables of scores, found none")
    scores = pd.concat(filled, ignore_index=True)
    places = pd.MultiIndex.from_frame(images[KEY]).get_indexer(pd.MultiIndex.from_frame(scores[KEY]))
    counts = np.bincount(places[places >= 0], minlength=len(images))
    if (places < 0).any() or (counts != 1).any():
        found = f"{(counts == 1).sum()} of them, {(counts > 1).sum()} repeated and {(places < 0).sum()} of other images"
        raise InputError(
            f"{folder}: expected scores of each of {len(images)} held-out images once, found {found}; delete the "
            "folder, and run evaluate_avatar again"
        )
    places = places.astype(scores["index"].dtype)
    return scores.assign(index=places).sort_values("index", ignore_index=True)
