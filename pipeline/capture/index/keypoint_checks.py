"""Checks of a table of keypoints that is seen piece by piece."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping

import numpy as np
import pandas as pd

from pipeline.base.errors import MOST_LISTED, Complaints, listed
from pipeline.capture.index.csv_tables import complain_of_repeated, complain_unknown, repeated_keys
from pipeline.capture.keypoint_orders import read_orders
from pipeline.capture.schema.manifest import MANIFEST

KEYS = ["frame", "camera", "keypoint"]
"""Of which a table has each once."""

NUMBERS = ("x", "y", "confidence")

MOST_CONFIDENCE = 1000.0
"""Largest weight of a detection: detectors say 0 to 1, percent or a logit. One row of more would outweigh all."""


class KeypointChecks:
    """Complaints about a table that is seen in pieces, the same as if it were seen whole.

    Attributes:
        labels: different keypoints of the table, as it has them.
    """

    def __init__(self, known: Mapping[str, Collection[object] | None]) -> None:
        """Begin without rows.

        Args:
            known: for frame, camera and keypoint the values that other tables list; None where those are in doubt.
        """
        self.labels: set[str] = set()
        self._known = {column: frozenset(values) for column, values in known.items() if values is not None}
        self._unknown: dict[str, dict[object, None]] = {column: {} for column in self._known}
        self._counts: Counter[str] = Counter()
        self._surest = -np.inf
        self._repeated = pd.DataFrame(columns=KEYS)

    def with_names(self, piece: pd.DataFrame) -> pd.DataFrame:
        """The rows that name a camera and a keypoint."""
        for column in ("camera", "keypoint"):
            without = piece[column].isna()
            self._counts[column] += int(without.sum())
            piece = piece[~without]
        return piece

    def note_values(self, piece: pd.DataFrame) -> None:
        """Look at the numbers and the keypoints of a piece."""
        for column in NUMBERS:
            self._counts[column] += int((~np.isfinite(piece[column])).sum())
        self._counts["negative"] += int((piece["confidence"] < 0).sum())
        self._counts["beyond"] += int((piece["confidence"] > MOST_CONFIDENCE).sum())
        self._surest = np.fmax(self._surest, piece["confidence"].max())
        self.labels.update(piece["keypoint"].unique())

    def note_unknown(self, piece: pd.DataFrame) -> None:
        """Look for frames, cameras and keypoints that no other table lists.

        Args:
            piece: by the template's names.
        """
        for column, values in self._known.items():
            self._unknown[column] |= dict.fromkeys(v for v in piece[column].unique() if v not in values)

    def note_repeats(self, part: pd.DataFrame) -> None:
        """Look for rows that are there twice.

        Args:
            part: all rows of some frames; its index counts the rows of the table.
        """
        repeated = repeated_keys(part, KEYS)
        self._counts["repeated"] += len(repeated)
        if len(repeated):
            some = [table for table in (self._repeated, repeated) if len(table)]
            self._repeated = pd.concat(some).sort_index()[:MOST_LISTED]

    def complain(self, complaints: Complaints, path: str, order: str | None, points: Mapping[str, str]) -> None:
        """Say what was noted.

        Args:
            order: how the table numbers or labels its keypoints; None: by the template's names.
            points: the template's keypoint by point, which an order needs.
        """
        for column in ("camera", "keypoint"):
            if count := self._counts[column]:
                complaints.add(path, column, expected="a name in each row", found=f"{count} rows without any")
        for column in NUMBERS:
            if count := self._counts[column]:
                found, hint = f"{count} rows of NaN or infinity", "leave out rows that the detector did not find"
                complaints.add(path, column, expected="finite numbers", found=found, hint=hint)
        if count := self._counts["negative"]:
            complaints.add(path, "confidence", expected="0 or more", found=f"{count} negative rows")
        if count := self._counts["beyond"]:
            found = f"{count} rows up to {self._surest:g}"
            complaints.add(path, "confidence", expected=f"weights of at most {MOST_CONFIDENCE:g}", found=found)
        complain_of_repeated(complaints, path, self._repeated, self._counts["repeated"])
        if order is not None:
            self._complain_of_order(complaints, path, order, points)
        for column, unknown in self._unknown.items():
            complain_unknown(complaints, path, column, unknown, (), f"the table of {column}s")

    def _complain_of_order(self, complaints: Complaints, path: str, name: str, points: Mapping[str, str]) -> None:
        """Complain of keypoints that the order, or all that the template, lacks."""
        order = read_orders()[name]
        if unknown := sorted(key for key in self.labels if order.point(key) is None):
            expected = f"numbers 0 to {len(order.points) - 1} or labels of {name}"
            complaints.add(path, "keypoint", expected=expected, found=listed(unknown))
        if not any(point in order.points for point in points):
            complaints.add(
                MANIFEST, "template.keypoints", expected=f"points of {name}, such as {', '.join(order.points[:3])}",
                found="none of them", hint="name keypoints so, or say in template.points which points they are",
            )  # fmt: skip
