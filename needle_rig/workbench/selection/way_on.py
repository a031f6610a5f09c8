"""What to do after *unknown*: what is explained in part, what to record, which channel is in doubt."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.workbench.observations.blocks import NOTE
from needle_rig.workbench.selection.answer import Answer, Ranked
from needle_rig.workbench.selection.diagnose import Diagnosis
from needle_rig.workbench.selection.documents import WayOnDocument


@dataclass(frozen=True)
class WayOn:
    """What goes on from a diagnosis that does not explain the data."""

    before: float
    """Error left out of the model as it is, in units of the noise; infinite with one command."""
    part: Ranked | None
    """The effect that lowers the error most by itself; adopted, it is a part of the next model."""
    as_good: tuple[str, ...]
    """Effects that lower it as much: which of them is the cause is open."""
    channel: str
    """The only channel that more than noise is left in, where others are met; empty without one."""
    record: tuple[str, ...]
    """What the recording lacks, worst first."""

    def part_sentence(self) -> str:
        """What the effect explains, and that it is not said to be the cause; empty without one."""
        if self.part is None:
            return ""
        before, after = self.before, self.part.held_out_error
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

    def record_sentence(self) -> str:
        """What to record beside these data; empty where they lack nothing."""
        return f"record {'; '.join(self.record)}, and ask of both" if self.record else ""

    def channel_sentence(self) -> str:
        """The channel that may be at fault; empty without one."""
        if not self.channel:
            return ""
        return (
            f"all that is left is in {self.channel}, and the other channels are met: where that sensor is in"
            " doubt, take its column out of the trial files and ask again"
        )

    def as_json(self) -> WayOnDocument:
        """As it stands in the JSON answer."""
        sentences = self.part_sentence(), self.record_sentence(), self.channel_sentence()
        return {
            "part": None if self.part is None else self.part.effect,
            "as_good": list(self.as_good),
            "channel": self.channel or None,
            "record": list(self.record),
            "sentences": [sentence for sentence in sentences if sentence],
        }


def way_on(found: Answer) -> WayOn:
    """Of a diagnosis whose verdict is *unknown*."""
    helping = [row for row in found.ranking if row.error_removed > 0.0 and _lowers(row, found)]
    part = max(helping, key=lambda row: row.error_removed, default=None)
    return WayOn(
        found.held_out_error_before,
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
