"""A daemon that a campaign starts."""

from __future__ import annotations

import time
from pathlib import Path

from needle_rig.service.client import DaemonClient, find_daemon

START_S = 180.0


def wait_for(socket: Path, log: Path | None = None) -> DaemonClient:
    """The daemon at `socket`, once its rig ticks. Raises RuntimeError, with its log, when it does not."""
    deadline_s = time.monotonic() + START_S
    while time.monotonic() < deadline_s:
        client = find_daemon(socket)
        if client is not None and not client.state()["starting"]:
            return client
        time.sleep(0.2)
    said = f": {log.read_text(encoding='utf-8')}" if log is not None else ""
    raise RuntimeError(f"no daemon within {START_S:g} s{said}")
