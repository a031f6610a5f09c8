"""The steps that set up the service of a rig, and those that take it away."""

from __future__ import annotations

import functools
import ipaddress
import os
import re
import sys
from dataclasses import dataclass
from pathlib import Path

from needle_rig.config.files import shipped_file
from needle_rig.errors import BadInput
from needle_rig.extras import install_arguments, install_command
from needle_rig.service.installed.installation import Installation
from needle_rig.service.installed.systemd import FAILED_UNIT, UNIT
from needle_rig.service.setup.steps import (
    AwaitProcesses,
    LeaveToAll,
    MakeLink,
    Remove,
    RemoveFolder,
    Rename,
    Run,
    Step,
    WriteFile,
    links_to,
)

ACCOUNT = "needle-rig"
"""The service's user, and the group whose members may use its rig."""
_IN_UNIT = "/opt/needle-rig/bin"
_FAMILIES = "RestrictAddressFamilies=AF_UNIX AF_CAN AF_NETLINK"
_NO_NETWORK = "IPAddressDeny=any"

_UDEV_RULES = """\
# Serial adapters of the rig's nodes: for the group dialout, and FTDI's do not hold bytes back for 16 ms
SUBSYSTEM=="tty", SUBSYSTEMS=="usb", KERNEL=="ttyACM[0-9]*|ttyUSB[0-9]*", GROUP="dialout", MODE="0660"
ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"
"""
_PLUGGED_IN = ["udevadm", "trigger", "--action=add", "--subsystem-match=tty", "--subsystem-match=usb-serial"]
_NETWORK = """\
# Brought up whenever the adapter is there; back on the bus 100 ms after a bus-off
[Match]
Name={interface}

[Link]
RequiredForOnline=no

[CAN]
BitRate={bit_s}
RestartSec=100ms
"""
_UNMANAGED = """\
# systemd-networkd brings this bus up; NetworkManager leaves it alone
[keyfile]
unmanaged-devices+=interface-name:{interface}
"""
_VIRTUAL_NETWORK = """\
[Match]
Name={interface}

[Link]
RequiredForOnline=no
"""
_VIRTUAL_DEVICE = """\
# A bus without wires, for a simulated rig: needle-rig bench --can {interface}
[NetDev]
Name={interface}
Kind=vcan
"""


@dataclass(frozen=True)
class Wanted:
    """What the service shall be: the text of its rig file, who may use it, and what it is run with."""

    rig_file: str
    network_interface: str | None
    bitrate_kbit_s: int
    members: tuple[str, ...]
    program: Path
    """Of the installed needle-rig."""
    start: bool = True
    sensor_address: str | None = None
    """IP address of a sensor on the network; None where there is none."""


def install_steps(place: Installation, wanted: Wanted) -> list[Step]:
    """The steps in order. Those that only a running system can take are left out below another root."""
    live = place.root == Path("/")
    steps: list[Step] = [
        WriteFile(place.sysusers, _sysusers(place, wanted.members)),
        Run(
            ["systemd-sysusers", *_at(place), place.sysusers.name],
            functools.partial(_has_accounts, place, wanted.members),
        ),
    ]
    if not place.rig_file.exists():
        steps.append(WriteFile(place.rig_file, wanted.rig_file))
    # also for the adapters that are plugged in already
    reload = ["udevadm", "control", "--reload"]
    steps += _changed(WriteFile(place.udev_rules, _UDEV_RULES), live, reload, _PLUGGED_IN)
    if wanted.network_interface is not None:
        steps += _network_steps(place, wanted.network_interface, wanted.bitrate_kbit_s, live)
    steps.append(MakeLink(place.link, wanted.program, place.program))
    units = (
        WriteFile(place.failed_unit, _shipped_unit(FAILED_UNIT)),
        WriteFile(place.unit, unit_text(wanted.program, wanted.sensor_address)),
    )
    changed = not all(unit.is_done() for unit in units)
    steps += units
    if live and changed:
        steps.append(Run(["systemctl", "daemon-reload"], lambda: False))
    steps.append(Run(["systemctl", *_at(place), "enable", UNIT], functools.partial(_is_enabled, place, UNIT)))
    if live and wanted.start:
        steps.append(Run(["systemctl", "start", "--no-block", UNIT], is_active))
    return steps


def stays(place: Installation) -> list[str]:
    """What remains when the service was taken away, a sentence each."""
    told = []
    if place.runs.exists():
        told.append(f"The runs stay in {place.runs}; they are root's, and readable for everybody.")
    if place.rig_file.parent.exists():
        told.append(f"Rig file, calibration and models stay in {place.rig_file.parent}.")
    if os.path.lexists(place.link):
        told.append(f"{place.link} stays: it is not the service's.")
    return told


def another_program(place: Installation, program: Path) -> str | None:
    """That the command which people type is not the service's program; None where it is."""
    if not os.path.lexists(place.link) or links_to(place.link, program):
        return None
    return (
        f"{place.link} was not made by this service and stays, while the service runs {program};"
        f" for one version of both: ln -sfn {program} {place.link}"
    )


def removal_steps(place: Installation) -> list[Step]:
    """What takes the service away: all but the runs, and the rig file under another name."""
    live = place.root == Path("/")
    steps: list[Step] = []
    if live:
        steps += [
            Run(["systemctl", "stop", unit], functools.partial(_rests, unit)) for unit in (UNIT, FAILED_UNIT)
        ]
    enabled = functools.partial(_is_enabled, place, UNIT)
    steps.append(Run(["systemctl", *_at(place), "disable", UNIT], lambda: not enabled()))
    if links_to(place.link, place.program):  # before the unit, which tells that it is ours
        steps.append(Remove(place.link))
    reload = live and place.unit.exists()
    steps += [Remove(path) for path in (place.unit, place.failed_unit, *place.networks(), place.udev_rules)]
    if reload:
        steps.append(Run(["systemctl", "daemon-reload"], lambda: False))
    if live:
        steps.append(AwaitProcesses(ACCOUNT))
        # the number of a user who is gone may be given to another
        steps.append(LeaveToAll(place.runs))
    steps.append(RemoveFolder(place.cache))
    steps.append(Rename(place.rig_file, place.rig_file.with_suffix(".yaml.removed")))
    prefix = [] if live else [f"--prefix={place.root}"]
    for command, file in (("userdel", "etc/passwd"), ("groupdel", "etc/group")):
        # where a user is of this group alone, userdel takes it along
        steps.append(
            Run([command, *prefix, ACCOUNT], functools.partial(_is_without_account, place.root / file))
        )
    steps.append(Remove(place.sysusers))
    return steps


def refuse_unable(user_id: int, systemd: Path = Path("/run/systemd/system")) -> None:
    """Raise BadInput where a service cannot be set up or taken away, before anything is done."""
    if not systemd.is_dir():
        raise BadInput("systemd does not run here, and a service needs it; start by hand: needle-rig daemon")
    if user_id != 0:
        raise BadInput("only root may set up a service: sudo needle-rig install-service")


def packaged_files(program: Path) -> dict[str, str]:
    """What a package of a distribution puts below /usr/lib for a service that runs `program`."""
    return {
        f"systemd/system/{UNIT}": unit_text(program),
        f"systemd/system/{FAILED_UNIT}": _shipped_unit(FAILED_UNIT),
        "sysusers.d/needle-rig.conf": _account(()),
        "udev/rules.d/70-needle-rig.rules": _UDEV_RULES,
    }


def unit_text(program: Path, sensor_address: str | None = None) -> str:
    """The shipped unit with the folder of `program` in its PATH; it may reach `sensor_address` alone.

    Raises BadInput for what is no IP address.
    """
    text = _shipped_unit(UNIT).replace(_IN_UNIT, str(program.parent))
    if sensor_address is None:
        return text
    try:
        address = ipaddress.ip_address(sensor_address)
    except ValueError:
        raise BadInput(
            f"links.torque.address is {sensor_address!r}; a service may reach an IP address alone, such as"
            " 192.168.1.1: ping shows that of a name"
        ) from None
    family = "AF_INET" if isinstance(address, ipaddress.IPv4Address) else "AF_INET6"
    allowed = str(address).partition("%")[0]  # a scope is none of the firewall's
    text = text.replace(_FAMILIES, f"{_FAMILIES} {family}")
    return text.replace(_NO_NETWORK, f"{_NO_NETWORK}\nIPAddressAllow={allowed}")


def _shipped_unit(name: str) -> str:
    return shipped_file(f"service/{name}").read_text(encoding="utf-8")


def installed_program() -> Path:
    """The `needle-rig` of this Python. Raises BadInput where a service could not run it."""
    program = Path(sys.prefix) / "bin" / "needle-rig"
    if not program.is_file():
        raise BadInput(f"{program}: is not there; install needle-rig first: {install_command()}")
    for hidden in ("home", "root", "tmp"):
        if program.is_relative_to(Path("/", hidden)):
            raise BadInput(
                f"{program}: a service does not see /{hidden}; install needle-rig in /opt/needle-rig:"
                " sudo python3 -m venv /opt/needle-rig &&"
                f" sudo /opt/needle-rig/bin/pip install {install_arguments()}"
            )
    return program


def _network_steps(place: Installation, interface: str, bitrate_kbit_s: int, live: bool) -> list[Step]:
    steps: list[Step] = []
    if interface.startswith("vcan"):
        steps += _changed(
            WriteFile(place.device(interface), _VIRTUAL_DEVICE.format(interface=interface)), False
        )
        text = _VIRTUAL_NETWORK.format(interface=interface)
    else:
        text = _NETWORK.format(interface=interface, bit_s=bitrate_kbit_s * 1000)
    if place.has_network_manager:
        unmanaged = WriteFile(place.unmanaged(interface), _UNMANAGED.format(interface=interface))
        steps += _changed(unmanaged, live, ["systemctl", "try-reload-or-restart", "NetworkManager.service"])
    network = WriteFile(place.network(interface), text)
    on = functools.partial(_is_enabled, place, "systemd-networkd.service")
    steps.append(network)
    if not on():
        steps.append(Run(["systemctl", *_at(place), "enable", "systemd-networkd.service"], on))
        # a computer whose network is somebody else's would wait for networkd's at every boot
        waits = functools.partial(
            _is_enabled, place, "systemd-networkd-wait-online.service", "network-online.target.wants"
        )
        command = ["systemctl", *_at(place), "disable", "systemd-networkd-wait-online.service"]
        steps.append(Run(command, lambda: not waits()))
        if live:
            steps.append(Run(["systemctl", "start", "systemd-networkd.service"], lambda: False))
    elif live and not network.is_done():
        steps.append(Run(["networkctl", "reload"], lambda: False))
    return steps


def _changed(file: WriteFile, live: bool, *commands: list[str]) -> list[Step]:
    """The file, and what tells the system that it is new."""
    told = live and not file.is_done()
    return [file, *(Run(command, lambda: False) for command in commands if told)]


def _sysusers(place: Installation, members: tuple[str, ...]) -> str:
    """Who is declared already stays declared."""
    try:
        before = re.findall(rf"(?m)^m (\S+) {ACCOUNT}$", place.sysusers.read_text(encoding="utf-8"))
    except OSError:
        before = []
    return _account((*before, *members))


def _account(members: tuple[str, ...]) -> str:
    lines = [
        f'u {ACCOUNT} - "needle-rig daemon" /var/lib/needle-rig',
        f"m {ACCOUNT} dialout",
        *(f"m {member} {ACCOUNT}" for member in dict.fromkeys(members)),
    ]
    return "\n".join(lines) + "\n"


def _is_without_account(file: Path) -> bool:
    try:
        return not re.search(rf"(?m)^{ACCOUNT}:", file.read_text(encoding="utf-8"))
    except OSError:
        return True


def _has_accounts(place: Installation, members: tuple[str, ...]) -> bool:
    if _is_without_account(place.root / "etc/passwd"):
        return False
    groups = (place.root / "etc/group").read_text(encoding="utf-8")
    group = re.search(rf"(?m)^{ACCOUNT}:[^:]*:\d+:(.*)$", groups)
    return group is not None and set(members) <= set(group[1].split(","))


def _is_enabled(place: Installation, unit: str, target: str = "multi-user.target.wants") -> bool:
    return (place.root / "etc/systemd/system" / target / unit).is_symlink()


def is_active(unit: str = UNIT) -> bool:
    """Whether a unit runs, or is about to."""
    from needle_rig.service.installed.systemd import unit_standing

    standing = unit_standing(unit)
    return standing is not None and standing.state in ("active", "activating", "reloading")


def _rests(unit: str) -> bool:
    return not is_active(unit)


def _at(place: Installation) -> list[str]:
    return [] if place.root == Path("/") else [f"--root={place.root}"]
