"""`needle-rig check-device`: holds a device to what every device must do."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from needle_rig.config.schema import Section
    from needle_rig.devices.device import Device, Twin


@click.command()
@click.argument("device")
@click.argument("options", nargs=-1, metavar="[KEY=VALUE]...")
@click.option("--json", "as_json", is_flag=True, help="Print the clauses as one JSON object.")
def command(device: str, options: tuple[str, ...], as_json: bool) -> int:
    """Hold DEVICE, a file or a name of config/devices, to the contract of devices.

    It runs against its own twin (`simulated`), without ports and in a time of its own: silence, noise, frozen
    messages, restarts, a lost host. KEY=VALUE are its options as in the rig file. The shipped devices are
    cia402, netft and text.

    \b
    Exit codes: 0 every clause is kept, 1 one is not, 2 bad use.
    """
    from needle_rig.devices.contract import check_device

    made, section, make_twin = _found(device, options)
    clauses = []
    for clause in check_device(made, section, make_twin):
        clauses.append(clause)
        if not as_json:
            told = "ok  " if clause.broken is None else "fail"
            click.echo(f"{told}  {clause.name}{': ' + clause.broken if clause.broken else ''}")
    broken = sum(clause.broken is not None for clause in clauses)
    if as_json:
        kept = [dataclasses.asdict(clause) for clause in clauses]
        click.echo(json.dumps({"device": device, "broken": broken, "clauses": kept}, ensure_ascii=False))
    else:
        click.echo(f"{len(clauses) - broken} of {len(clauses)} clauses are kept")
    return 1 if broken else 0


def _found(name: str, given: tuple[str, ...]) -> tuple[type[Device], Section, Callable[[], Twin]]:
    """The device, its options and what makes its twin. Raises BadInput."""
    from needle_rig.config.check import validate
    from needle_rig.config.places import Places, parse_yaml
    from needle_rig.devices.library import (
        SHIPPED,
        device_in,
        errors_told,
        load_device,
        named_source,
        shipped_device,
    )
    from needle_rig.errors import BadInput
    from needle_rig.simulation.nodes.twins import TWINS

    values: dict[str, Any] = {}
    for text in given:
        key, equals, value = text.partition("=")
        if not equals:
            raise BadInput(f"{text!r} is no KEY=VALUE; write it as in port=/dev/ttyUSB0")
        values |= parse_yaml(f"{key}: {value}", text)[0]
    kind = next((kind for kind, word in SHIPPED if word == name and word != "node"), None)
    if kind is None:
        if name.endswith(".py"):
            path, made = Path(name), load_device(Path(name))
        else:
            source = named_source(name)
            path, made = source.path, device_in(source.module(), source.path)
        with errors_told(str(path)):
            section = validate(made.Options, values, Places(name))
            twin = made.simulated(section)
        if twin is None:
            raise BadInput(
                f"{path}: {made.__name__} has no twin to be tried against; give it a classmethod `simulated`"
            )
        return made, section, lambda: _made_by(made, section)
    made = shipped_device(kind, name)
    section = validate(made.Options, {"device": name, **values}, Places(name))
    return made, section, lambda: TWINS[name](section)


def _made_by(made: type[Device], section: Section) -> Twin:
    twin = made.simulated(section)
    assert twin is not None
    return twin
