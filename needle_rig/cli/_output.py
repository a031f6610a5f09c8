"""How a finished run is shown: table, verdict, files."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from needle_rig.service.api.documents import Settled, Told

PIPED_COLUMNS = 100_000
"""No line is longer: notes are sentences, and tables have a row a result."""
EXIT_CODES = {"aligned": 0, "not_aligned": 0, "fault": 3, "aborted": 4}


def console(*, markup: bool = False) -> Console:
    """Prints results; as wide as they are where no terminal shows them, so that a pipe gets whole lines."""
    from rich.console import Console

    width = None if sys.stdout.isatty() or "COLUMNS" in os.environ else PIPED_COLUMNS
    return Console(highlight=False, markup=markup, width=width)


def settled_table(settled: list[Settled]) -> Table:
    """A row for each settled motion; angles in degrees, torque in N·mm."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0), show_edge=False)
    sensors = len(settled[0]["hall_deg"]) if settled else 0
    table.add_column("motion\n", no_wrap=True)
    halls = (f"hall {n + 1}\n°" for n in range(sensors))
    for name in ("base\n°", "torque\nN·mm", "predicted\nlag °", *halls, "tip lag\n°"):
        table.add_column(name, justify="right", no_wrap=True)
    for motion in settled:
        table.add_row(
            motion["phase"],
            number(motion["base_deg"], 2),
            number(motion["torque_nmm"], 4),
            number(motion["predicted_lag_deg"], 1),
            *(number(angle, 1) for angle in motion["hall_deg"]),
            number(motion["tip_lag_deg"], 1),
        )
    return table


def number(value: float | None, digits: int) -> str:
    """`value` with so many digits, never as minus zero; a dash where there is none."""
    if value is None:
        return "–"
    return f"{round(value, digits) + 0.0:.{digits}f}"


def verdict(ended: Told) -> str:
    """How a run ended, in one sentence that says so when no real needle was turned."""
    text = ended["text"]
    return f"Simulated: {text}" if ended["result"]["simulated"] else f"{text[:1].upper()}{text[1:]}"


def tell_result(console: Console, ended: Told, figure: str | None) -> None:
    """Table, the paper's three conditions, the verdict and the files of a run that ended."""
    from rich.markup import escape

    if ended["settled"]:
        console.print(settled_table(ended["settled"]))
        console.print()
    for condition in ended["conditions"]:
        angle = condition["unit"] == "°"
        unit = "°" if angle else f" {condition['unit']}"
        mark, colour = ("✓", "green") if condition["met"] else ("✗", "red")
        console.print(
            f"[{colour}]{mark}[/] {condition['name']}  {condition['text']}: "
            f"{number(condition['value'], 1 if angle else 3)}{unit}, limit {condition['limit']:g}{unit}",
            highlight=False,
        )
    status = ended["result"]["status"]
    colour = {"aligned": "green", "not_aligned": "yellow"}.get(status, "red")
    console.print(f"[bold {colour}]{escape(verdict(ended))}.[/]", highlight=False, soft_wrap=True)
    console.print(f"run:     {ended['result']['run']}", highlight=False, markup=False, soft_wrap=True)
    if figure is not None:
        console.print(f"picture: {figure}", highlight=False, markup=False, soft_wrap=True)
