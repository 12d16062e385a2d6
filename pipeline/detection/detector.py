"""Running of a detector: MediaPipe in its own environment, or any program told the same.

    DETECTOR landmarks --images images.csv --out points.csv --parts body face hands --least 0.5
    DETECTOR masks --images images.csv --out FOLDER

images.csv has the columns image, path (PNG of 8 bits), camera, frame; points.csv is to get image, order, number, x, y,
confidence, orders being those of `pipeline.capture.keypoint_orders`; FOLDER a mask IMAGE.png of one channel each.
"""

from __future__ import annotations

import shlex
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from pipeline.base.errors import InputError
from pipeline.capture.keypoint_orders import CHOICES
from pipeline.detection import mediapipe_detector

ENVIRONMENT = Path(".venv-detect")
"""Environment that `make detect` sets up, below the project's folder."""

LAST_LINES = 8
"""Of what a detector said before it failed."""


def detector_command(given: str) -> list[str]:
    """Words that start the detector: what is given, or MediaPipe's where nothing is.

    Raises:
        InputError: if nothing is given and there is no such environment.
    """
    if given:
        return shlex.split(given)
    python = ENVIRONMENT / "bin/python"
    if not python.is_file():
        raise InputError(
            f"{python}: expected the environment with MediaPipe, found none; run `make detect`, or name another "
            "program as `detector`"
        )
    return [str(python), mediapipe_detector.__file__]


def run_detector(given: str, words: Sequence[str]) -> None:
    """Run the detector with these words.

    Raises:
        InputError: if it cannot be started or fails, with the last that it said.
    """
    command = [*detector_command(given), *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise InputError(f"detector: expected a program that can be started, found {command[0]}: {error}") from error
    if done.returncode:
        said = "\n".join((done.stderr or done.stdout).strip().splitlines()[-LAST_LINES:])
        raise InputError(f"detector: expected it to end well, found exit status {done.returncode}:\n{said}")


def read_points(path: Path) -> pd.DataFrame:
    """Points that a detector wrote: image, order, number, x, y, confidence.

    Raises:
        InputError: if the table is not there, lacks a column, has no numbers, or names an order that nobody knows.
    """
    try:
        table = pd.read_csv(path, dtype={"image": str, "order": str, "number": str})
    except (OSError, ValueError) as error:
        raise InputError(f"detector: expected a table of points, found: {error}") from error
    columns = list(mediapipe_detector.POINT_COLUMNS)
    if missing := [column for column in columns if column not in table]:
        raise InputError(f"detector: expected the columns {', '.join(columns)}, found no {', '.join(missing)}")
    if unknown := sorted(set(table["order"]) - set(CHOICES)):
        raise InputError(f"detector: order: expected one of {', '.join(CHOICES)}, found {', '.join(map(str, unknown))}")
    try:
        return table[columns].astype(dict.fromkeys(("x", "y", "confidence"), float))
    except (TypeError, ValueError) as error:
        raise InputError(f"detector: expected numbers in x, y and confidence, found: {error}") from error
