"""Errors of dials' settings on a capture.

They are expected as on those subjects of the curves that are of the same kind, heads or bodies: what coarse texels
lose, for one, is far more on bodies. And what the size of texels loses is told by how many this capture would have of
them, as it has no more than `most`: where a map is full at either size, neither loses anything against the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.budget.capture_size import CaptureSize
from pipeline.budget.curve import LEAST_ALLOWED, Curve
from pipeline.budget.curves import Measured
from pipeline.budget.dial_times import texel_ratio, told_by_texels
from pipeline.config.project import SubjectSettings


@dataclass(frozen=True)
class DialErrors:
    """Errors of settings on a capture.

    Attributes:
        settings: of the capture's subject.
        alike: the curves' subjects of its kind.
    """

    settings: SubjectSettings
    size: CaptureSize
    alike: Sequence[str]

    @classmethod
    def of(cls, settings: SubjectSettings, size: CaptureSize, measured: Sequence[Measured]) -> DialErrors:
        """Errors on a capture, as on those of the curves' subjects that are of its kind."""
        return cls(settings, size, [one.subject for one in measured if one.kind == size.kind])

    def error(self, curve: Curve, value: Any) -> float:
        """Error to expect at a setting; NaN if nothing near was measured."""
        judged = curve.among(self.alike)
        if told_by_texels(curve):
            found = judged.error_of_count(texel_ratio(self.settings, self.size, curve, value))
            if np.isfinite(found):
                return found
        return judged.error(value)

    def allowed(self, curve: Curve) -> float:
        """Error up to which a setting is good enough."""
        return curve.among(self.alike).allowed

    def loss(self, curve: Curve, value: Any) -> float:
        """Error over what is allowed; 0 if it is not known, as it cannot be chosen by."""
        loss = self.error(curve, value) / max(self.allowed(curve), LEAST_ALLOWED)
        return 0.0 if math.isnan(loss) else loss
