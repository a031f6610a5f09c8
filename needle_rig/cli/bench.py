"""`needle-rig bench`: a rig without a rig, its nodes running their own firmware."""

from __future__ import annotations

import contextlib
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._complete import completing

if TYPE_CHECKING:
    from needle_rig.simulation.bench.bench_lines import Said

_WORDS = """\
Words that it takes, a line each:
  status                                        how it goes
  torque|drive|hall|can  unplug|silence|garble|freeze|delay MS|restore
                                                let a link fail, or work again
  turn DEGREES                                  turn the base by hand while the drive is off
  weigh N.MM                                    hang a weight on the load cell; weigh 0 takes it off
Ctrl-C ends it."""


@click.command()
@click.option("--config", type=click.Path(), help="Rig file; default: config/rig.yaml, or the shipped one.")
@click.option("--image", is_flag=True, help="Run the Cortex-M images under an emulator, not the library.")
@click.option(
    "--parameters",
    shell_complete=completing("parameters"),
    help="Parameter set of the simulated needle, such as rig_rigid.",
)
@click.option("--seed", type=int, help="Seed of the plant's noise.")
@click.option("--errors", type=int, help="Give the sensors the errors of this number; 0: none.")
@click.option("--pages", type=click.Path(), help="Folder of calibration pages to flash into the nodes.")
@click.option("--free", is_flag=True, help="The needle out of the tissue, turning freely.")
@click.option(
    "--ports", type=click.Path(path_type=Path, file_okay=False), help="Where to put the port names."
)
@click.option("--can", "interface", help="Put the nodes on this CAN interface, such as vcan0, not on slcan.")
def command(
    config: str | None,
    image: bool,
    parameters: str | None,
    seed: int | None,
    errors: int | None,
    pages: str | None,
    free: bool,
    ports: Path | None,
    interface: str | None,
) -> None:
    """Run the plant behind the nodes' real firmware, on ports that a daemon opens like a rig's.

    The firmware is built when it was not built before (needs the extra `bench`). Another terminal drives it
    with the rig file that is printed at the start. Faults are typed in, as in `torque freeze`.
    """
    from needle_rig.config.loader import load_rig_config, rig_config_text
    from needle_rig.errors import BadInput
    from needle_rig.folders import temporary_folder
    from needle_rig.simulation.bench.bench_loop import BenchLoop, be_urgent
    from needle_rig.simulation.bench.process import PREFIX, with_ports
    from needle_rig.simulation.build import build_plant

    others = _other_devices(config)
    if others and (errors is not None or pages is not None):
        raise BadInput("--errors, --pages: are for our nodes' firmware, and the rig file names other devices")
    rig = load_rig_config(
        config,
        {
            "simulation.nodes": "image" if image else None if others else "firmware",
            "simulation.parameters": parameters,
            "simulation.seed": seed,
            "simulation.sensor_errors_seed": errors,
            "simulation.node_pages": pages,
            "simulation.free_needle": free or None,
        },
    )
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit(0))
    with contextlib.ExitStack() as stack:
        folder = ports or stack.enter_context(temporary_folder(PREFIX))
        folder.mkdir(parents=True, exist_ok=True)
        click.echo("building plant and firmware …", err=True)
        loop = BenchLoop(rig, build_plant(rig), folder, _tell, interface)
        stack.callback(loop.close)
        file = folder / "rig.yaml"
        kind = "slcan" if interface is None else "socketcan"
        file.write_text(rig_config_text(with_ports(rig, loop.ports, kind)), encoding="utf-8")
        stack.callback(file.unlink, missing_ok=True)
        click.echo(f"CAN ({kind})  {loop.ports['can']}\nHall link    {loop.ports['hall']}")
        if "torque" in loop.ports:
            click.echo(f"torque link  {loop.ports['torque']} (address, RDT port, HTTP port)")
        nodes = {"python": "in Python", "image": "Cortex-M images under the emulator"}
        assert rig.simulation is not None
        click.echo(f"nodes        {nodes.get(rig.simulation.nodes, 'firmware library')}")
        click.echo(f"drive it     needle-rig compensate --config {file} --target 45\n{_WORDS}")
        be_urgent()
        with contextlib.suppress(KeyboardInterrupt):
            loop.run(0, end_with_control=False)
        click.echo("bench ended")


def _other_devices(config: str | None) -> bool:
    """Whether the rig file names a device that is no node of this project, for which there is no firmware."""
    from needle_rig.config.loader import load_rig_config

    links = load_rig_config(config).links
    return any(section.device != "node" for section in (links.drive, links.torque, links.hall))


def _tell(what: Said) -> None:
    """What happens on the bench, for a person."""
    from needle_rig.records import DriveFault

    match what:
        case {"error": text}:
            click.echo(text)
        case {"event": "drive", "state": state, "faults": int(faults)}:
            names = (DriveFault(faults).name or "").lower().replace("_", " ").replace("|", ", ")
            click.echo(f"drive node: {state}{f' ({names})' if faults else ''}")
        case {"event": "command", "enable": enable, "clear": clear}:
            click.echo(
                f"host: {'enables the drive' if enable else 'clears' if clear else 'holds the drive off'}"
            )
        case {"event": "late", "late_s": late_s}:
            click.echo(f"this machine was away for {late_s:g} s; the bench's world stood still meanwhile")
        case {"event": "fault", "link": link, "fault": fault}:
            click.echo(f"{link}: {fault}")
        case {"event": "turn", "turn_deg": turn}:
            click.echo(f"base: turned by hand by {turn:g}°")
        case {"event": "weigh", "weight_nmm": weight}:
            click.echo(f"load cell: carries {weight:g} N·mm")
        case {"base_deg": base, "velocity_deg_s": velocity, "drive": drive, "faults": dict(faults)}:
            broken = ", ".join(f"{link} {fault}" for link, fault in faults.items()) or "none"
            click.echo(
                f"base {base:.3f}°, motor asked for {velocity:.2f}°/s, drive {drive}, link faults: {broken}, "
                f"CPU {what['cpu_s']:.1f} s of {what['plant_s']:.1f} s, behind {what['behind_s']:.2f} s"
            )
