"""What the kernel says of a CAN interface."""

from __future__ import annotations

import json
import subprocess
from dataclasses import dataclass
from typing import TypedDict

_TIMEOUT_S = 5.0


@dataclass(frozen=True)
class Interface:
    """A network interface that may be a CAN bus; `bitrate_bit_s` and `restart_ms` are 0 where none is set."""

    kind: str
    up: bool
    state: str
    """Of the controller: ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF or STOPPED; empty for vcan."""
    bitrate_bit_s: int
    restart_ms: int


def look_at(name: str) -> Interface | None:
    """The interface `name`; None where there is none, or no `ip` command that tells."""
    try:
        said = subprocess.run(
            ["ip", "-details", "-json", "link", "show", "dev", name],
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=True,
        ).stdout
        return parse(json.loads(said)[0])
    except (OSError, subprocess.SubprocessError, ValueError, LookupError):
        return None


class _Timing(TypedDict, total=False):
    bitrate: int


class _Data(TypedDict, total=False):
    state: str
    bittiming: _Timing
    restart_ms: int


class _Info(TypedDict, total=False):
    info_kind: str
    info_data: _Data


class Link(TypedDict, total=False):
    """What is read of one object of `ip -details -json link`; another kind of interface has less of it."""

    link_type: str
    flags: list[str]
    linkinfo: _Info


def parse(link: Link) -> Interface:
    """The interface in one object of `ip -details -json link`."""
    info = link.get("linkinfo", {})
    data = info.get("info_data", {})
    return Interface(
        kind=str(info.get("info_kind", link.get("link_type", ""))),
        up="UP" in link.get("flags", []),
        state=str(data.get("state", "")),
        bitrate_bit_s=int(data.get("bittiming", {}).get("bitrate", 0)),
        restart_ms=int(data.get("restart_ms", 0)),
    )
