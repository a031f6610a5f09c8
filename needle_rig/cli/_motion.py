"""What all commands share that move the rig: who commands, what is shown, and that Ctrl-C stops it."""

from __future__ import annotations

import getpass
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from needle_rig.errors import Aborted, RigFault

if TYPE_CHECKING:
    from types import FrameType

    from needle_rig.cli._live import View
    from needle_rig.service.api.documents import Document, Message, Started, Whole
    from needle_rig.service.client import DaemonClient

End = TypeVar("End")

speed_option = click.option(
    "--speed",
    type=float,
    metavar="DEG/S",
    help="Speed of the base, degrees per second; default: of the config.",
)
_STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def view(quiet: bool = False) -> View:
    """The live display on a terminal; else, and when `quiet`, one line a phase."""
    from needle_rig.cli._live import LiveDisplay, PhaseLines

    if quiet or not sys.stdout.isatty():
        return PhaseLines()
    from rich.console import Console

    return LiveDisplay(Console())


@contextmanager
def commanding(client: DaemonClient, command: str) -> Iterator[None]:
    """Command the rig with `needle-rig COMMAND`, and say when the daemon is of another version."""
    from needle_rig.version import differs

    with client.lease(_holder(command)):
        if told := differs(client.version):
            click.echo(f"warning: {told}", err=True)
        yield


def _holder(command: str) -> str:
    """Who commands, in words for those who find the rig taken."""
    try:
        person = getpass.getuser()
    except (KeyError, OSError):
        person = f"user {os.getuid()}"
    return f"{person} (needle-rig {command}, process {os.getpid()})"[:200]


def end_as_by_ctrl_c() -> None:
    """SIGTERM and a closed terminal end this command as Ctrl-C does; what is ignored stays ignored."""
    ctrl_c = signal.getsignal(signal.SIGINT)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, ctrl_c if callable(ctrl_c) else signal.default_int_handler)


def follow(
    client: DaemonClient,
    start: Callable[[], Started],
    shown: View,
    over: Callable[[Started, Document], End | None],
) -> End:
    """Start a motion, show it until `over` finds its end by what the start told and a document: that end.

    Ctrl-C, SIGTERM or a closed terminal stops the drive at any instant: before the start was answered it
    raises Aborted, after that the motion ends in order. A second one gives up. Raises RigFault when the
    daemon ends meanwhile.
    """
    with _stops(client) as answered, client.stream() as documents, shown:
        shown.show(next(documents))
        told = start()
        answered()
        for document in documents:
            shown.show(document)
            if (end := over(told, document)) is not None:
                return end
    recorded = f"; what was recorded until then is in {told['run']}" if "run" in told else ""
    raise RigFault(f"the daemon ended during the motion, and the drive stops by itself then{recorded}")


def move(socket: Path | None, command: str, order: Message) -> Whole:
    """Let the running daemon carry out a motion that is no run, and show it; raises RigFault or Aborted."""
    from needle_rig.service.client import the_daemon

    end_as_by_ctrl_c()
    client = the_daemon(socket)
    with commanding(client, command):
        state = follow(client, lambda: client.command(command, order), view(), moved)
    if state["phase"] == "fault":
        raise RigFault(state["fault"] or "a fault")
    if state["phase"] == "aborted":
        raise Aborted("Stopped: the drive is stopped.")
    return state


def told_base(state: Whole) -> str:
    """Where the base stands, for a person."""
    from needle_rig.cli._output import number

    sensors = state["sensors"]
    simulated = " (simulated)" if state["rig"]["simulated"] else ""
    return ("unknown" if sensors is None else f"{number(sensors['base_deg'], 2)}°") + simulated


socket_option = click.option(
    "--socket", type=click.Path(path_type=Path), help="Socket of the daemon; default: the usual one."
)


def moved(told: Started, document: Document) -> Whole | None:
    """The end of a motion that is no run, for `follow`."""
    if document["type"] == "ended":
        return None
    if document["type"] == "moved":
        return document if document["moved"] == told["motion"] else None
    over = document["type"] == "state" and document["motions"] >= told["motion"] and not document["moving"]
    return document if over else None


@contextmanager
def _stops(client: DaemonClient) -> Iterator[Callable[[], None]]:
    begun = False

    def answered() -> None:
        nonlocal begun
        begun = True

    def stop(number: int, _: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.default_int_handler)
        client.stop("Ctrl-C" if number == signal.SIGINT else signal.Signals(number).name)
        # said after the stop was sent: a terminal that hangs may hold this up, and no lock of a stream may
        with suppress(OSError):
            os.write(2, "stopping …\n".encode())
        if not begun:
            raise Aborted("Stopped: the drive is stopped, and nothing begins.")

    before = {
        number: signal.signal(number, stop)
        for number in _STOPS
        if signal.getsignal(number) is not signal.SIG_IGN
    }
    try:
        yield answered
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
