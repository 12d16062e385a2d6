"""Reading files of OpenCV's FileStorage: YAML, XML or JSON."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.errors import InputError

BEGINNINGS = (b"%YAML", b"<?xml")
"""Of files that FileStorage writes, but for JSON; a YAML file without the first line it does not read."""

HEAD_BYTES = 256

UNREADABLE = (cv2.error, SystemError)
"""What OpenCV raises on other files: the second where its Python binding meets an error of its parser."""


def looks_like_storage(file: Path) -> bool:
    """Tell by its first bytes whether FileStorage may have written a file."""
    if not file.is_file():
        return False
    with file.open("rb") as opened:
        return opened.read(HEAD_BYTES).lstrip(b"\xef\xbb\xbf \r\n").startswith(BEGINNINGS)


def open_storage(file: Path) -> cv2.FileStorage:
    """A file's contents.

    Raises:
        InputError: if it is none of OpenCV's.
    """
    try:
        file.read_bytes()[:1]  # OpenCV says nothing of files that are not there or may not be read.
        storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
        if storage.isOpened():
            return storage
        found = "another"
    except OSError as error:
        found = str(error)
    except UNREADABLE as error:
        found = str(error.__cause__ or error).strip().splitlines()[0]
    raise InputError(f"expected a .yml, .xml or .json of OpenCV's FileStorage, found: {found}")


def keys(storage: cv2.FileStorage) -> list[str]:
    """Names of what the file holds."""
    return list(storage.root().keys())


def values(storage: cv2.FileStorage) -> dict[str, np.ndarray | float | str | list[str]]:
    """Everything at the top of a file by its key: matrices, numbers, texts and lists of texts.

    What is none of these, or is broken, is left out.
    """
    found = {}
    for key in keys(storage):
        node = storage.getNode(key)
        try:
            if node.isInt() or node.isReal():
                found[key] = node.real()
            elif node.isString():
                found[key] = node.string()
            elif node.isSeq():
                items = [node.at(k) for k in range(node.size())]
                found[key] = [item.string() if item.isString() else f"{item.real():g}" for item in items]
            elif (matrix := node.mat()) is not None:
                found[key] = np.asarray(matrix)
        except UNREADABLE:
            continue
    return found
