"""Which angle drives, which torque it meets and what follows: whole assignments, weighed against each other.

An assignment is a driver, what follows it directly or by another follower, and a torque. Its odds are those
of a generic shaft over columns that have nothing to do with each other, times those of what is written.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

from needle_rig.importing import names
from needle_rig.importing.axes import OF_ANGLE
from needle_rig.importing.guess.generic_shaft import Driver
from needle_rig.importing.guess.kinds import kind_of
from needle_rig.importing.guess.series import Series, is_copy
from needle_rig.importing.unit_text import is_counted

ASKED_BELOW = 0.9
"""Probability below which a person is asked."""
WRONG = 0.05
"""Share of headers that say the wrong thing, and of recordings that a generic shaft does not describe. Any
value below 1 − ASKED_BELOW decides alike: either suffices where the other is silent, and is asked against it.
"""
CLEAR = -math.log(WRONG)
MOST_TRIED = 16
"""Columns that are tried as the driver, and as the torque: those whose names speak most for it."""


@dataclass(frozen=True)
class Assignment:
    """A driver with its torque, and by column the log odds that the shaft explains it."""

    base: Series
    torque: Series | None
    explained: dict[int, float]
    """Of followers by their place among the columns."""
    torque_gain: float
    named: float
    """Log odds of what names and units say, at most 0."""

    @cached_property
    def gain(self) -> float:
        """Log odds of the shaft over columns without relation."""
        return sum(self.explained.values()) + self.torque_gain


@dataclass(frozen=True)
class Choice:
    """A column taken for a role, the probability of it, and the second best with its reason."""

    series: Series
    probability: float
    second: str = ""

    @property
    def told(self) -> str:
        """The probability, which the share of wrong headers and models bounds, in words."""
        return f"{min(self.probability, 0.99):.0%} sure"

    @property
    def doubt(self) -> str:
        """What is asked; empty where nothing is."""
        return self.second if self.probability < ASKED_BELOW else ""


@dataclass(frozen=True)
class Assigned:
    """The likeliest assignment."""

    base: Choice
    torque: Choice | None
    followers: list[Series]


def assign(
    angles: Sequence[Series], torques: Sequence[Series], unnamed: Sequence[Series], needs_torque: bool = False
) -> Assigned:
    """The likeliest assignment of columns that can be an angle, a torque, or either.

    Without a torque one is as unlikely as against a name where the machine `needs_torque`.
    """
    return _Columns([*angles, *unnamed], torques, unnamed, needs_torque).assigned()


class _Columns:
    def __init__(
        self,
        moving: list[Series],
        torques: Sequence[Series],
        unnamed: Sequence[Series],
        needs_torque: bool,
    ) -> None:
        self.moving, self.unnamed, self.needs_torque = moving, unnamed, needs_torque
        self.torques = sorted(torques or unnamed, key=_torque_rank)[:MOST_TRIED]
        self.gains: dict[tuple[int, int], float] = {}
        self._followers = cache(self._grown)
        self.resisted: dict[tuple[int, int], float] = {}
        longest = sorted(moving, key=lambda s: -len(s.column.values))
        copies = [
            s
            for k, s in enumerate(longest)
            if any(o.clock != s.clock and names.is_base(o.column.name) and is_copy(o, s) for o in longest[:k])
        ]
        wide = sorted(moving, key=lambda s: (_base_rank(s), -s.span))
        self.tried = [s for s in wide if not any(s is c for c in copies)][:MOST_TRIED]
        self.base_odds, self.torque_odds = (
            CLEAR + math.log(max(1, len(found) - 1)) for found in (self.tried, self.torques)
        )
        """Log odds of one column over each of the others, where the error is shared among them."""
        self.drivers = {self._place(s): Driver(s) for s in self.tried}

    def _place(self, s: Series) -> int:
        return next(k for k, other in enumerate(self.moving) if other is s)

    def _follows(self, driver: int, other: int) -> float:
        """Gain of a follower; which comes first is a question of the clocks on two of them."""
        if (driver, other) not in self.gains:
            s = self.moving[other]
            gain = self.drivers[driver].gain(s)
            if other in self.drivers and s.clock != self.moving[driver].clock:
                gain = max(gain, self.drivers[other].gain(self.moving[driver]))
            self.gains[driver, other] = gain
        return self.gains[driver, other]

    def _resists(self, driver: int, torque: Series) -> float:
        """Gain of a torque."""
        key = driver, id(torque)
        if key not in self.resisted:
            self.resisted[key] = self.drivers[driver].gain(torque, torque=True)
        return self.resisted[key]

    def _candidates(self) -> list[Assignment]:
        first_base = min(map(_base_rank, self.tried))
        first_torque = min(map(_torque_rank, self.torques), default=0)
        nameless = any(t is s for t in self.torques for s in self.unnamed)
        # where angles have names, a torque would have one
        unlikely = nameless and any(map(_is_angle, self.moving)) and not self.needs_torque
        found = []
        for base in self.tried:
            named = -self.base_odds * (_base_rank(base) > first_base)
            choices = [t for t in self.torques if t is not base]
            for torque in choices:
                apart = len(self.torques) > 1 and not _same_group(base, torque, self.moving)
                against = unlikely or apart or _torque_rank(torque) > first_torque
                found.append(self._assignment(base, torque, named - self.torque_odds * against))
            if nameless or not choices:
                without = self.torque_odds * (self.needs_torque and bool(choices))
                found.append(self._assignment(base, None, named - without))
        return found

    def _assignment(self, base: Series, torque: Series | None, named: float) -> Assignment:
        """What follows the base or a follower before it, each by the one that explains it best."""
        root = self._place(base)
        found = self._followers(root, next((k for k, s in enumerate(self.moving) if s is torque), -1))
        resisted = 0.0
        if torque is not None:
            resisted = max(self._resists(k, torque) for k in (root, *found) if k in self.drivers)
        return Assignment(base, torque, found, resisted, named)

    def _grown(self, root: int, torque: int) -> dict[int, float]:
        found: dict[int, float] = {}
        for k in self.order:
            if k not in (root, torque):
                gain = max(self._follows(before, k) for before in (root, *found) if before in self.drivers)
                if gain > (0.0 if _is_angle(self.moving[k]) else CLEAR):
                    found[k] = gain
        return found

    @cached_property
    def order(self) -> list[int]:
        """Columns from the one that leads most: what comes later may follow what comes before."""
        lead = dict.fromkeys(range(len(self.moving)), -math.inf)
        for k in self.drivers:
            lead[k] = sum(self._follows(k, o) - self._follows(o, k) for o in self.drivers if o != k)
        return sorted(lead, key=lambda k: -lead[k])

    def assigned(self) -> Assigned:
        """The likeliest, with the probabilities of its base and of its torque."""
        candidates = self._candidates()
        likely = max(candidates, key=lambda c: c.gain)
        weights = [math.exp(c.named + self._against(c, likely)) for c in candidates]
        best = max(zip(candidates, weights, strict=True), key=lambda c: (c[1], c[0].gain, c[0].base.span))[0]
        of_base = dict.fromkeys(map(id, self.tried), 0.0)
        of_torque: dict[int, float] = {}
        for c, weight in zip(candidates, weights, strict=True):
            of_base[id(c.base)] = max(of_base[id(c.base)], weight)
            if c.base is best.base:
                of_torque[id(c.torque)] = weight
        of_base = {k: weight / sum(of_base.values()) for k, weight in of_base.items()}
        base = self._base(best, of_base, candidates)
        torque = None
        if best.torque is not None:
            share = of_torque[id(best.torque)] / sum(of_torque.values())
            rest = [t for t in self.torques if t is not best.torque and id(t) in of_torque]
            second = max(rest, key=lambda t: of_torque[id(t)], default=None)
            told = "it may have nothing to do with it"
            if second is not None:
                told = f"{second.column.name} could be it as well"
            torque = Choice(best.torque, share, told)
        return Assigned(base, torque, [self.moving[k] for k in best.explained])

    def _against(self, one: Assignment, likely: Assignment) -> float:
        """Log odds of the data for `one` over the likeliest; none where both stand, each on its own."""
        if one.base is likely.base:
            alone, odds = one.torque_gain > CLEAR, self.torque_odds
        else:
            apart = not self._has(likely, one.base) and not self._has(one, likely.base)
            alone = apart and one.gain > CLEAR
            odds = self.base_odds
        return 0.0 if alone else max(one.gain - likely.gain, -odds)

    def _has(self, assignment: Assignment, s: Series) -> bool:
        return s is assignment.torque or self._place(s) in assignment.explained

    def _base(self, best: Assignment, of: dict[int, float], candidates: Sequence[Assignment]) -> Choice:
        share = of[id(best.base)]
        rest = [s for s in self.tried if s is not best.base]
        if not rest:
            return Choice(best.base, share)
        other = max(rest, key=lambda s: of[id(s)])
        its = max((c for c in candidates if c.base is other), key=lambda c: c.gain)
        if _base_rank(other) < _base_rank(best.base):
            why = "its name speaks for it"
        elif its.gain > best.gain:
            why = "more moves with it" if len(its.explained) > len(best.explained) else "it moves first"
        elif its.gain <= CLEAR:
            why = "nothing tells them apart"
        elif self._place(other) in best.explained:
            why = "it moves together with it"
        else:
            why = "it turns a shaft of its own"
        return Choice(
            best.base, share, f"{other.column.name} could be the base as well ({of[id(other)]:.0%}: {why})"
        )


def _is_angle(s: Series) -> bool:
    return kind_of(s.column)[0] in OF_ANGLE


def _base_rank(s: Series) -> int:
    """How much a name speaks against the base: 0 it says that it is it, 1 an angle, 2 nothing, 3 a sensor."""
    if names.is_base(s.column.name):
        return 0
    if names.says(s.column.name, names.SENSOR):
        return 3
    return 1 if _is_angle(s) else 2


def _torque_rank(s: Series) -> int:
    """The same of the base's torque: 0 where it says so, 1 silent, 2 the tip's; a raw reading comes after."""
    raw = 3 * is_counted(s.column.unit)
    if names.says(s.column.name, names.BASE):
        return raw
    return raw + (2 if names.says(s.column.name, names.TIP) else 1)


def _same_group(base: Series, torque: Series, moving: Sequence[Series]) -> bool:
    """Whether the numbers in both names are the same, where the angles have numbers of their own."""
    numbers = [names.numbers_in(s.column.name) for s in moving]
    of_base, of_torque = (names.numbers_in(s.column.name) for s in (base, torque))
    return not (of_base and of_torque) or len(set(numbers)) < len(numbers) or of_base == of_torque
