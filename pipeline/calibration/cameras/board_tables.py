"""Tables of boards that one of several jobs found, in a share of the images."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pipeline.base.errors import InputError
from pipeline.base.files import read_table, write_table
from pipeline.calibration.cameras.board_search import BoardSearch, SearchedImage, search_images
from pipeline.calibration.cameras.boards import Board, Detection
from pipeline.calibration.cameras.declared_boards import boards_from_index, complain_of_symmetry, views_to_search
from pipeline.config.calibrate_cameras import CalibrateCameras

log = logging.getLogger("calibrate_cameras")

COLUMNS = ("image", "board", "variant", "width", "height", "markers", "corners", "x", "y")
"""Of a table: a row for each board in each image, with lists of its corners.

`image` is the place in the list of views, `variant` the one of `Board.variants` that the board is printed as."""


def places_of_share(views: Sequence[dict], share: int, shares: int) -> list[int]:
    """Places in the list of views of a share of the images: a run of them, camera by camera.

    Shares differ by one image at most. A video has the images of one camera, and is then read by few jobs.
    """
    by_camera = sorted(range(len(views)), key=lambda place: (views[place]["camera"], place))
    return by_camera[len(views) * share // shares : len(views) * (share + 1) // shares]


def search_share(
    capture: Path, calibration: Mapping[str, Any], path: Path, share: int, shares: int, settings: CalibrateCameras,
    threads: int,
) -> None:  # fmt: skip
    """Look for boards in a share of the images, and write a table of them."""
    boards, views = boards_from_index(calibration), views_to_search(calibration, settings)
    complain_of_symmetry(capture, boards, len({view["camera"] for view in views}))
    searched = search_images(capture, views, places_of_share(views, share, shares), boards, threads)
    write_search(path, searched, boards)
    log.info("share %d of %d: boards looked for in %d images", share, shares, len(searched.images))


def write_search(path: Path, searched: BoardSearch, boards: Sequence[Board]) -> None:
    """Write the table of one job's search.

    Args:
        boards: as they are declared.
    """
    variants = [board.variants().index(printed) for board, printed in zip(boards, searched.boards, strict=True)]
    rows = [
        (place, b, variants[b], *image.size, detection.markers, detection.ids, *detection.pixels.T)
        for place, image in searched.images.items()
        for b, detection in enumerate(image.detections)
    ]
    write_table(path, pd.DataFrame(rows, columns=list(COLUMNS)))


def read_searches(paths: Sequence[Path], boards: Sequence[Board], images: int) -> BoardSearch:
    """Search of all images, by the tables of all jobs.

    Args:
        boards: as they are declared.
        images: number of them.

    Raises:
        InputError: if a file is no such table, or the tables are not of these images and boards, each once.
    """
    tables = []
    for path in paths:
        tables.append(table := read_table(path))
        if tuple(table.columns) != COLUMNS:
            raise InputError(f"{path}: expected columns {', '.join(COLUMNS)}, found {', '.join(table.columns)}")
    rows = sorted((row for table in tables for row in table.itertuples(index=False)), key=lambda row: row[:2])
    wanted = [(place, b) for place in range(images) for b in range(len(boards))]
    variants = sorted({(row.board, row.variant) for row in rows})
    if [row[:2] for row in rows] != wanted or len(variants) != len(boards):
        raise InputError(
            f"{paths[0].parent}: expected tables of {images} images and {len(boards)} boards, each once, found "
            f"{len(rows)} rows; make them anew, with one number of shares"
        )
    detections = [
        Detection(row.corners.astype(np.int64), np.stack([row.x, row.y], 1).astype(np.float64), row.markers)
        for row in rows
    ]
    found = {
        row.image: SearchedImage(detections[k : k + len(boards)], (row.width, row.height))
        for k, row in list(enumerate(rows))[:: len(boards)]
    }
    printed = [board.variants()[variant] for board, (_, variant) in zip(boards, variants, strict=True)]
    return BoardSearch(printed, found)
