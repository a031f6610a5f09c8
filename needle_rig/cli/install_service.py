"""`needle-rig install-service`: sets up the service of a real rig on this computer, or takes it away."""

from __future__ import annotations

import os
import pwd
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.service.installed.installation import Installation
    from needle_rig.service.setup.install import Wanted
    from needle_rig.service.setup.steps import Step

_A_PORT = "/dev/serial/by-id/…"
"""Shown by a dry run where no adapter is plugged in."""
_CAN_INTERFACE = "280"
"""ARPHRD_CAN of linux/if_arp.h."""


@click.command()
@click.option("--name", help="The rig's name.")
@click.option("--can", help="CAN interface, such as can0, or the device of an slcan adapter.")
@click.option("--bitrate", "bitrate_kbit_s", type=click.IntRange(10, 1000), help="Of the CAN bus, kbit/s.")
@click.option("--hall", "hall_port", help="Serial port of the Hall node, best under /dev/serial/by-id.")
@click.option("--length", "length_mm", type=float, help="The needle's length, mm.")
@click.option("--diameter", "diameter_mm", type=float, help="The needle's diameter, mm.")
@click.option("--shear-modulus", "shear_modulus_gpa", type=float, help="The needle's shear modulus, GPa.")
@click.option("--rig-file", type=click.Path(path_type=Path), help="A rig file that is taken as it is.")
@click.option(
    "--member", "members", multiple=True, help="User who may use the rig.  [default: who calls sudo]"
)
@click.option("--start/--no-start", default=True, help="Start the service at once.")
@click.option("--upgrade", metavar="WHEEL|VERSION", help="Let the service run another version.")
@click.option("--rollback", is_flag=True, help="Let it run the version before the last upgrade.")
@click.option("--remove", is_flag=True, help="Take the service away; the runs stay.")
@click.option("--dry-run", is_flag=True, help="Show what would be done, and do nothing.")
@click.option("--root", type=click.Path(path_type=Path), default=Path("/"), hidden=True)
def command(
    name: str | None,
    can: str | None,
    bitrate_kbit_s: int | None,
    hall_port: str | None,
    length_mm: float | None,
    diameter_mm: float | None,
    shear_modulus_gpa: float | None,
    rig_file: Path | None,
    members: tuple[str, ...],
    start: bool,
    upgrade: str | None,
    rollback: bool,
    remove: bool,
    dry_run: bool,
    root: Path,
) -> None:
    """Set up the service that owns a real rig: user, group, rig file, rules for ports, CAN bus and unit.

    What is not given as an option is asked for. A rig file that is there already is kept as it is; a second
    call changes nothing. Members of the group needle-rig may use the rig. --remove keeps the runs in
    /var/lib/needle-rig, and the rig file as /etc/needle-rig/rig.yaml.removed.

    --upgrade installs a version beside the present one, backs the rig up, switches, and restarts at rest. It
    goes back by itself where `check` then finds more that fails than before.

    \b
    Exit codes: 0 done, 2 bad use, nothing was changed, 3 it failed; an upgrade was taken back.
    """
    from needle_rig.config.loader import load_rig_config
    from needle_rig.recording.retention import kept_text
    from needle_rig.service.installed.installation import Installation
    from needle_rig.service.setup.install import (
        another_program,
        install_steps,
        is_active,
        refuse_unable,
        removal_steps,
        stays,
    )

    place = Installation(root.absolute())
    if place.root == Path("/") and not dry_run:
        refuse_unable(os.geteuid())
    if upgrade is not None or rollback:
        from needle_rig.service.setup import upgrade as versions

        if dry_run or remove or (upgrade is not None and rollback):
            raise BadInput("--upgrade and --rollback stand alone, without --dry-run and --remove")
        if upgrade is not None:
            versions.upgrade(place, upgrade, click.echo)
        else:
            versions.roll_back(place, click.echo)
        return
    if remove:
        _carry_out(removal_steps(place), dry_run)
        click.echo("\n".join(["Nothing was done."] if dry_run else stays(place)))
        return
    if place.rig_file.exists():
        wanted = _as_it_is(place, place.rig_file, members, start, dry_run)
    elif rig_file is not None:
        wanted = _as_it_is(place, rig_file, members, start, dry_run)
    else:
        wanted = _asked(
            place,
            members,
            start,
            dry_run,
            name=name,
            can=can,
            bitrate_kbit_s=bitrate_kbit_s,
            hall_port=hall_port,
            length_mm=length_mm,
            diameter_mm=diameter_mm,
            shear_modulus_gpa=shear_modulus_gpa,
        )
    steps = install_steps(place, wanted)
    if all(step.is_done() for step in steps):
        click.echo("The service is set up already; nothing was changed.")
        _tell_another(another_program(place, wanted.program))
        return
    running = place.root == Path("/") and is_active()
    _carry_out(steps, dry_run)
    if dry_run:
        click.echo("Nothing was done.")
        return
    if running:
        click.echo("It runs with what it had; when no run goes on: sudo systemctl restart needle-rig")
    _tell_another(another_program(place, wanted.program))
    click.echo("The service is set up. Look at it: needle-rig status; at the rig: needle-rig check")
    recording = load_rig_config(place.rig_file).recording
    kept = kept_text(recording.keep_days, recording.keep_gb)
    click.echo(f"{kept[0].upper()}{kept[1:]}.")
    for member in wanted.members:
        click.echo(f"{member} may use it after logging in again (group needle-rig).")


def _tell_another(told: str | None) -> None:
    if told is not None:
        click.echo(f"warning: {told}", err=True)


def _carry_out(steps: list[Step], dry_run: bool) -> None:
    for step in steps:
        if step.is_done():
            continue
        told = step.describe()
        click.echo(told.rstrip() if dry_run else told.splitlines()[0])
        if not dry_run:
            step.do()


def _as_it_is(
    place: Installation, rig_file: Path, members: tuple[str, ...], start: bool, dry_run: bool
) -> Wanted:
    """The service of a rig file that is there."""
    from needle_rig.config.loader import load_rig_config
    from needle_rig.config.schema import NetFtTorque
    from needle_rig.service.setup.install import Wanted

    links = load_rig_config(rig_file).links
    can = links.can
    interface = can.channel if can.interface == "socketcan" else None
    return Wanted(
        rig_file.read_text(encoding="utf-8"),
        interface,
        can.bitrate_kbit_s,
        _members(place, members),
        _program(place, dry_run),
        start,
        links.torque.address if isinstance(links.torque, NetFtTorque) else None,
    )


def _asked(
    place: Installation,
    members: tuple[str, ...],
    start: bool,
    dry_run: bool,
    **given: str | float | None,
) -> Wanted:
    """The service of a rig file made of the options, and of answers where they are missing."""
    from needle_rig.config.files import shipped_file
    from needle_rig.config.loader import load_rig_config
    from needle_rig.service.setup.install import Wanted
    from needle_rig.service.setup.rig_file import Answers, keep_gb, rig_file_text

    usual = load_rig_config(shipped_file("rig.hardware.yaml"))
    proposed: dict[str, tuple[str, str | float | None]] = {
        "name": ("The rig's name", usual.name),
        "can": ("CAN interface, or device of an slcan adapter", _only(_can_interfaces()) or "can0"),
        "bitrate_kbit_s": ("Bit rate of the CAN bus, kbit/s", 1000),
        "hall_port": (
            "Serial port of the Hall node",
            _only(_serial_ports()) or (_A_PORT if dry_run else None),
        ),
        "length_mm": ("The needle's length, mm", usual.needle.length_mm),
        "diameter_mm": ("The needle's diameter, mm", usual.needle.diameter_mm),
        "shear_modulus_gpa": ("The needle's shear modulus, GPa", usual.needle.shear_modulus_gpa),
    }
    found = {key: _answer(key, text, given[key], default) for key, (text, default) in proposed.items()}
    answers = Answers(**found, keep_gb=keep_gb(place.runs))  # type: ignore[arg-type]  # each as click gave it
    text = rig_file_text(answers, Path("/var/lib/needle-rig"))
    interface = answers.network_interface
    return Wanted(
        text, interface, answers.bitrate_kbit_s, _members(place, members), _program(place, dry_run), start
    )


def _answer(key: str, text: str, given: str | float | None, default: str | float | None) -> str | float:
    if given is not None:
        return given
    if sys.stdin.isatty():
        answer: str | float = click.prompt(text, default=default)
        return answer
    if default is None:
        option = "--" + key.partition("_")[0]
        raise BadInput(f"{option} is missing: {text.lower()}; ls /dev/serial/by-id shows what is there")
    return default


def _only(found: list[str]) -> str | None:
    return found[0] if len(found) == 1 else None


def _can_interfaces() -> list[str]:
    types = Path("/sys/class/net").glob("*/type")
    return sorted(each.parent.name for each in types if each.read_text().strip() == _CAN_INTERFACE)


def _serial_ports() -> list[str]:
    return sorted(map(str, Path("/dev/serial/by-id").glob("*")))


def _members(place: Installation, named: tuple[str, ...]) -> tuple[str, ...]:
    """Who shall be in the group; who calls sudo where nobody is named."""
    caller = os.environ.get("SUDO_USER")
    members = named or ((caller,) if caller and caller != "root" else ())
    for member in members:
        if place.root == Path("/"):
            try:
                pwd.getpwnam(member)
            except KeyError:
                raise BadInput(
                    f"--member {member}: there is no such user; make it with: adduser {member}"
                ) from None
    return members


def _program(place: Installation, dry_run: bool) -> Path:
    """What the service runs; a dry run shows the usual one where this one could not be run."""
    from needle_rig.service.setup.install import installed_program

    usual = Path("/opt/needle-rig/bin/needle-rig")
    if place.root != Path("/"):
        return usual
    try:
        return installed_program()
    except BadInput as error:
        if not dry_run:
            raise
        click.echo(f"note: {error}", err=True)
        return usual
