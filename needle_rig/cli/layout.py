"""needle-rig layout: what was understood of a shaft that somebody described by hand."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._pictures import picture_option


@click.command("layout")
@click.argument("file", type=click.Path(path_type=Path), metavar="FILE")
@picture_option("--png", type=click.Path(path_type=Path, dir_okay=False), help="Draw it to this file.")
def command(file: Path, png: Path | None) -> None:
    """Say, and draw, what was understood of a layout: a YAML file with the keys of `rig`, a rig file or a
    dataset.

    \b
    needle-rig layout shaft.yaml --png shaft.png
    """
    from needle_rig.config.places import Places
    from needle_rig.dataset.description import layout_of, needle_of
    from needle_rig.importing.shaft import read_rig
    from needle_rig.units import mm

    rig = read_rig(file)
    layout, needle = layout_of(rig, Places(str(file))), needle_of(rig.needle)
    names = [sensor.name for sensor in rig.hall_sensors]
    rigidity_nmm2 = needle.torsional_rigidity_nm2 * 1e6
    if needle.rigidity_is_known:
        known = f"torsional rigidity {rigidity_nmm2:.4g} N·mm² ± {100 * needle.rigidity_sigma:g} %"
    else:
        known = "torsional rigidity unknown, to be learnt"
    click.echo(f"shaft: 0 to {mm(layout.needle_length_m):g} mm, {known}")
    for start, end, relative in layout.segments:
        click.echo(
            f"segment: {mm(start):g} to {mm(end):g} mm, {relative:.3g} times as rigid"
            f" ({relative * rigidity_nmm2:.4g} N·mm²)"
        )
    for start, end in layout.tissue_sections_m:
        click.echo(f"friction along: {mm(start):g} to {mm(end):g} mm")
    for name, place in zip(names, layout.sensor_positions_m, strict=True):
        click.echo(f"{name}: at {mm(place):g} mm")
    if layout.tip_clamped:
        click.echo("the tip is clamped")
    if png is not None:
        from needle_rig.figures.layout import draw_layout

        click.echo(f"wrote {draw_layout(layout, names, file.name, png)}", err=True)
