"""A command that orders something says when the daemon is of another version."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from needle_rig.cli._motion import commanding
from needle_rig.service.client import DaemonClient
from needle_rig.version import VERSION
from needle_rig.web.rig_link import RigLink


class Answering(DaemonClient):
    """A daemon's client that is given `answers` to its lease."""

    def __init__(self, answer: dict[str, str]) -> None:
        super().__init__(Path("daemon.sock"))
        self.answer = answer

    def _ask(self, method: str, path: str, *_: object, **__: object) -> dict[str, str]:  # type: ignore[override]
        return {"lease": "1"} | self.answer


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"version": VERSION}, ""),
        (
            {"version": "0.0.9"},
            f"warning: the daemon runs needle-rig 0.0.9, and this is {VERSION}; "
            "restart it when no run goes on; a service: sudo systemctl restart needle-rig\n",
        ),
        ({}, f"warning: the daemon runs an older needle-rig, and this is {VERSION}; "
         "restart it when no run goes on; a service: sudo systemctl restart needle-rig\n"),
    ],
    ids=["the same", "another", "one that does not say"],
)  # fmt: skip
def test_one_line_tells_of_another_version(
    answer: dict[str, str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with commanding(Answering(answer), "hold"):
        pass
    assert capsys.readouterr().err == said


async def test_the_page_tells_of_a_daemon_of_another_version_while_it_answers() -> None:
    link = RigLink(Path("nobody.sock"))
    told = [link.other_version]
    for version in (VERSION, "0.0.9"):
        link._take(json.dumps({"type": "state", "version": version}))
        told.append(link.other_version)
    link._lost()
    told.append(link.other_version)
    assert [None if each is None else each.partition(",")[0] for each in told] == [
        None,
        None,
        "the daemon runs needle-rig 0.0.9",
        None,
    ]
