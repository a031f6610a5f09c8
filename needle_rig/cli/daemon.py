"""`needle-rig daemon`: owns the rig and serves it on a socket."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from needle_rig.cli._rig import bench_nodes, rig_options, simulated_rig_file
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.records import JsonObject

if TYPE_CHECKING:
    from needle_rig.service.tick.daemon import Daemon

_ENDS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)


@click.command()
@rig_options
@click.option("--socket", type=click.Path(path_type=Path), help="Where to listen; default: the usual place.")
@click.option("--group", help="Group whose members may use the socket.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder of the runs.")
@click.option("--private", type=click.Path(path_type=Path), hidden=True, help="Folder of one client.")
def command(
    config: str | None,
    parameters: str | None,
    model: str | None,
    seed: int | None,
    simulated: bool,
    rig: str | None,
    image: bool,
    fast: bool,
    socket: Path | None,
    group: str | None,
    out: Path | None,
    private: Path | None,
) -> None:
    """Own the rig and serve it on a Unix socket, until a signal (TERM, INT, HUP) ends it.

    Only the socket's owner and --group may use it (mode 0660). The rig's drive is told to stop at the end,
    whatever ended it. Under systemd it says when it is ready and feeds the watchdog from ticks that met their
    deadline: see config/service/needle-rig.service.
    """
    if simulated and config is None:
        config = str(simulated_rig_file())
    elif private is None and (config, parameters, seed, rig, fast) == (None, None, None, None, False):
        _refuse_where_a_rig_is_set_up()
    try:
        with _place(socket, private) as path:
            options: JsonObject = {"simulation.parameters": parameters, "simulation.seed": seed}
            options["simulation.nodes"] = bench_nodes(rig, image)
            daemon = _build(config, options, model, fast, out, private=private is not None)
            _serve(daemon, path, group, private=private is not None)
    except NeedleRigError as error:
        if private is None:
            raise
        _tell(error=str(error), exit_code=error.exit_code)
        sys.exit(error.exit_code)


def _refuse_where_a_rig_is_set_up() -> None:
    """Who starts a daemon at the rig's computer without a word does not mean the simulated rig."""
    from needle_rig.service.installed.installation import HERE

    for sign in (HERE.unit, HERE.rig_file):
        if sign.exists():
            raise BadInput(
                f"a rig is set up here ({sign}); name its file: needle-rig daemon --config {HERE.rig_file};"
                " for the simulated rig give --simulated"
            )


@contextmanager
def _place(socket: Path | None, private: Path | None) -> Iterator[Path]:
    """Where to listen; a private daemon takes its client's folder away, in case the client was killed."""
    import shutil

    from needle_rig.service.api.endpoint import private_socket, socket_for_daemon

    if private is None:
        yield socket or socket_for_daemon()
        return
    try:
        yield private_socket(private)
    finally:
        shutil.rmtree(private, ignore_errors=True)


def _build(
    config: str | None,
    options: JsonObject,
    model: str | None,
    fast: bool,
    out: Path | None,
    *,
    private: bool,
) -> Daemon:
    """The daemon. One that is not `private` outlives its rig, and its clients are in other folders."""
    from needle_rig.assembly import build_daemon
    from needle_rig.config.loader import load_rig_config

    rig = load_rig_config(config, options)
    needle = trust = None
    if model is not None:
        from needle_rig.control.strategy import Trust
        from needle_rig.model import load_saved, parameters_path

        saved = load_saved(model)
        needle, trust = saved.model, Trust(saved.uncertainties, saved.error_over_floor)
        if rig.recording.watch is not None:  # each run names the model that it is watched with
            watched = str(parameters_path(model).absolute())
            rig = load_rig_config(config, options | {"recording.watch.model": watched})
    runs = out or Path(rig.recording.directory)
    return build_daemon(
        rig,
        virtual=fast,
        runs=runs if private else runs.absolute(),
        model=needle,
        trust=trust,
        resident=not private,
    )


def _serve(daemon: Daemon, path: Path, group: str | None, *, private: bool) -> None:
    import asyncio

    from needle_rig.service.api.endpoint import listening

    _log(private)
    # one that comes before the loop takes it, or a second one at the very end, must not leave the socket
    for number in _ENDS:
        signal.signal(number, lambda *_: daemon.end())
    with listening(path, group) as listener:

        async def serve() -> None:
            _end_by_signal(daemon, private)
            await daemon.run(listener, lambda: _tell(socket=str(path)) if private else None)

        try:
            # told to end before it was ready
            with suppress(asyncio.CancelledError):
                asyncio.run(serve())
        finally:
            for number in _ENDS:
                signal.signal(number, signal.SIG_IGN)


def _end_by_signal(daemon: Daemon, private: bool) -> None:
    """A signal ends the daemon; so does the end of standard input of a private one: its client has gone."""
    import asyncio
    import os

    loop = asyncio.get_running_loop()
    for number in _ENDS:
        loop.add_signal_handler(number, daemon.end)

    def on_input() -> None:
        if not os.read(0, 4096):
            loop.remove_reader(0)
            daemon.end()

    if private:
        loop.add_reader(0, on_input)


def _tell(**content: Any) -> None:
    """One line to the client that started this daemon."""
    print(json.dumps(content), flush=True)  # noqa: T201 - the reply channel


def _log(private: bool) -> None:
    """Log to stderr; a private daemon leaves it to its client to tell a person what matters."""
    import logging

    import structlog

    # a bus that cannot be opened is told by our own sentence, not by a line of python-can's for each attempt
    logging.getLogger("can").setLevel(logging.CRITICAL)
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL if private else logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
