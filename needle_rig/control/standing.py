"""The faults that stand: latched ones until a person clears them, passing ones while their cause lasts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence

from needle_rig.control.faults import Fault, FaultName
from needle_rig.records import DriveFault


class StandingFaults:
    """Keeps every latching fault that was found, whatever else stands beside it."""

    def __init__(self) -> None:
        self._latched: dict[tuple[FaultName, DriveFault], Fault] = {}
        self._passing: Fault | None = None

    def __bool__(self) -> bool:
        return bool(self._latched) or self._passing is not None

    @property
    def latched(self) -> bool:
        """Whether one of them stays until a person clears it."""
        return bool(self._latched)

    @property
    def all(self) -> tuple[Fault, ...]:
        """Every fault that stands: the latched ones in the order in which they came, then the passing one."""
        return (*self._latched.values(), *filter(None, [self._passing]))

    @property
    def first(self) -> Fault | None:
        """The one that a person sees first: the oldest latched one, else the passing one."""
        return next(iter(self.all), None)

    @property
    def text(self) -> str:
        """All of them as one sentence each; empty where nothing stands."""
        return _told(self.all)

    def take(self, found: Sequence[Fault]) -> None:
        """What was found in this tick: latching faults are kept, a passing one lasts until the next tick."""
        self._passing = None
        if not found:  # nearly always
            return
        for fault in found:
            if fault.latching:
                self._latched.setdefault((fault.name, fault.bit), fault)
        self._passing = next((fault for fault in found if not fault.latching), None)

    def beside(self, some: Collection[Fault]) -> str:
        """All faults that stand but `some`, as one sentence each; empty where there is no other."""
        return _told(fault for fault in self.all if fault not in some)

    def settle(self, some: Collection[Fault]) -> None:
        """What a person did ended `some`; the others stay."""
        self._latched = {key: fault for key, fault in self._latched.items() if fault not in some}
        self._passing = None

    def clear(self) -> None:
        """A person has looked: causes that are still there bring their faults back."""
        self._latched.clear()
        self._passing = None


def _told(faults: Iterable[Fault]) -> str:
    return " Also: ".join(fault.text for fault in faults)
