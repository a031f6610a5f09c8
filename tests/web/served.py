"""A server of the page as a person starts it, and how to ask it."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from typing import Any

import httpx

from tests.closed_loop.shell import Shell


@dataclass(frozen=True)
class Served:
    """Its process and the address that it printed."""

    shell: Shell
    process: subprocess.Popen[str]
    address: str
    watching: str = ""
    """The address of watchers, where it was asked for."""

    @property
    def port(self) -> int:
        """Of the address."""
        return int(self.address.split("/#")[0].rsplit(":", 1)[1])

    @property
    def token(self) -> str:
        """Of the address."""
        return self.address.split("token=")[1]

    @property
    def base(self) -> str:
        """The address without the token."""
        return self.address.split("/#")[0]

    @property
    def authorised(self) -> dict[str, str]:
        """The header with the token."""
        return {"authorization": f"Bearer {self.token}"}

    def ask(
        self, method: str, path: str, headers: dict[str, str] | None = None, **more: Any
    ) -> httpx.Response:
        """With the token, unless other headers are given."""
        given = self.authorised if headers is None else headers
        return httpx.request(method, f"{self.base}{path}", headers=given, timeout=60.0, **more)
