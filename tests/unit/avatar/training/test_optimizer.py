"""Learning rates over a training."""

import pytest

from pipeline.avatar.training.optimizer import rate_share
from pipeline.config.train_avatar import TrainAvatar


def test_rates_start_whole_are_half_way_in_the_middle_and_end_at_their_last():
    settings = TrainAvatar(steps=300, final_rate=0.2)
    shares = [rate_share(step, settings) for step in range(301)]
    assert shares[0] == 1
    assert shares[100] == pytest.approx(0.2 + 0.8 * 0.75)  # cos 60 deg = 1/2
    assert shares[150] == pytest.approx(0.6)
    assert shares[300] == pytest.approx(0.2)
    assert shares == sorted(shares, reverse=True)


def test_rates_that_do_not_fall():
    settings = TrainAvatar(steps=10, final_rate=1.0)
    assert {rate_share(step, settings) for step in range(11)} == {1.0}
