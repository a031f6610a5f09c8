"""What systemd knows of the service."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass

UNIT = "needle-rig.service"
FAILED_UNIT = "needle-rig-failed.service"
"""What systemd starts when the daemon has failed."""
LOG = "journalctl -u needle-rig"
"""How a person reads the service's log."""
_TIMEOUT_S = 3.0
_PROPERTIES = ("LoadState", "ActiveState", "SubState", "Result", "StatusText")


@dataclass(frozen=True)
class UnitStanding:
    """How the unit stands, in systemd's words: `state` as `active`, `activating` or `failed`."""

    state: str
    substate: str
    result: str
    status_text: str

    @property
    def failing(self) -> bool:
        """Whether it ended by a fault, also when it is started again soon."""
        return self.state == "failed" or self.substate == "auto-restart"

    @property
    def sentence(self) -> str:
        """The same for a person, with what to do."""
        said = f" ({self.status_text})" if self.status_text else ""
        if self.substate == "auto-restart":
            return f"its service ended ({self.result}) and is started again soon; why it ended: {LOG}"
        if self.state in ("activating", "active", "reloading"):
            return f"its service is starting{said}; try again in a moment, or look at: {LOG}"
        if self.state == "deactivating":
            return "its service is ending; wait for it, then: sudo systemctl start needle-rig"
        if self.state == "failed":
            return f"its service failed ({self.result}); see why: {LOG}; then: sudo systemctl restart {UNIT}"
        return "its service is stopped; start it: sudo systemctl start needle-rig"


def unit_standing(unit: str = UNIT) -> UnitStanding | None:
    """How `unit` stands; None where there is no systemd, no such unit, or no answer within 3 s."""
    try:
        said = subprocess.run(
            ["systemctl", "show", unit, f"--property={','.join(_PROPERTIES)}"],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=True,
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    found = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
    if found.get("LoadState") != "loaded":
        return None
    return UnitStanding(found["ActiveState"], found["SubState"], found["Result"], found["StatusText"])
