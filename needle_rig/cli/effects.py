"""`needle-rig effects`: the library of effects, built-in and users' own."""

from __future__ import annotations

import inspect
import json
import sys
from typing import TYPE_CHECKING, get_args

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import effects_option
from needle_rig.errors import BadInput
from needle_rig.physics.machine import MACHINES, MachineName

if TYPE_CHECKING:
    from needle_rig.physics.effect import Effect, ParameterInfo
    from needle_rig.records import JsonObject


@click.command()
@click.argument("name", required=False, shell_complete=completing("effects"))
@click.option(
    "--machine",
    type=click.Choice(get_args(MachineName)),
    help="List those alone that fit it; without it all.",
)
@effects_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def command(name: str | None, machine: MachineName | None, effects: tuple[str, ...], as_json: bool) -> int:
    """List the effects, or show one: its law, source, parameters, units and ranges.

    Your own files are checked while they are listed. A broken one is named with its line after the others.

    \b
    Exit codes: 0 every file can be used, 2 one is broken.
    """
    from needle_rig.model import effect_directories
    from needle_rig.physics.compiled import compiled_torque
    from needle_rig.physics.effect_text import effect_called
    from needle_rig.physics.library import built_in_effects, find_effects
    from needle_rig.physics.machine import fitting

    library = find_effects(effect_directories(effects))
    for key, effect in list(library.items()):
        try:
            if key not in built_in_effects() and effect.has("torque"):
                compiled_torque(effect)
        except BadInput as error:
            del library[key]
            library.broken.append((key, str(error)))
    if name:
        chosen = effect_called(name, library)
        if as_json:
            _print(_described(chosen, own=name not in built_in_effects()))
        else:
            _show(chosen)
        return 0
    shown = library if machine is None else fitting(library, machine)
    if as_json:
        found = [_described(effect, own=key not in built_in_effects()) for key, effect in shown.items()]
        _print({"effects": found, "broken": [sentence for _, sentence in library.broken]})
    else:
        width = max(map(len, shown))
        for key, effect in shown.items():
            own = "" if key in built_in_effects() else " (your own)"
            click.echo(f"{click.style(key.ljust(width), bold=True)}  {_text(effect).splitlines()[0]}{own}")
        click.echo("\nneedle-rig effects NAME shows the law, its source and the parameters.")
    for _, sentence in library.broken:
        click.echo(sentence, err=True)
    return BadInput.exit_code if library.broken else 0


def _print(told: JsonObject) -> None:
    click.echo(json.dumps(told, indent=2, ensure_ascii=False))


def _show(effect: type[Effect]) -> None:
    click.echo(f"{click.style(effect.name(), bold=True)}: {_text(effect)}\n")
    for field, info in effect.parameters().items():
        each = "" if info.per == "one" else f", one for each {info.per} or one for all"
        click.echo(f"  {field}: {info.unit}{each}")
        if info.shapes:
            click.echo(f"      gives form only; typical {info.typical:g}")
        else:
            click.echo(f"      off {info.off:g}, typical {info.typical:g}, matters from {info.smallest:g}")
        low, high = info.literature
        click.echo(f"      allowed {info.lower:g} to {info.upper:g}, literature {low:g} to {high:g}")
    if effect.part:
        having = [name for name, machine in MACHINES.items() if effect.part in machine.parts]
        click.echo(f"  acts in: {effect.part} (of a {', '.join(having) or 'machine that no layout names'})")
    if effect.relatives:
        click.echo(f"  looks like: {', '.join(effect.relatives)}")
    if effect.redundant_with:
        click.echo(f"  cannot be told apart from: {', '.join(effect.redundant_with)}")
    for other, values in effect.limits.items():
        at = ", ".join(f"{field} = {value:g}" for field, value in values.items())
        click.echo(f"  becomes {other} at {at}")
    click.echo(f"  hooks: {', '.join(effect.hooks())}")
    click.echo(f"  file: {inspect.getsourcefile(effect)}")


def _described(effect: type[Effect], *, own: bool) -> JsonObject:
    return {
        "name": effect.name(),
        "text": _text(effect),
        "parameters": [_parameter(field, info) for field, info in effect.parameters().items()],
        "part": effect.part,
        "hooks": effect.hooks(),
        "relatives": list(effect.relatives),
        "redundant_with": list(effect.redundant_with),
        "limits": effect.limits,
        "resistive": effect.resistive,
        "own": own,
    }


def _parameter(field: str, info: ParameterInfo) -> JsonObject:
    from dataclasses import asdict
    from math import isfinite

    # JSON has no infinity, and no function: which places are tried hangs on the series
    told = asdict(info) | {"places": info.places is not None}
    return {"name": field} | {
        key: value if not isinstance(value, float) or isfinite(value) else str(value)
        for key, value in told.items()
    }


def _text(effect: type[Effect]) -> str:
    return inspect.getdoc(sys.modules[effect.__module__]) or ""
