"""Knapsack of settings, one per dial, that lose least in a given time.

The solution is exact, over all combinations.

The time of a stage is what it takes with its own settings times one factor per dial that it is turned by; a setting may
cost further seconds in other stages, or save some; the loss is the sum of the dials' losses. Of combinations of some
dials that cost no other stage time, what is slower and loses more stays so whatever the other dials say. So only the
Pareto front can be part of the best one: dial by dial the front is extended and thinned again, and nothing better is
passed over. Dials that cost other stages time come last, since no factor multiplies those seconds; their combinations
are all kept. Along the final front the next step is always the one that was best to take: the least loss for the
seconds it costs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Option:
    """One setting of a dial.

    Attributes:
        name: of the setting.
        factor: on the time of the dial's stage.
        loss: what it loses.
        elsewhere: seconds more than usual in other stages.
    """

    name: str
    factor: float
    loss: float
    elsewhere: float = 0.0


@dataclass(frozen=True)
class Combination:
    """Settings by dial, and what they take and lose together.

    Attributes:
        seconds, loss: of all.
        names: dials and the names of their settings.
        elsewhere: seconds that are not among `seconds` yet, as further dials do not multiply them.
    """

    seconds: float
    loss: float
    names: tuple[tuple[str, str], ...] = ()
    elsewhere: float = 0.0


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
        pairs = ((a, b) for a in front for b in of_stage(seconds, dials.get(stage, {})))
        front = thinned(Combination(a.seconds + b.seconds, a.loss + b.loss, a.names + b.names) for a, b in pairs)
    within = [combination for combination in front if combination.seconds <= limit]
    return (within[-1] if within else None), front[0]


def of_stage(seconds: float, dials: Mapping[str, Sequence[Option]]) -> list[Combination]:
    """Combinations of a stage's dials that may be part of the best one, with all their seconds."""
    own = [Combination(seconds, 0.0)]
    costs_others = {dial: any(option.elsewhere for option in options) for dial, options in dials.items()}
    for dial in sorted(dials, key=costs_others.__getitem__):
        extended = [
            Combination(c.seconds * o.factor, c.loss + o.loss, (*c.names, (dial, o.name)), c.elsewhere + o.elsewhere)
            for c in own
            for o in dials[dial]
        ]
        own = extended if costs_others[dial] else thinned(extended)
    return [Combination(each.seconds + each.elsewhere, each.loss, each.names) for each in own]


def thinned(combinations: Iterable[Combination]) -> list[Combination]:
    """The Pareto front, fastest first, so that each loses less than the one before."""
    front: list[Combination] = []
    for combination in sorted(combinations, key=lambda one: (one.seconds, one.loss)):
        if not front or combination.loss < front[-1].loss:
            front.append(combination)
    return front
