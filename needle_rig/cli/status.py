"""`needle-rig status`: what the running daemon says of itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._motion import socket_option

if TYPE_CHECKING:
    from needle_rig.service.api.documents import Sensors, State


@click.command()
@socket_option
@click.option("--json", "as_json", is_flag=True, help="Print the whole state as one JSON object.")
def command(socket: Path | None, as_json: bool) -> None:
    """Show where the running daemon stands: phase, sensors, drive, and how well its ticks keep time."""
    from needle_rig.service.client import the_daemon

    client = the_daemon(socket)
    state = client.state()
    click.echo(json.dumps(state) if as_json else _text(state, str(client.path)))


def _text(state: State, path: str) -> str:
    from needle_rig.cli._live import phase_line
    from needle_rig.cli._output import number
    from needle_rig.recording.watch_summary import read_summary
    from needle_rig.version import differs

    rig, ticks, sensors = state["rig"], state["ticks"], state["sensors"]
    different = differs(state.get("version"))
    simulated = f", simulated {rig['parameters'] or ''}".rstrip() if rig["simulated"] else ""
    phase = "starting" if state["starting"] else phase_line(state).strip()
    lines = [
        f"rig:     {rig['name']}{simulated}, on {path}",
        f"version: {state.get('version') or 'not told'}",
        *(f"node:    {link} {node['text']}" for link, node in state.get("firmware", {}).items()),
        f"since:   {state['since_utc']}",
        f"phase:   {phase}",
    ]
    if sensors:
        halls = " ".join(f"{number(angle, 1)}°" for angle in sensors["hall_deg"])
        ages = ", ".join(f"{name} {number(age, 1)} ms" for name, age in _ages(sensors))
        faults = f" ({', '.join(sensors['drive_faults'])})" if sensors["drive_faults"] else ""
        lines += [
            f"base:    {number(sensors['base_deg'], 2)}°",
            f"torque:  {number(sensors['torque_nmm'], 4)} N·mm",
            f"hall:    {halls}",
            f"ages:    {ages}",
            f"drive:   {sensors['drive_state']}{faults}{'' if sensors['supply_on'] else ', no supply'}",
        ]
    if ticks:
        lines.append(
            f"ticks:   {ticks['count']} at {rig['tick_hz']:g} Hz, {ticks['missed']} missed; late by "
            f"{number(ticks['late_p50_ms'], 2)} ms (half), {number(ticks['late_p99_ms'], 2)} ms (99 %), "
            f"{number(ticks['late_max_ms'], 2)} ms at most"
        )
    if state["lease"]:
        lines.append(f"lease:   {state['lease']}")
    if state["run"]:
        lines.append(f"run:     {state['run']}")
    if state.get("model"):
        lines.append(f"model:   {state['model']}")
    if state["fault"]:
        lines.append(f"fault:   {state['fault']}")
    lines += [f"waits:   {each}" for each in waits_for_a_person(state)]
    if state["last"]:
        lines.append(f"last:    {state['last']['text']}")
    if state["before"]:
        lines.append(f"before:  {state['before']}")
    lines += [
        f"cut off: {run['text'] or run['run']} (found {run['found_utc']})" for run in state["unfinished"]
    ]
    lines += [f"watch:   {sentence}" for sentence in read_summary(Path(state["runs"]))]
    lines += [f"warning: {warning}" for warning in (*state["warnings"], *filter(None, [different]))]
    return "\n".join(lines)


def _ages(sensors: Sensors) -> tuple[tuple[str, float | None], ...]:
    ages_ms = sensors["age_ms"]
    return ("torque", ages_ms["torque"]), ("hall", ages_ms["hall"]), ("drive", ages_ms["drive"])


def waits_for_a_person(state: State) -> list[str]:
    """What goes on only when a person does something, and what that is."""
    said = []
    sensors = state["sensors"]
    heard = sensors is not None and sensors["age_ms"]["drive"] is not None
    if sensors is not None and sensors["emergency_stop"]:
        said.append("the emergency stop is pressed: release it")
    if sensors is not None and heard and not sensors["referenced"]:
        said.append("the drive's zero is not known: needle-rig home --by hall")
    if state["latched"]:
        said.append("a fault that stays until it is cleared: needle-rig clear")
    if state["released"]:
        said.append("the base is released: needle-rig clear, or any motion")
    return said
