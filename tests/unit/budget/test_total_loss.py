"""What several causes lose together, against pictures with planted errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.budget.total_loss import is_psnr_loss, total_loss_db


def psnr_db(error: np.ndarray) -> float:
    """PSNR of a picture of range 1 with this error."""
    return float(-10 * np.log10(np.mean(np.square(error))))


@pytest.mark.parametrize("sizes", [(0.05, 0.08), (0.2, 0.01), (0.03, 0.03, 0.03)])
def test_errors_that_do_not_go_together_lose_what_pictures_of_them_lose(sizes: tuple[float, ...]) -> None:
    """A mean of a million products is known to 0.1 % of them (0.004 dB); the bound is five times that."""
    rng = np.random.default_rng(5)
    floor, *causes = (size * rng.standard_normal(1_000_000) for size in (0.1, *sizes))
    alone = [psnr_db(floor) - psnr_db(floor + cause) for cause in causes]
    assert total_loss_db(alone) == pytest.approx(psnr_db(floor) - psnr_db(sum(causes, floor)), abs=0.02)
    assert total_loss_db(alone) < sum(alone)


def test_one_cause_loses_what_it_loses_and_none_nothing() -> None:
    assert total_loss_db([1.8]) == pytest.approx(1.8, rel=1e-12)
    assert total_loss_db([]) == 0 == total_loss_db([math.nan, 0.0])
    assert total_loss_db([10 * math.log10(2)] * 2) == pytest.approx(10 * math.log10(3), rel=1e-12)


def test_gains_add_in_decibels_however_many_there_are() -> None:
    """Two that each leave a tenth of an error leave a hundredth, not less than nothing."""
    assert total_loss_db([-10.0, -10.0]) == pytest.approx(-20, rel=1e-12)
    assert total_loss_db([-0.1, 1.8]) == pytest.approx(1.7, rel=1e-12)


def test_only_losses_of_psnr_are_summed() -> None:
    assert is_psnr_loss("PSNR lost on validation images, partial lit, dB (reference 3, steps 200)")
    assert not is_psnr_loss("irradiance, RMS (reference full, sampling power)")
