"""Loss of PSNR by several causes together."""

from __future__ import annotations

import math
from collections.abc import Iterable


def is_psnr_loss(metric: str) -> bool:
    """True of a dial's metric that is a loss of PSNR."""
    return metric.startswith("PSNR lost")


def squared_error_more(loss_db: float) -> float:
    """Share by which a mean squared error is larger where PSNR loses so many decibels."""
    return 10 ** (loss_db / 10) - 1


def total_loss_db(losses_db: Iterable[float]) -> float:
    """Decibels of PSNR that several causes lose together: their mean squared errors add.

    A loss of l dB makes a mean squared error 10^(l / 10) times as large; what that is beyond 1 is the cause's own
    (`squared_error_more`). Those of errors that do not go with one another add. A negative loss is a gain, which leaves
    a part of an error whatever it consists of: gains add in decibels. What is not known counts as nothing.
    """
    known = [loss for loss in losses_db if not math.isnan(loss)]
    shares = math.fsum(squared_error_more(loss) for loss in known if loss > 0)
    return 10 * math.log10(1 + shares) + math.fsum(loss for loss in known if loss < 0)
