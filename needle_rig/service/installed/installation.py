"""Where the service of a rig keeps its things, and whether a rig is set up on this computer."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.service.api.endpoint import sockets_for_client
from needle_rig.service.installed.systemd import FAILED_UNIT, UNIT, UnitStanding, unit_standing

_NETWORK_PREFIX = "60-needle-rig-"
_UNIT_PATH = re.compile(r"(?m)^Environment=PATH=([^:\s]+)")


@dataclass(frozen=True)
class Installation:
    """The places of a service, below `root`."""

    root: Path = Path("/")

    @property
    def unit(self) -> Path:
        """The systemd unit."""
        return self.root / "etc/systemd/system" / UNIT

    @property
    def failed_unit(self) -> Path:
        """The unit that runs `on_failure`."""
        return self.unit.with_name(FAILED_UNIT)

    @property
    def on_failure(self) -> Path:
        """A program of this computer's own, which is run when the daemon has failed."""
        return self.root / "etc/needle-rig/on-failure"

    @property
    def rig_file(self) -> Path:
        """The rig file that the unit names."""
        return self.root / "etc/needle-rig/rig.yaml"

    @property
    def runs(self) -> Path:
        """Folder of the runs."""
        return self.root / "var/lib/needle-rig"

    @property
    def udev_rules(self) -> Path:
        """What the adapters of the nodes are given."""
        return self.root / "etc/udev/rules.d/70-needle-rig.rules"

    @property
    def sysusers(self) -> Path:
        """The user, the group and its members."""
        return self.root / "etc/sysusers.d/needle-rig.conf"

    @property
    def link(self) -> Path:
        """Where everybody's shell finds needle-rig."""
        return self.root / "usr/local/bin/needle-rig"

    @property
    def cache(self) -> Path:
        """What the daemon can make again: the compiled solver."""
        return self.root / "var/cache/needle-rig"

    @property
    def program(self) -> Path | None:
        """The needle-rig that the unit runs; None without a unit that names one."""
        try:
            found = _UNIT_PATH.search(self.unit.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return None if found is None else Path(found[1], "needle-rig")

    @property
    def calibration(self) -> Path:
        """What `needle-rig calibrate` wrote for this rig's nodes."""
        return self.root / "etc/needle-rig/calibration"

    def network(self, interface: str) -> Path:
        """What brings the CAN interface up."""
        return self.root / f"etc/systemd/network/{_NETWORK_PREFIX}{interface}.network"

    def device(self, interface: str) -> Path:
        """What makes a virtual CAN interface."""
        return self.network(interface).with_suffix(".netdev")

    def unmanaged(self, interface: str) -> Path:
        """What keeps NetworkManager from an interface."""
        return self.root / f"etc/NetworkManager/conf.d/{_NETWORK_PREFIX}{interface}.conf"

    @property
    def has_network_manager(self) -> bool:
        """Whether NetworkManager is installed."""
        return (self.root / "etc/NetworkManager").is_dir()

    def networks(self) -> list[Path]:
        """Every such file that is there."""
        folders = ("etc/systemd/network", "etc/NetworkManager/conf.d")
        return sorted(path for each in folders for path in (self.root / each).glob(f"{_NETWORK_PREFIX}*"))

    def signs(self, environment: Mapping[str, str] = os.environ) -> list[Path]:
        """What shows that a rig is set up here: a unit, a rig file, a socket even when nobody listens."""
        sockets = [self.root / path.relative_to("/") for path in sockets_for_client(environment)]
        return [path for path in (self.unit, self.rig_file, *sockets) if os.path.lexists(path)]

    def runs_directory(self) -> Path | None:
        """Where the service keeps its runs; None where none is installed, BadInput for a bad rig file."""
        if not os.path.lexists(self.rig_file):
            return self.runs if self.runs.is_dir() else None
        from needle_rig.config.loader import load_rig_config

        return self.runs_of(load_rig_config(self.rig_file).recording.directory)

    def runs_of(self, directory: str) -> Path:
        """The folder of runs that a rig file names; one that is not absolute lies in the unit's folder."""
        path = Path(directory)
        return self.root / path.relative_to("/") if path.is_absolute() else self.runs / path


HERE = Installation()
"""This computer."""


def _why_down(standing: UnitStanding) -> str:
    """How the service stands, with the reason where it ended by a fault, and what to do."""
    if not standing.failing:
        return standing.sentence
    from needle_rig.config.loader import load_rig_config
    from needle_rig.service.installed.logbook import Logbook

    try:
        load_rig_config(HERE.rig_file)
    except BadInput as error:
        found, *more = str(error).splitlines()
        others = f" (and {len(more)} more)" if more else ""
        return (
            f"its service failed, as its rig file cannot be used: {found}{others};"
            " mend it, then: sudo systemctl restart needle-rig"
        )
    ended = Logbook(HERE.runs).last_end
    return f"{standing.sentence}{f'; the daemon said: {ended}' if ended else ''}"


def nobody_answers(places: list[Path]) -> NeedleRigError:
    """What to tell a person for whom no daemon answers at `places`."""
    where = " or ".join(str(place) for place in places)
    signs = HERE.signs()
    if not signs:
        return RigFault(f"no daemon answers at {where}; start one: needle-rig daemon")
    standing = unit_standing() if HERE.unit in signs else None
    if standing is None:
        next_step = f"start it: needle-rig daemon --config {HERE.rig_file}"
    else:
        next_step = _why_down(standing)
    return RigFault(f"a rig is set up here ({signs[0]}), but no daemon answers at {where}: {next_step}")
