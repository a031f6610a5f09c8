"""`needle-rig web`: the page, with the rig alive and the workbench by clicks."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._motion import socket_option
from needle_rig.cli._workbench import effects_option, jobs_option
from needle_rig.errors import BadInput


@click.command("web")
@click.argument("data", nargs=-1, type=click.Path(path_type=Path, exists=True), metavar="[DATA]...")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port; default: any free one.")
@socket_option
@click.option("--rig", type=click.Choice(["simulated", "bench"]), help="Start a rig for the page alone.")
@click.option(
    "--parameters",
    shell_complete=completing("parameters"),
    help="Parameter set of that rig's needle, such as rig_rigid.",
)
@click.option("--fast", is_flag=True, help="That rig in virtual time.")
@click.option("--watchers", is_flag=True, help="Print a second address, which may see all and order nothing.")
@click.option(
    "--allow-host",
    "hosts",
    multiple=True,
    metavar="NAME[:PORT]",
    help="A name that browsers call the page by, through a tunnel or a proxy; repeatable.",
)
@click.option("--dir", "directory", type=click.Path(path_type=Path), help="Folder of the runs.")
@effects_option
@jobs_option
def command(
    data: tuple[Path, ...],
    show: bool,
    port: int,
    socket: Path | None,
    rig: str | None,
    parameters: str | None,
    fast: bool,
    watchers: bool,
    hosts: tuple[str, ...],
    directory: Path | None,
    effects: tuple[str, ...],
    jobs: int | None,
) -> None:
    """Serve the page on this computer, until Ctrl-C: the rig, the workbench, runs, effects, strategies.

    \b
    needle-rig web --open data/mine
    needle-rig web --open --rig simulated
    needle-rig web --port 8800 --watchers --allow-host rig.example.org

    DATA are dataset folders, run files, or folders that hold some; the page can read these, the recorded runs
    and what is dropped on it, nothing else. The page shows the running daemon, and works without one. The
    address that is printed carries a token: who has it may command the rig.
    """
    import asyncio
    import secrets

    from needle_rig.cli._runs import runs_directory
    from needle_rig.folders import temporary_folder
    from needle_rig.service.client import private_daemon
    from needle_rig.web.guard import LOOPBACK, Keys, checked_host
    from needle_rig.web.server import Page, Settings, listening, serve
    from needle_rig.web.store import opened

    if rig is None and (parameters is not None or fast):
        raise BadInput("--parameters and --fast choose the page's own rig: give them with --rig simulated")
    if rig is not None and socket is not None:
        raise BadInput("--rig starts a rig for the page alone: leave --socket out")
    runs = runs_directory(directory, None)
    hosts = tuple(map(checked_host, hosts))
    keys = Keys(secrets.token_urlsafe(24), secrets.token_urlsafe(24) if watchers else "")
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(contextlib.closing(listening(port)))
        folder = stack.enter_context(temporary_folder("needle-rig-web-"))
        if rig is not None:
            options = ["--simulated", "--out", str(runs)]
            options += ["--rig", "bench"] if rig == "bench" else []
            options += [*(["--parameters", parameters] if parameters else []), *(["--fast"] if fast else [])]
            socket = stack.enter_context(private_daemon(options)).path
        store, unkept = stack.enter_context(opened(runs, folder / "kept"))
        if unkept:
            click.echo(f"warning: {unkept}", err=True)
        processes = jobs or len(os.sched_getaffinity(0))
        settings = Settings(socket, data, runs, effects, processes, own_rig=rig is not None)
        page = f"http://{LOOPBACK}:{listener.getsockname()[1]}/#token="
        address = f"{page}{keys.token}"

        def ready() -> None:
            click.echo(f"the page: {address}")
            if keys.watchers:
                click.echo(f"to watch alone: {page}{keys.watchers}")
            if show:
                click.launch(address)

        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(serve(Page(settings, folder, store, unkept), listener, keys, hosts, ready))
    click.echo("the page is closed", err=True)
