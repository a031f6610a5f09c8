"""What a private daemon says while it starts reaches the person who started it."""

from __future__ import annotations

import sys

import pytest

from needle_rig.service import client

SAYS = "import sys; sys.stderr.write('no cache, compiled anew\\n'); print('{}', flush=True); sys.stdin.read()"


def test_what_it_says_while_it_starts_is_passed_on(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(client, "_DAEMON", [sys.executable, "-c", SAYS])
    with client.private_daemon([]):
        assert capsys.readouterr().err == "no cache, compiled anew\n"
