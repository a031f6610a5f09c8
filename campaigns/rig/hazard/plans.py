"""Which trials there are: places in a scene, and what breaks there."""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterator
from dataclasses import dataclass

from campaigns.rig.hazard.faults import FAULTS, LATCHING, PASSING, faults_of
from campaigns.rig.hazard.scenes import SLOW
from campaigns.rig.hazard.setups import SETUPS, SPEEDS_DEG_S

PASSING_BEFORE_S = 0.3
"""How long a passing fault stands before the other one begins."""
LATEST_SECOND_S = 0.8
PAIRS_A_SEQUENCE = 10
_PLACES = (
    ("run", "before"),
    ("run", "moving"),
    ("run", "between"),
    ("run", "seam"),
    ("run", "done"),
    ("run", "moving"),
    ("hold", "holding"),
    ("run", "seam"),
    ("run", "under"),
    ("hold", "under"),
)
_A_SEQUENCE = 5
"""Places of one healthy sequence."""
Breaks = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Plan:
    """One healthy sequence; at each of its `places` copies of it are broken, once for each of the breaks."""

    setup: str
    scene: str
    speed_deg_s: float
    seed: int
    places: tuple[tuple[str, str, tuple[Breaks, ...]], ...]
    """(kind of its trials, place, breaks)."""

    @property
    def trials(self) -> int:
        """How many copies it takes."""
        return sum(len(breaks) for _, _, breaks in self.places)


def setups_of(drive: str) -> list[str]:
    """Names of the setups with this drive."""
    return [name for name, setup in SETUPS.items() if setup.drive == drive]


def singles(
    instants: int, seed: int, only: str = "", drives: tuple[str, ...] = ("own", "cia402")
) -> Iterator[Plan]:
    """Every fault at every speed, at `instants` instants a drive; the setups take turns."""
    for drive, (row, speed_deg_s) in itertools.product(drives, enumerate(SPEEDS_DEG_S)):
        setups, faults = setups_of(drive), faults_of(drive, only)
        for number, start in enumerate(range(0, instants, _A_SEQUENCE)):
            taken = range(start, min(start + _A_SEQUENCE, instants))
            wanted = [_PLACES[(instant + 3 * row) % len(_PLACES)] for instant in taken]
            setup = setups[(number + 3 * row + number // len(setups)) % len(setups)]
            chance = random.Random(f"{seed} {setup} {speed_deg_s} {number}")
            for scene in dict.fromkeys(scene for scene, _ in wanted):
                places = tuple(
                    _of_place(place, faults, chance) for of_scene, place in wanted if of_scene == scene
                )
                yield Plan(setup, scene, speed_deg_s, seed + 1000 * row + number, places)


def _of_place(place: str, faults: list[str], chance: random.Random) -> tuple[str, str, tuple[Breaks, ...]]:
    if place != "under":
        return "single", place, tuple(((name, 0.0),) for name in faults)
    breaks = []
    for name in faults:
        before = chance.choice([p for p in PASSING if p.split()[0] != name.split()[0]])
        breaks.append(((before, 0.0), (name, PASSING_BEFORE_S)))
    return "under", "any", tuple(breaks)


def pairs(count: int, seed: int) -> Iterator[Plan]:
    """Random pairs of faults; the second begins up to 0.8 s after the first."""
    chance = random.Random(f"pairs {seed}")
    for number in range(0, count, PAIRS_A_SEQUENCE):
        setup = chance.choice(list(SETUPS))
        names = faults_of(SETUPS[setup].drive)
        places = []
        for _ in range(min(PAIRS_A_SEQUENCE, count - number)):
            first, second = chance.sample(names, 2)
            gap_s = round(chance.choice((0.0, chance.uniform(0.0, LATEST_SECOND_S))), 3)
            places.append(("pair", "any", ((((first, 0.0), (second, gap_s))),)))
        scene = chance.choice(("run", "run", "hold"))
        yield Plan(setup, scene, chance.choice(SPEEDS_DEG_S), seed + 10_000 + number, tuple(places))


def latches(seed: int) -> Iterator[Plan]:
    """Every fault that latches under every fault that passes."""
    for drive in ("own", "cia402"):
        breaks = tuple(
            ((passing, 0.0), (latching, PASSING_BEFORE_S))
            for passing, latching in itertools.product(PASSING, LATCHING)
            if drive in FAULTS[latching].drives and passing.split()[0] != latching.split()[0]
        )
        for scene, place in (("run", "moving"), ("hold", "holding"), ("run", "done")):
            yield Plan(f"{drive}-200Hz-fresh", scene, 20.0, seed + 20_000, (("latch", place, breaks),))


def slow(seed: int) -> Iterator[Plan]:
    """Faults that show after a long time."""
    for drive, (scene, speed_deg_s, name) in itertools.product(("own", "cia402"), SLOW):
        breaks = (((name, 0.0),),)
        yield Plan(f"{drive}-200Hz-fresh", scene, speed_deg_s, seed + 30_000, (("slow", "ordered", breaks),))
