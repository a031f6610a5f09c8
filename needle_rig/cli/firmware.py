"""`needle-rig firmware`: builds the nodes' images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from needle_rig.firmware.build import Image


@click.group()
def command() -> None:
    """The nodes' firmware (needs the extra `bench`)."""


@command.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("build/firmware"),
    show_default=True,
)
@click.option("--measure", is_flag=True, help="Run each image: its longest tick and deepest stack.")
def build(out: Path, measure: bool) -> None:
    """Build torque, hall and drive (.elf, .hex) for the STM32F405, and the same nodes as a library."""
    from needle_rig.firmware.build import build as build_images
    from needle_rig.firmware.sources import firmware_folder, source_build
    from needle_rig.version import VERSION

    click.echo(f"The nodes say: {VERSION}, build {source_build(firmware_folder()):06x}.")
    click.echo(f"{'image':<14}{'text':>8}{'data':>8}{'bss':>8}{'flash':>8}{'RAM':>8}  bytes")
    images: list[Image] = []
    for image in build_images(out):
        sizes = (
            f"{image.text:>8}{image.data:>8}{image.bss:>8}{image.flash:>8}{image.ram:>8}"
            if image.text
            else ""
        )
        click.echo(f"{image.name:<14}{sizes or ' ' * 40}  {image.path}")
        if image.text:
            images.append(image)
    if measure:
        _measure(images)


def _measure(images: list[Image]) -> None:
    from needle_rig.config.files import find_config_file
    from needle_rig.firmware.measure import CORE_HZ, measure
    from needle_rig.wire.can_frames import CanCodec

    codec = CanCodec(find_config_file("needle_rig.dbc"))
    click.echo(f"\n{'image':<14}{'longest tick':>14}{'at 168 MHz':>12}{'stack':>8}{'RAM in all':>12}")
    for image in images:
        load = measure(image, codec)
        micros = f"{load.instructions / CORE_HZ * 1e6:.0f} µs"
        ram = image.ram + load.stack
        click.echo(f"{image.name:<14}{load.instructions:>14}{micros:>12}{load.stack:>8}{ram:>12}")
    click.echo("Ticks in instructions; the time is that of one instruction a cycle. Stack and RAM in bytes.")
