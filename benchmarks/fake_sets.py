"""Fakes of public sets that are measured, each with its truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.support.datasets import goliath_layout
from tests.support.datasets.turning_head import TurningHead


@dataclass(frozen=True)
class FakeSet:
    """A fake of one set.

    Attributes:
        dataset: the set, as the configuration names it.
        truth: makes the truth.
        write: writes it in the set's layout below a folder; returns the folder that `path` names.
        cameras: number of those with images.
        true_frame: the truth's frame by the imported capture's.
        world: from the truth's frame of space to the imported capture's.
    """

    dataset: str
    truth: Callable[[], TurningHead]
    write: Callable[[Path, TurningHead], Path]
    cameras: int
    true_frame: Callable[[int], int] = int
    world: Callable[[np.ndarray], np.ndarray] = np.asarray


FAKES = (
    FakeSet(
        "goliath", lambda: goliath_layout.true_head(image=(96, 144)), goliath_layout.write_goliath,
        len(goliath_layout.CAMERAS),
    ),
)  # fmt: skip
