"""The ladder of a model: what each step added and what it bought, as rows and as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from needle_rig.model import ChannelErrors, SavedModel
from needle_rig.workbench.adopt import IN_NOISE_UNITS

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Step:
    """One rung."""

    label: str
    dataset: str
    date: str
    training: float | None
    held_out: float | None
    floor: float | None
    channels: dict[str, ChannelErrors]
    note: str = ""

    def as_json(self) -> dict[str, Any]:
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
                            training_after=e.training_before, held_out_after=e.held_out_before, floor=e.floor
                        )
                        for n, e in channels.items()
                    },
                )
            )
        label = " ".join([*(f"+ {a}" for a in entry.added), *(f"− {r}" for r in entry.removed)])
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


def ladder_figure(saved: SavedModel) -> Figure:
    """Training and held-out error over the steps, over all and for each channel, with the noise floor."""
    from matplotlib.figure import Figure

    steps = ladder(saved)
    names = list(dict.fromkeys(n for s in steps for n in s.channels))
    columns = 3
    rows = max(1, -(-(len(names) + 1) // columns))
    figure = Figure(figsize=(4.2 * columns, 2.8 * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    place = list(range(len(steps)))

    def draw(axis: Any, title: str, training: list[Any], held: list[Any], floor: list[Any]) -> None:
        as_numbers = [
            [float("nan") if v is None else v for v in values] for values in (training, held, floor)
        ]
        axis.plot(place, as_numbers[0], "o--", color="0.5", label="training")
        axis.plot(place, as_numbers[1], "o-", color="tab:red", label="commands left out")
        axis.plot(place, as_numbers[2], color="tab:green", lw=1, label="noise floor")
        axis.set_yscale("log")
        axis.set_title(title, fontsize=9)
        axis.set_xticks(place, [s.label for s in steps], rotation=20, ha="right", fontsize=7)

    draw(
        grid[0],
        "all, in units of the noise",
        [s.training for s in steps],
        [s.held_out for s in steps],
        [s.floor for s in steps],
    )
    grid[0].legend(fontsize=7)
    for axis, name in zip(grid[1:], names, strict=False):
        errors = [s.channels.get(name, ChannelErrors()) for s in steps]
        draw(
            axis,
            name.replace("_deg", " / °").replace("_nmm", " / N·mm"),
            [e.training_after for e in errors],
            [e.held_out_after for e in errors],
            [e.floor for e in errors],
        )
    for axis in grid[1 + len(names) :]:
        axis.set_visible(False)
    return figure
