"""The choice against trying everything."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from pipeline.budget.knapsack import Option, best_within


def random_problem(seed: int):
    rng = np.random.default_rng(seed)
    stages = {name: float(rng.uniform(0, 20)) for name in "abc"[: rng.integers(1, 4)]}
    dials = {}
    for number in range(rng.integers(0, 6)):
        stage = str(rng.choice(list(stages)))
        # Losses and factors that are often equal, and not sorted. A third of the dials cost other stages time, or save.
        options = [
            Option(f"{k}", float(rng.integers(1, 8)) / 4, float(rng.integers(0, 6)) / 2)
            for k in range(rng.integers(1, 5))
        ]
        if number % 3 == seed % 3:
            options = [replace(option, elsewhere=float(rng.integers(-4, 9)) / 2) for option in options]
        dials.setdefault(stage, {})[f"dial{number}"] = options
    return stages, dials, float(rng.uniform(0, 60))


def tried_all(stages, dials):
    """Every combination: (seconds, loss, names)."""
    places = [(stage, dial) for stage in stages for dial in dials.get(stage, {})]
    for options in product(*(dials[stage][dial] for stage, dial in places)):
        factor = dict.fromkeys(stages, 1.0)
        for (stage, _), option in zip(places, options, strict=True):
            factor[stage] *= option.factor
        seconds = sum(stages[stage] * factor[stage] for stage in stages) + sum(each.elsewhere for each in options)
        yield (
            seconds,
            sum(option.loss for option in options),
            {d: o.name for (_, d), o in zip(places, options, strict=True)},
        )


@pytest.mark.parametrize("seed", range(60))
def test_as_good_as_trying_everything(seed) -> None:
    stages, dials, limit = random_problem(seed)
    best, fastest = best_within(limit, stages, dials)
    everything = list(tried_all(stages, dials))
    assert fastest.seconds == pytest.approx(min(seconds for seconds, _, _ in everything))
    within = [(loss, seconds) for seconds, loss, _ in everything if seconds <= limit + 1e-9]
    if best is None:
        assert fastest.seconds > limit
        return
    least_loss, _ = min(within)
    assert best.loss == pytest.approx(least_loss)
    assert best.seconds == pytest.approx(min(s for loss, s in within if math.isclose(loss, least_loss)))
    # What it names is what it costs.
    named = [(seconds, loss) for seconds, loss, names in everything if names == dict(best.names)]
    assert (best.seconds, best.loss) == pytest.approx(named[0])


def test_problems_of_both_kinds_were_tried() -> None:
    found = [best_within(limit, stages, dials)[0] is None for stages, dials, limit in map(random_problem, range(60))]
    assert 5 < sum(found) < 55


def test_more_time_never_loses_more() -> None:
    stages, dials, _ = random_problem(7)
    losses = [best.loss for limit in np.linspace(0, 80, 60) if (best := best_within(limit, stages, dials)[0])]
    assert len(losses) > 5 and losses == sorted(losses, reverse=True)
