"""The ladder of a model: what each step added, and the errors after it."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.model import ChannelErrors, SavedModel
from needle_rig.records import JsonObject
from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS


@dataclass(frozen=True)
class Step:
    """One step of learning: what was added, on which data, and the errors after it."""

    label: str
    dataset: str
    date: str
    training: float | None
    held_out: float | None
    floor: float | None
    channels: dict[str, ChannelErrors]
    note: str = ""

    def as_json(self) -> JsonObject:
        """As it stands in the JSON answer."""
        return {
            "step": self.label,
            "dataset": self.dataset,
            "date": self.date,
            "training_error": self.training,
            "held_out_error": self.held_out,
            "noise_floor": self.floor,
            "channels": {
                name: errors.model_dump(exclude_none=True) for name, errors in self.channels.items()
            },
            "note": self.note,
        }


def ladder(saved: SavedModel) -> list[Step]:
    """The start and every step, in order. Errors over all channels are in units of the noise."""
    steps: list[Step] = []
    for entry in saved.history:
        over_all = entry.errors.get(IN_NOISE_UNITS, ChannelErrors())
        channels = {n: e for n, e in entry.errors.items() if n != IN_NOISE_UNITS}
        if not steps or steps[-1].dataset != entry.dataset:
            steps.append(
                Step(
                    f"{saved.starts_from}" if not steps else "the same model",
                    entry.dataset,
                    entry.date,
                    over_all.training_before,
                    over_all.held_out_before,
                    over_all.floor,
                    {
                        n: ChannelErrors(
                            training_after=e.training_before,
                            held_out_after=e.held_out_before,
                            training_floor=e.training_floor,
                            floor=e.floor,
                        )
                        for n, e in channels.items()
                    },
                )
            )
        changes = [*(f"+ {a}" for a in entry.added), *(f"− {r}" for r in entry.removed)]
        label = " ".join(changes) or "parameters updated"
        steps.append(
            Step(
                label,
                entry.dataset,
                entry.date,
                over_all.training_after,
                over_all.held_out_after,
                over_all.floor,
                channels,
                entry.note,
            )
        )
    return steps
