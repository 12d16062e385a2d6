"""Knapsack of settings, one per dial, that lose least in a given time.

The solution is exact, over all combinations.

The time of a stage is what it takes with its own settings times one factor per dial that it is turned by; the loss is
the sum of the dials' losses. Both only grow with either, so of the combinations of some dials only the Pareto front
can be part of the best one: dial by dial the front is extended and thinned again, and nothing better is passed over.
Along the final front the next step is always the one that was best to take: the least loss for the seconds it costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Option:
    """One setting of a dial: its name, its factor on the time of the stage, and what it loses."""

    name: str
    factor: float
    loss: float


@dataclass(frozen=True)
class Combination:
    """Settings by dial, the seconds they take together, and what they lose together."""

    seconds: float
    loss: float
    names: tuple[tuple[str, str], ...] = ()


def best_within(
    limit: float, stages: Mapping[str, float], dials: Mapping[str, Mapping[str, Sequence[Option]]]
) -> tuple[Combination | None, Combination]:
    """Find the combination that loses least in `limit` seconds; return it and the fastest.

    Of equal ones it is the fastest; it is None if nothing fits.

    Args:
        limit: seconds for all stages together.
        stages: seconds of each stage where all its factors are 1.
        dials: stage -> dial -> its options, at least one each.
    """
    front = [Combination(0.0, 0.0)]
    for stage, seconds in stages.items():
        own = [Combination(seconds, 0.0)]
        for dial, options in dials.get(stage, {}).items():
            own = thinned(
                Combination(c.seconds * o.factor, c.loss + o.loss, (*c.names, (dial, o.name)))
                for c in own
                for o in options
            )
        pairs = ((a, b) for a in front for b in own)
        front = thinned(Combination(a.seconds + b.seconds, a.loss + b.loss, a.names + b.names) for a, b in pairs)
    within = [combination for combination in front if combination.seconds <= limit]
    return (within[-1] if within else None), front[0]


def thinned(combinations: Iterable[Combination]) -> list[Combination]:
    """The Pareto front, fastest first, so that each loses less than the one before."""
    front: list[Combination] = []
    for combination in sorted(combinations, key=lambda one: (one.seconds, one.loss)):
        if not front or combination.loss < front[-1].loss:
            front.append(combination)
    return front
