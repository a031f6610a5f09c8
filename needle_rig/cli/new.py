"""`needle-rig new`: writes a commented, valid file to start one's own thing from."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import click

from needle_rig.errors import BadInput

NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
"""What orders, model files and Python modules can all say."""


@dataclass(frozen=True)
class Kind:
    """Where a new thing goes, what it is a copy of below the shipped `config/`, and how it is tried."""

    place: str
    template: str
    trial: str


KINDS = {
    "effect": Kind("config/effects/{name}.py", "new/effect.py", "needle-rig effects {name}"),
    "strategy": Kind(
        "config/strategies/{name}.py",
        "new/strategy.py",
        "needle-rig compensate --fast --target 45 --strategy {name}",
    ),
    "device": Kind(
        "config/devices/{name}.py", "new/device.py", "needle-rig check-device {name} port=/dev/ttyUSB0"
    ),
    "dataset": Kind("config/datasets/{name}", "new/dataset", "needle-rig compare {name}"),
    "rig": Kind("config/{name}.yaml", "rig.hardware.yaml", "needle-rig layout config/{name}.yaml"),
}


@click.command("new")
@click.argument("kind", type=click.Choice(list(KINDS)))
@click.argument("name")
def command(kind: str, name: str) -> None:
    """Write a commented file to start from: an effect, a strategy, a device, a dataset or a rig file.

    It goes to config/ of the working folder, where every command finds it by NAME; nothing is overwritten.
    It can be used as it is, and the command that tries it is printed.

    \b
    needle-rig new effect my_spring
    needle-rig new strategy my_lag
    """
    from needle_rig.config.files import shipped_file

    if not NAME.fullmatch(name):
        raise BadInput(f"{name}: is no name for a file; use a to z, 0 to 9 and _, a letter first")
    made = KINDS[kind]
    path, template = Path(made.place.format(name=name)), shipped_file(made.template)
    if kind in _TAKEN and name in _TAKEN[kind]():
        raise BadInput(f"{name}: the name is taken by a shipped {kind}; choose another")
    pairs = [(template, path)]
    if template.is_dir():
        files = sorted(file for file in template.rglob("*") if file.is_file())
        pairs = [(file, path / file.relative_to(template)) for file in files]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for source, target in pairs:
            target.parent.mkdir(parents=True, exist_ok=True)
            with target.open("x", encoding="utf-8") as file:
                file.write(_named(source.read_text(encoding="utf-8"), name))
    except FileExistsError:
        raise BadInput(f"{path}: is there already; choose another name, or move it away") from None
    click.echo(f"wrote {path}; try it: {made.trial.format(name=name)}")


def _named(text: str, name: str) -> str:
    """A template with the thing's name, and the class named after it."""
    return text.replace("MY_NAME", name).replace("MyThing", "".join(map(str.capitalize, name.split("_"))))


def _effects() -> set[str]:
    from needle_rig.physics.library import built_in_effects

    return set(built_in_effects())


def _strategies() -> set[str]:
    from needle_rig.control.strategy import shipped_strategies

    return set(shipped_strategies())


def _devices() -> set[str]:
    from needle_rig.devices.library import SHIPPED

    return {word for _, word in SHIPPED}


_TAKEN = {"effect": _effects, "strategy": _strategies, "device": _devices}
"""Names that a thing of one's own may not have."""
