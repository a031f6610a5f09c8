"""`needle-rig compensate`: turns the base to the target and takes the windup out of the needle."""

from __future__ import annotations

import contextlib
import json
import math
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._live import moving_bar
from needle_rig.cli._motion import commanding, end_as_by_ctrl_c, follow, speed_option, view
from needle_rig.cli._rig import rig_options
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.records import JsonObject

if TYPE_CHECKING:
    from needle_rig.service.api.documents import Document, Message, Started, Told
    from needle_rig.service.client import DaemonClient


_CHOICES = frozenset(("config", "parameters", "seed", "simulated", "rig", "fast"))
"""Options that choose a rig, and may choose a simulated one where a real one is set up."""

_RELAX: Message = {"target_deg": 0.0, "strategy": "decay"}
"""Brings a needle that is not ours to start anew back to rest between trials."""


@click.command()
@click.option("--target", type=float, metavar="DEG", help="Angle that the whole needle shall reach, degrees.")
@click.option(
    "--protocol",
    shell_complete=completing("protocols"),
    help="Run a series of trials instead: a protocol's name or file.",
)
@click.option(
    "--strategy",
    shell_complete=completing("strategies"),
    default="reed2008",
    show_default=True,
    help="How to get there.",
)
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="An option of the strategy.")
@click.option(
    "--extra",
    type=float,
    metavar="DEG",
    help="Extra turn of reed2008_elastic, degrees; same as --option extra_deg=.",
)
@click.option("--after", metavar="RUN", help="Run whose lag reed2008_elastic learns from; also: last.")
@click.option(
    "--settle", type=float, metavar="S", help="Seconds that each motion settles; default: of the config."
)
@speed_option
@rig_options
@click.option("--out", type=click.Path(file_okay=False), help="Folder of the run; default: of the config.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object, nothing else.")
@click.option(
    "--picture/--no-picture", default=None, help="Draw a PNG beside the run; default: unless --json."
)
@click.option("--require-aligned", is_flag=True, help="Exit 1 when the needle is not aligned at the end.")
@click.option("--socket", type=click.Path(path_type=Path), help="Socket of the daemon to use.")
def command(
    target: float | None,
    protocol: str | None,
    strategy: str,
    options: tuple[str, ...],
    extra: float | None,
    after: str | None,
    settle: float | None,
    speed: float | None,
    as_json: bool,
    picture: bool | None,
    require_aligned: bool,
    socket: Path | None,
    **rig: Any,
) -> int:
    """Turn the base to --target and take the windup out of the needle, or run the trials of --protocol.

    A running daemon is used when there is one. Without one, or when an option chooses the rig (--config,
    --parameters, --model, --seed, --simulated, --rig, --fast, --out), a private daemon is started and ended.
    Where a rig is set up (a unit, /etc/needle-rig/rig.yaml, a daemon's socket) a simulated one is used only
    when it is asked for: --simulated, --fast, --rig, --parameters, --seed or --config. Ctrl-C stops the drive
    and closes the run. With --protocol every trial starts from a relaxed needle and is a run of its own;
    --json then prints an object a line.

    \b
    Exit codes:
      0  the sequence ran to its end; whether the needle is aligned stands in the output
      1  it is not aligned, and --require-aligned was given
      2  bad use: an option, a file or a value that cannot be used
      3  a fault of the rig: a link, a sensor, the drive or a limit
      4  stopped by a person
    """
    if after is not None:
        from needle_rig.cli._runs import learned_extra_deg, the_run

        if extra is not None:
            raise BadInput("give either --extra or --after: the run stands for an extra turn")
        out = rig.get("out")
        extra = learned_extra_deg(the_run(after, Path(out) if out else None, rig.get("config")))
        click.echo(f"extra turn learned from {after}: {extra:.1f}°", err=True)
    if strategy == "planned":
        _warn(rig.get("model"), rig.get("out"), rig.get("config"))
    end_as_by_ctrl_c()
    orders = _orders(target, protocol, strategy, options, extra, settle, speed)
    picture = not as_json if picture is None else picture
    if picture:
        # the picture's libraries take a second to load: do it while the daemon starts and the run goes on
        threading.Thread(target=_load_figure, daemon=True).start()
    code = 0
    for number, order in enumerate(orders, 1):
        if len(orders) > 1:
            click.echo(f"trial {number} of {len(orders)}", err=True)
        with _daemon(socket, rig) as client:
            with commanding(client, "compensate"):
                if number > 1 and not client.private:
                    _run(client, _RELAX, as_json)
                ended = _run(client, order, as_json)
            client.let_go()
            if as_json:
                click.echo(json.dumps(ended["result"]))
            figure = _draw(ended["result"]["run"]) if picture else None
            code = max(code, _tell(ended, figure, as_json, require_aligned))
        if ended["result"]["status"] in ("aborted", "fault"):
            break
    return code


def _warn(model: str | None, out: str | None, config: str | None) -> None:
    """Say so before the needle is turned with a model that the last run contradicts.

    Without a model of one's own it is that of the rig file, of which the watch has said it.
    """
    from needle_rig.cli._runs import runs_directory
    from needle_rig.recording.watch_summary import WATCH_FOLDER, read_contradiction

    directory = runs_directory(Path(out) if out else None, Path(config) if config else None)
    if not (directory / WATCH_FOLDER).is_dir():
        return
    if model is None:
        said = read_contradiction(directory)
    else:
        from needle_rig.model import load_saved
        from needle_rig.workbench.learning.last_run import contradiction
        from needle_rig.workbench.learning.watched_runs import kept_runs

        said = contradiction(kept_runs(directory), load_saved(model), model)
    if said:
        click.echo(f"warning: {said}", err=True)


def _orders(
    target: float | None, protocol: str | None, strategy: str, options: tuple[str, ...], *more: float | None
) -> list[Message]:
    """The requests to the daemon, one a trial."""
    if (target is None) == (protocol is None):
        raise BadInput("give either --target, as in --target 45, or --protocol")
    if target is not None:
        return [_order(target, strategy, options, *more)]
    from needle_rig.dataset.protocol import load_protocol

    assert protocol is not None
    extra, settle, speed = more
    orders = []
    for trial in load_protocol(protocol).trials:
        pace = (settle or trial.settle_s, speed or trial.speed_deg_s)
        if trial.kind == "compensate" and trial.target_deg is not None:
            orders.append(_order(trial.target_deg, strategy, options, extra, *pace))
        else:
            steps = {"options": {"steps_deg": list(trial.steps_deg)}}
            orders.append({**_order(trial.steps_deg[-1], "protocol", (), None, *pace), **steps})
    return orders


def _order(
    target: float,
    strategy: str,
    options: tuple[str, ...],
    extra: float | None,
    settle: float | None,
    speed: float | None,
) -> Message:
    """The request to the daemon, with what can be judged without a rig judged."""
    from needle_rig.control.strategy import NAME

    for name, value in (("--target", target), ("--extra", extra), ("--settle", settle), ("--speed", speed)):
        if value is not None and not math.isfinite(value):
            raise BadInput(f"{name} {value}: is not a number to turn by; give one, as in --target 45")
    if not NAME.fullmatch(strategy.replace("-", "_")):
        home = f"config/strategies/{Path(strategy).stem or 'NAME'}.py"
        raise BadInput(
            f"--strategy {strategy}: is no name; one of your own is a file {home}, named by its stem"
        )
    chosen: JsonObject = dict(_option(text) for text in options)
    if extra is not None:
        chosen["extra_deg"] = extra
    return {
        "target_deg": target,
        "strategy": strategy.replace("-", "_"),
        "options": chosen,
        "settle_s": settle,
        "speed_deg_s": speed,
    }


def _option(text: str) -> tuple[str, object]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise BadInput(f"--option {text}: write NAME=VALUE, as in --option extra_deg=12")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value


@contextmanager
def _daemon(path: Path | None, rig: JsonObject) -> Iterator[DaemonClient]:
    """The running daemon, or a private one."""
    from needle_rig.cli._rig import simulated_rig_file
    from needle_rig.service.client import find_daemon, private_daemon, the_daemon

    chosen = {name: value for name, value in rig.items() if value is not None and value is not False}
    given = [f"--{name}" for name in chosen]
    if path is not None:
        if given:
            raise BadInput(
                f"{given[0]} chooses the rig, but the daemon at {path} has its own: "
                f"give {given[0]} to `needle-rig daemon`"
            )
        yield the_daemon(path)
        return
    running = None if given else find_daemon()
    if running is not None:
        yield running
        return
    if not chosen.keys() & _CHOICES:
        _refuse_where_a_rig_is_set_up(given)
    if chosen.pop("simulated", False):
        chosen.setdefault("config", simulated_rig_file())
    options = [f"--{name}" if value is True else f"--{name}={value}" for name, value in chosen.items()]
    with private_daemon(options, meanwhile=_get_ready, waiting=moving_bar) as client:
        yield client


def _refuse_where_a_rig_is_set_up(given: list[str]) -> None:
    """Nobody who wants the real needle turned may watch a simulated one."""
    from needle_rig.service.api.endpoint import sockets_for_client
    from needle_rig.service.client import find_daemon
    from needle_rig.service.installed.installation import HERE, nobody_answers

    signs = HERE.signs()
    if not signs:
        return
    if given and find_daemon() is not None:
        raise BadInput(
            f"{given[0]} needs a daemon of its own, but that of the rig set up here runs ({signs[0]}): leave"
            f" {given[0]} out, or give --simulated"
        )
    raise RigFault(f"{nobody_answers(sockets_for_client())}; for the simulated rig give --simulated")


def _get_ready() -> None:
    """Import what talking to the daemon needs while it starts."""
    import httpx  # noqa: F401
    import websockets.sync.client  # noqa: F401


def _run(client: DaemonClient, order: Message, quiet: bool) -> Told:
    """Start the run, show it until it has ended, and return how."""
    return follow(client, lambda: client.compensate(order), view(quiet), _ended)


def _ended(told: Started, document: Document) -> Told | None:
    ended: Told | None = None
    if document["type"] == "ended":
        ended = document
    elif document["type"] == "state" and document["run"] != told["run"]:
        ended = document["last"]  # it ended while the connection was made again
    return ended if ended is not None and ended["result"]["run"] == told["run"] else None


def _load_figure() -> None:
    # a failure shows when the figure is drawn
    with contextlib.suppress(ImportError, NeedleRigError):
        import needle_rig.figures.run  # noqa: F401


def _draw(run: str) -> str | None:
    """Draw the picture of a run beside it, or here where its folder is the daemon's alone."""
    from needle_rig.recording import RunFile

    path = Path(run).with_suffix(".png")
    if not os.access(path.parent, os.W_OK):
        path = Path(path.name)
    try:
        from needle_rig.figures.run import draw_run

        return str(draw_run(RunFile(run), path))
    except NeedleRigError as error:
        click.echo(f"no picture: {error}", err=True)
        return None


def _tell(ended: Told, figure: str | None, as_json: bool, require_aligned: bool) -> int:
    """Tell how it ended; the exit code."""
    from needle_rig.cli._output import EXIT_CODES, console, tell_result, verdict

    status = ended["result"]["status"]
    if as_json:
        click.echo(f"{verdict(ended)}{'' if figure is None else f' (picture: {figure})'}", err=True)
    else:
        tell_result(console(markup=True), ended, figure)
    if status == "aborted":
        click.echo("Stopped: the drive is stopped and the run is closed.", err=True)
    if require_aligned and status == "not_aligned":
        return 1
    return EXIT_CODES[status]
