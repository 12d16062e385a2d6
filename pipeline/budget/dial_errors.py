"""Errors of dials' settings on a capture.

They are expected as on those subjects of the curves that are of the same kind, heads or bodies, and of the same
material: coarse texels lose far more on bodies, and few steps far more on wax. Settings are chosen by all of that kind:
nobody knows what a capture is made of before it is planned. And what the size of texels loses is told by how many this
capture would have of them, as it has no more than `most`: where a map is full at either size, neither loses anything
against the other.
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
from pipeline.budget.total_loss import is_psnr_loss, squared_error_more
from pipeline.config.project import SubjectSettings


@dataclass(frozen=True)
class DialErrors:
    """Errors of settings on a capture.

    Attributes:
        settings: of the capture's subject.
        of_kind: the curves' subjects of its kind.
        alike: those of them of its material; all, if there is none.
    """

    settings: SubjectSettings
    size: CaptureSize
    of_kind: Sequence[str]
    alike: Sequence[str]

    @classmethod
    def of(cls, settings: SubjectSettings, size: CaptureSize, measured: Sequence[Measured]) -> DialErrors:
        """Errors on a capture, as on those of the curves' subjects that are like it."""
        of_kind = {one.subject: one.material for one in measured if one.kind == size.kind}
        alike = [subject for subject, material in of_kind.items() if material == size.material]
        return cls(settings, size, list(of_kind), alike or list(of_kind))

    def error(self, curve: Curve, value: Any) -> float:
        """Error to expect at a setting; NaN if nothing near was measured."""
        return self._error_on(curve.among(self.alike), value)

    def metric(self, curve: Curve) -> str:
        """Name of that error, with its unit and what it is relative to."""
        return curve.among(self.alike).metric

    def _error_on(self, judged: Curve, value: Any) -> float:
        if told_by_texels(judged):
            found = judged.error_of_count(texel_ratio(self.settings, self.size, judged, value))
            if np.isfinite(found):
                return found
        return judged.error(value)

    def allowed(self, curve: Curve) -> float:
        """Error up to which a setting is good enough."""
        return curve.among(self.of_kind).allowed

    def loss(self, curve: Curve, value: Any) -> float:
        """Error over what is allowed, on subjects of its kind.

        Of PSNR, both are squared errors, as these add. It is 0 if it is not known, as it cannot be chosen by.
        """
        error, allowed = self._error_on(curve.among(self.of_kind), value), max(self.allowed(curve), LEAST_ALLOWED)
        if is_psnr_loss(curve.metric):
            error, allowed = squared_error_more(error), squared_error_more(allowed)
        return 0.0 if math.isnan(error) else error / allowed
