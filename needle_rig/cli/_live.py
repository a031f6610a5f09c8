"""What a person sees while a run goes on: a live display on a terminal, else one line a phase."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

    from needle_rig.service.api.documents import Document, Whole

_REFRESH_S = 0.08
_MOVING = ("rest", "moving", "settling", "measuring")
_COLOURS = {"moving": "cyan", "settling": "yellow", "measuring": "magenta", "fault": "red", "done": "green"}


@contextmanager
def moving_bar(reason: str) -> Iterator[None]:
    """A bar on stderr that moves while the block runs, with the reason and the time; on a terminal only."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        progress.add_task(reason, total=None)
        yield


class View(Protocol):
    """Shows documents of the daemon's stream, inside a with block."""

    def __enter__(self) -> Self: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
    def show(self, document: Document) -> None:
        """Take in one document."""


class PhaseLines:
    """One line a phase on stderr."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        return

    def show(self, document: Document) -> None:
        """Print a line when the phase is new."""
        if document["type"] == "phase":
            simulated = "  simulated" if document["rig"]["simulated"] else ""
            print(phase_line(document) + simulated, file=sys.stderr, flush=True)  # noqa: T201 - the display itself


def phase_line(document: Whole) -> str:
    """A phase in one line: how far, which motion, what it waits for and how long."""
    sensors = document["sensors"]
    if document["phase"] not in _MOVING or sensors is None:
        return f"{document['progress']:4.0%}  {document['phase']}"
    line = (
        f"{document['progress']:4.0%}  {document['motion']:<10} {document['phase']:<10} {_waiting(document)}"
    )
    return f"{line}  (base {_number(sensors['base_deg'], 1)}°, {_number(sensors['torque_nmm'], 3)} N·mm)"


class LiveDisplay:
    """A display that redraws itself: phase, countdown, progress, readings, the shaft, the settled motions."""

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self._console = console
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._drawn_s = 0.0

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.__exit__(kind, error, trace)

    def show(self, document: Document) -> None:
        """Redraw with a new state, a dozen times a second at most."""
        if document["type"] == "ended":
            return
        now_s = time.monotonic()
        if document["type"] == "state" and now_s - self._drawn_s < _REFRESH_S:
            return
        self._drawn_s = now_s
        self._live.update(screen(document, self._console.width, self._console.height), refresh=True)


def screen(state: Whole, width: int, height: int) -> RenderableType:
    """The whole display for one state, for a terminal of this size in characters."""
    from rich.console import Group
    from rich.text import Text

    from needle_rig.cli._output import settled_table

    settled = state["settled"]
    parts: list[RenderableType] = [
        _title(state),
        _phase(state),
        _progress(state, width),
        Text(),
        _readings(state),
    ]
    free = height - 7 - (len(settled) + 4 if settled else 0)
    if free >= 6:
        parts += [Text(), *_shaft(state, min(width - 2, 96), min(free - 3, 12))]
    if settled:
        parts += [Text(), settled_table(settled)]
    return Group(*parts)


def _title(state: Whole) -> Text:
    from rich.text import Text

    rig = state["rig"]
    simulated = f"  simulated {rig['parameters'] or 'rig'}" if rig["simulated"] else ""
    aim = "" if state["target_deg"] is None else f"{state['strategy']} to {state['target_deg']:g}°"
    return Text.assemble((aim, "bold"), (f"  {rig['name']}", "dim"), (simulated, "bold yellow"))


def _phase(state: Whole) -> Text:
    from rich.text import Text

    colour = _COLOURS.get(state["phase"], "white")
    name = f"{state['motion']} · {state['phase']}" if state["phase"] in _MOVING else state["phase"]
    return Text.assemble(("● ", colour), (f"{name:<24}", f"bold {colour}"), _waiting(state))


def _waiting(state: Whole) -> str:
    if not state["waiting_for"]:
        return ""
    left = state["remaining_s"]
    return f"waits for {state['waiting_for']}" + ("" if left is None else f", {left:.1f} s")


def _progress(state: Whole, width: int) -> RenderableType:
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    grid = Table.grid(padding=(0, 1))
    index, expected = state["motion_index"], state["motions_expected"]
    count = f"motion {min(index, expected)} of {expected}" if expected else ""
    bar = ProgressBar(total=1.0, completed=state["progress"], width=max(20, min(width - 26, 72)))
    grid.add_row(bar, f"{state['progress']:4.0%}", count)
    return grid


def _readings(state: Whole) -> RenderableType:
    from rich.table import Table
    from rich.text import Text

    grid = Table.grid(padding=(0, 3))
    sensors = state["sensors"]
    if sensors is None:
        return Text("no reading yet", "dim")
    names = ["base", "torque", *(f"hall {n}" for n in range(1, len(sensors["hall_deg"]) + 1))]
    values = [
        f"{_number(sensors['base_deg'], 2):>8}°",
        f"{_number(sensors['torque_nmm'], 4):>8} N·mm",
        *(f"{_number(angle, 1):>8}°" for angle in sensors["hall_deg"]),
    ]
    grid.add_row(*(Text(name, "dim", justify="right") for name in names))
    grid.add_row(*(Text(value, "bold", justify="right") for value in values))
    return grid


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _shaft(state: Whole, width: int, height: int) -> list[RenderableType]:
    """The angle along the shaft as measured: base on the left, tip on the right, tissue below."""
    from rich.text import Text

    sensors, rig = state["sensors"], state["rig"]
    if sensors is None:
        return []
    places = [0.0, *rig["hall_positions_mm"]]
    angles = [angle for angle in (sensors["base_deg"], *sensors["hall_deg"]) if angle is not None]
    if len(angles) < len(places):
        return []
    target = state["target_deg"] or 0.0
    low, high = _scale([*angles, target])
    columns = max(20, width - 8)
    length = rig["needle_length_mm"]
    rows = picture(places, angles, target, (low, high), length, columns, height)
    lines: list[RenderableType] = [Text(f"angle along the shaft: ● measured, ┄ target {target:g}°", "dim")]
    for index, row in enumerate(rows):
        label = {0: f"{high:.0f}°", len(rows) - 1: f"{low:.0f}°"}.get(index, "")
        line = Text.assemble((f"{label:>6} ", "dim"))
        for mark in row:
            line.append(mark, "dim green" if mark == "┄" else "bold yellow" if mark == "●" else "cyan")
        lines.append(line)
    ground = Text("       ")
    for column in range(columns):
        place = (column + 0.5) * length / columns
        inside = any(start <= place <= end for start, end in rig["tissue_sections_mm"])
        ground.append("▒" if inside else "─", "red" if inside else "dim")
    lines.append(ground)
    lines.append(Text(f"       {'base':<{columns - 3}}tip", "dim"))
    return lines


def _scale(values: Sequence[float]) -> tuple[float, float]:
    """Bounds in steps of 15°, so that the picture stands still while the needle turns."""
    low, high = min(values), max(values)
    low, high = 15.0 * (low // 15.0), 15.0 * -(-high // 15.0)
    return low, max(high, low + 15.0)


def picture(
    places_mm: Sequence[float],
    angles_deg: Sequence[float],
    target_deg: float,
    bounds_deg: tuple[float, float],
    length_mm: float,
    columns: int,
    rows: int,
) -> list[str]:
    """A line through the points in Braille dots (two by four a character), points as ●, the target as ┄.

    Top row first; each row has `columns` characters.
    """
    low, high = bounds_deg
    cells = [[0] * columns for _ in range(rows)]
    dots = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))

    def height(angle_deg: float) -> int:
        """Dot row from the top."""
        share = (high - angle_deg) / (high - low)
        return min(max(round(share * (rows * 4 - 1)), 0), rows * 4 - 1)

    last = None
    for x in range(2 * columns):
        place = (x + 0.5) * length_mm / (2 * columns)
        if place > places_mm[-1] + length_mm / columns:
            break
        y = height(_between(place, places_mm, angles_deg))
        for dot in range(min(y, y if last is None else last), max(y, y if last is None else last) + 1):
            cells[dot // 4][x // 2] |= dots[dot % 4][x % 2]
        last = y
    drawn = [[chr(0x2800 + cell) if cell else " " for cell in row] for row in cells]
    aim = height(target_deg) // 4
    drawn[aim] = ["┄" if mark == " " else mark for mark in drawn[aim]]
    for place, angle in zip(places_mm, angles_deg, strict=True):
        drawn[height(angle) // 4][min(int(place * columns / length_mm), columns - 1)] = "●"
    return ["".join(row) for row in drawn]


def _between(place: float, places: Sequence[float], angles: Sequence[float]) -> float:
    """Linear interpolation, constant beyond the ends."""
    for (x0, x1), (y0, y1) in zip(pairwise(places), pairwise(angles), strict=True):
        if place <= x1:
            return y0 + (y1 - y0) * max(0.0, place - x0) / (x1 - x0)
    return angles[-1]
