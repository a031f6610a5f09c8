"""One trial in one line: which rig, doing what, broken when and by what; and what it must keep to."""

from __future__ import annotations

from dataclasses import dataclass

from campaigns.rig.hazard.faults import FAULTS
from campaigns.rig.hazard.scenes import SCENES
from campaigns.rig.hazard.setups import PAIR_BOUND_DEG, SETUPS
from campaigns.rig.hazard.trial import Inject, Result

WINDUP_DEG = 275.0
"""`drive.windup_limit_deg` as shipped, and the bound of a single fault for stopping."""


@dataclass(frozen=True)
class Case:
    """A trial. `kind` is single, under (a passing fault), pair, latch or slow. The first fault begins at the
    end of the host's `tick`; `breaks` are names with the seconds after that."""

    kind: str
    setup: str
    scene: str
    speed_deg_s: float
    seed: int
    tick: int
    breaks: tuple[tuple[str, float], ...]
    place: str = ""

    @property
    def text(self) -> str:
        """The line from which `parse` makes it again."""
        breaks = "+".join(f"{name}@{at_s:.3f}" for name, at_s in self.breaks)
        head = f"{self.kind}|{self.setup}|{self.scene}|{self.speed_deg_s:g}|{self.seed}|{self.tick}"
        return f"{head}|{self.place}|{breaks}"

    @classmethod
    def parse(cls, text: str) -> Case:
        """Raises ValueError in one sentence."""
        parts = text.split("|")
        if len(parts) != 8:
            raise ValueError(f"{text!r} has {len(parts)} parts, not 8; copy the whole line of a broken trial")
        kind, setup, scene, speed, seed, tick, place, told = parts
        breaks = []
        for one in told.split("+"):
            name, _, at_s = one.rpartition("@")
            breaks.append((name, float(at_s)))
        unknown = [name for name, _ in breaks if name not in FAULTS]
        unknown += [word for word, known in ((setup, SETUPS), (scene, SCENES)) if word not in known]
        if unknown:
            raise ValueError(f"{unknown[0]!r} is unknown here; the line may be of another version")
        return cls(kind, setup, scene, float(speed), int(seed), int(tick), tuple(breaks), place)

    @property
    def injections(self) -> list[tuple[float, Inject]]:
        """What is done to the rig, and when."""
        return [(at_s, FAULTS[name].inject) for name, at_s in self.breaks]

    @property
    def watch_s(self) -> float:
        """How long to look after the last fault began."""
        return max(FAULTS[name].watch_s for name, _ in self.breaks)

    @property
    def bound_deg(self) -> float:
        """How far the base may go."""
        if self.kind == "pair":
            return PAIR_BOUND_DEG
        setup, faults = SETUPS[self.setup], [FAULTS[name] for name, _ in self.breaks]
        return setup.bound_deg(
            self.speed_deg_s,
            max(fault.turning_deg_s(self.speed_deg_s) for fault in faults),
            lies_by_little=any(fault.lies_by_little for fault in faults),
        )

    def broken(self, result: Result) -> list[str]:
        """Every promise that `result` does not keep. A pair may go further than its bound if it ends."""
        found = []
        if self.kind != "pair":
            for what in ("commanded", "asked"):
                went_deg = getattr(result, f"{what}_deg")
                if went_deg > self.bound_deg:
                    found.append(f"{went_deg:.1f}° beyond what was {what}, bound {self.bound_deg:.1f}°")
        if not result.ended:
            found.append("the base turns without end")
        if result.windup_deg > WINDUP_DEG:
            found.append(f"{result.windup_deg:.0f}° of windup, bound {WINDUP_DEG:g}°")
        if result.woken:
            found.append(f"the supply came on {result.woken} times after a latching fault without a clear")
        if result.moved:
            found.append(f"{result.moved} times it ran or moved without an order")
        return found
