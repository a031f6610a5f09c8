"""What to do after *unknown*: what is explained in part, what to record, which channel is in doubt."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.workbench.observations.blocks import NOTE
from needle_rig.workbench.selection.answer import Answer, Ranked
from needle_rig.workbench.selection.diagnose import Diagnosis


@dataclass(frozen=True)
class WayOn:
    """What goes on from a diagnosis that does not explain the data."""

    part: Ranked | None
    """The effect that lowers the error most by itself; adopted, it is a part of the next model."""
    as_good: tuple[str, ...]
    """Effects that lower it as much: which of them is the cause is open."""
    channel: str
    """The only channel that more than noise is left in, where others are met; empty without one."""
    record: tuple[str, ...]
    """What the recording lacks, worst first."""

    def part_sentence(self, before: float) -> str:
        """What the effect explains, and that it is not said to be the cause."""
        assert self.part is not None
        after = self.part.held_out_error
        error = (
            f", error left out {before:.2f} → {after:.2f} × the noise"
            if after is not None and math.isfinite(before)
            else ""
        )
        rivals = f"; as well as {', '.join(self.as_good)}" if self.as_good else ""
        return (
            f"{self.part.effect} explains {100 * self.part.error_removed:.0f} % of the error above the"
            f" noise{error}{rivals}"
        )


def way_on(found: Answer) -> WayOn:
    """Of a diagnosis whose verdict is *unknown*."""
    helping = [row for row in found.ranking if row.error_removed > 0.0 and _lowers(row, found)]
    part = max(helping, key=lambda row: row.error_removed, default=None)
    return WayOn(
        part,
        tuple(
            row.effect
            for row in helping
            if part is not None
            and row is not part
            and f"{row.error_removed:.2f}" == f"{part.error_removed:.2f}"
        ),
        _channel_in_doubt(found),
        _to_record(found) if isinstance(found, Diagnosis) else (),
    )


def _lowers(row: Ranked, found: Answer) -> bool:
    """Whether commands left out are predicted better; with one command alone nobody knows."""
    if not math.isfinite(found.held_out_error_before):
        return True
    return row.held_out_error is not None and row.held_out_error < found.held_out_error_before


def _channel_in_doubt(found: Answer) -> str:
    if not isinstance(found, Diagnosis):
        return ""
    channels, measured = {p.channel for p in found.residual_patterns.patterns}, _measured(found)
    return next(iter(channels)) if len(channels) == 1 and channels < measured else ""


def _measured(found: Diagnosis) -> set[str]:
    data = found.baseline.dataset
    known = {"torque": any(t.torque_ok.any() for t in data.trials)}
    for k, name in enumerate(data.sensor_names):
        known[name] = any(t.hall_ok[:, k].any() for t in data.trials)
    return {name for name, there in known.items() if there}


def _to_record(found: Diagnosis) -> tuple[str, ...]:
    lacks = []
    measured = _measured(found)
    if "torque" not in measured:
        lacks.append("the base torque beside the angles")
    if measured <= {"torque"}:
        lacks.append("an angle of the shaft beside the torque")
    if not math.isfinite(found.held_out_error_before) or NOTE in found.baseline.dataset.notes:
        lacks.append("a command with another target, speed or dwell")
    if found.lack_before is None:
        lacks.append("one command three times")
    return tuple(lacks)
