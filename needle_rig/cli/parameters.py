"""`needle-rig parameters`: the published parameter sets, what they reproduce and what they do not."""

from __future__ import annotations

import json
from pathlib import Path

import click

from needle_rig.cli._complete import completing


@click.command()
@click.argument("name", shell_complete=completing("parameters"), required=False)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def command(name: str | None, as_json: bool) -> None:
    """List the parameter sets, or show one (NAME, or the path of a file).

    Sets are the files of config/parameters in the working folder, then those that come with needle-rig.
    """
    from needle_rig.model import load_parameter_set, parameter_sets, parameters_path

    paths = {name: parameters_path(name)} if name else parameter_sets()
    sets = {key: load_parameter_set(path) for key, path in paths.items()}
    if as_json:
        found = [{**s.model_dump(mode="json"), "file": _shown(paths[key])} for key, s in sets.items()]
        click.echo(json.dumps(found[0] if name else {"parameters": found}, indent=2, ensure_ascii=False))
        return
    for key, found_set in sets.items():
        click.echo(f"{click.style(found_set.name, bold=True)}: {found_set.title}")
        for line in _numbers(found_set):
            click.echo(f"    {line}")
        if name:
            click.echo(f"  source: {found_set.source}")
            for heading, lines in (
                ("reproduces", found_set.reproduces),
                ("does not reproduce", found_set.does_not_reproduce),
            ):
                click.echo(f"  {heading}:")
                for line in lines:
                    click.echo(f"    - {line}")
            click.echo(f"  file: {_shown(paths[key])}")
    if not name:
        click.echo("\nneedle-rig parameters NAME shows source, what a set reproduces and what it does not.")


def _numbers(found: object) -> list[str]:
    """One line for each number of a set, with its unit."""
    from needle_rig.model import ParameterSet

    assert isinstance(found, ParameterSet)
    lines = [f"torsional rigidity JG {found.torsional_rigidity_nmm2:g} N·mm²"]
    if found.friction_nmm_per_100mm is not None:
        lines.append(f"Coulomb friction {found.friction_nmm_per_100mm:g} N·mm per 100 mm")
    if found.karnopp is not None:
        lines.append(
            f"Karnopp friction: static {found.karnopp.static_nmm_per_100mm:g} N·mm, damping"
            f" {found.karnopp.damping_nmms_per_rad_per_100mm:g} N·mm·s/rad per 100 mm (solver {found.solver})"
        )
    for effect, values in found.effects.items():
        lines += [f"{effect}.{field} = {value}" for field, value in values.items()]
    return lines


def _shown(path: Path) -> str:
    from needle_rig.config.places import show_path

    return show_path(path)
