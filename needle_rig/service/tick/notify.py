"""Tells systemd how the daemon is (sd_notify): ready, alive, stopping."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping


class Notify:
    """Sends states to the socket that systemd names in NOTIFY_SOCKET; silent where there is none."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        watched = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(environment.get("WATCHDOG_USEC", "0")) * 1e-6 if watched else 0.0
        """After this time without `alive` systemd ends the daemon; 0 means it does not watch."""
        self._next_alive_s = 0.0

    def send(self, **states: str | int) -> None:
        """Send states such as READY=1; a full or missing socket is ignored: the tick must not wait."""
        if self._address:
            text = "\n".join(f"{name}={value}" for name, value in states.items())
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)

    def alive(self, now_s: float) -> None:
        """Feed the watchdog, at most four times in its time; call it for every tick that met its deadline."""
        if self.watchdog_s and now_s >= self._next_alive_s:
            self._next_alive_s = now_s + self.watchdog_s / 4
            self.send(WATCHDOG=1)

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()
