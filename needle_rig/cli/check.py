"""`needle-rig check`: looks at everything that a rig needs."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
import statistics
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.errors import BadInput, NeedleRigError, RigFault

if TYPE_CHECKING:
    from needle_rig.config.schema import NetFtTorque, RigConfig
    from needle_rig.service.api.documents import Sensors
    from needle_rig.service.client import DaemonClient
    from needle_rig.service.setup.check import Finding

_LISTEN_S = 2.5
"""Rates are counted over a second, and 50 samples tell a scatter to 10 %."""
_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")


@click.command()
@click.option(
    "--config", "rig_file", type=click.Path(path_type=Path), help="Rig file.  [default: the service's]"
)
@click.option(
    "--move",
    "turn_deg",
    metavar="DEG",
    type=click.FloatRange(-90.0, 90.0),
    help="Turn the base so far and back, degrees.",
)
@click.option(
    "--calibration", type=click.Path(path_type=Path), help="Folder of calibrations.  [default: the service's]"
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as one JSON object.")
@click.option("--socket", type=click.Path(path_type=Path), help="Socket of the daemon to use.")
def command(
    rig_file: Path | None,
    turn_deg: float | None,
    calibration: Path | None,
    as_json: bool,
    socket: Path | None,
) -> int:
    """Look at the rig file, the ports, the bus, the nodes, the clocks, the disk and the drive.

    A running daemon is asked. Without one, one is started for as long as it takes, but where a service is set
    up: then it is said why that is down. Nothing moves without --move, which also shows directions and scales
    of encoder, torque cell and Hall sensors.

    \b
    Exit codes: 0 nothing failed (warnings may stand), 1 something failed, 2 bad use.
    """
    from needle_rig.service.setup.check import worst

    findings: list[Finding] = []
    simulated = None
    for each in _findings(rig_file, turn_deg, calibration, socket):
        if isinstance(each, bool):
            simulated = each
            continue
        findings.append(each)
        if not as_json:
            todo = f"; {each.todo}" if each.todo else ""
            click.echo(f"{each.verdict:<4}  {each.name}: {each.text}{todo}")
    verdict = worst(findings)
    if as_json:
        found = [dataclasses.asdict(each) for each in findings]
        click.echo(
            json.dumps({"verdict": verdict, "simulated": simulated, "findings": found}, ensure_ascii=False)
        )
    elif simulated:
        click.echo("The rig is simulated.")
    return 1 if verdict == "fail" else 0


def _findings(
    rig_file: Path | None, turn_deg: float | None, calibration: Path | None, socket: Path | None
) -> Iterator[Finding | bool]:
    """What is found, one by one; a bool says whether the rig is simulated."""
    from needle_rig.config.files import find_config_file
    from needle_rig.config.loader import load_rig_config
    from needle_rig.config.schema import NetFtTorque
    from needle_rig.service.api.endpoint import sockets_for_client
    from needle_rig.service.installed.installation import HERE, nobody_answers
    from needle_rig.service.setup import check
    from needle_rig.service.setup.interface import look_at

    path = rig_file or (HERE.rig_file if HERE.rig_file.exists() else find_config_file("rig.yaml"))
    try:
        config = load_rig_config(path)
    except BadInput as error:
        again = ", then: sudo systemctl restart needle-rig" if HERE.unit.exists() else ""
        yield check.Finding("rig file", "fail", str(error), f"mend it{again}")
        return
    yield check.Finding("rig file", "ok", f"{path}: {config.name}")
    yield from check.check_needle(config)
    yield from check.check_clocks(_first_line(_CLOCK_SOURCE), _synchronized())
    runs = (HERE.runs_directory() if path == HERE.rig_file else None) or Path(config.recording.directory)
    yield check.check_disk(config, shutil.disk_usage(_that_exists(runs)).free)
    yield check.check_runs(config, runs)
    running = _running(socket, config, rig_file)
    down = running is None and config.kind == "hardware" and HERE.unit.exists()
    if config.kind == "hardware":
        on_bus = config.links.can.interface == "socketcan"
        interface = look_at(config.links.can.channel) if on_bus else None
        if on_bus:
            yield check.check_interface(config, interface)
        elif config.links.can.interface == "slcan":
            yield check.check_port("CAN", config.links.can.channel, mine=running is None)
        if config.links.hall_port is not None:
            yield check.check_port("Hall port", config.links.hall_port, mine=running is None)
        if isinstance(config.links.torque, NetFtTorque):
            yield _network_sensor(config.links.torque)
    if down:
        # a daemon of our own would take the rig from a service that starts again
        said, _, todo = str(nobody_answers(sockets_for_client())).partition(": ")
        yield check.Finding("daemon", "fail", said, todo)
        return
    try:
        with _daemon(running, path) as client:
            state = client.state()
            yield state["rig"]["simulated"]
            yield check.check_version(state.get("version"))
            if config.links.can.interface == "socketcan":
                from needle_rig.devices.bus_watch import watch_bus

                frames, bits = watch_bus(config.links.can.channel, 1.0)
                yield check.check_load(bits, 1.0, frames.total(), look_at(config.links.can.channel))
            yield from _at_rest(client, config, calibration or HERE.calibration)
            if turn_deg is not None:
                yield from _moved(client, config, turn_deg)
    except NeedleRigError as error:
        yield check.Finding("daemon", "fail", str(error), "mend what failed above first")


def _network_sensor(sensor: NetFtTorque) -> Finding:
    """Whether the sensor's page can be read, and what it says."""
    from needle_rig.devices.ethernet import fetch_page
    from needle_rig.service.setup.check import Finding
    from needle_rig.wire.rdt import PAGE, decode_page

    try:
        page = decode_page(fetch_page(sensor.address, sensor.http_port, PAGE))
    except NeedleRigError as error:
        return Finding("torque sensor", "fail", str(error), "see links.torque in the rig file")
    said = f"{page.counts_per_nm:.6g} counts per N·m, {page.internal_rate_hz:g} samples/s"
    return Finding("torque sensor", "ok", f"{sensor.address}: {said}")


def _at_rest(client: DaemonClient, config: RigConfig, calibration: Path) -> Iterator[Finding]:
    from needle_rig.service.setup import check

    seen = _listen(client, _LISTEN_S)
    state = client.state()
    yield from check.check_ticks(state)
    yield from check.check_links(config, state)
    yield from check.check_firmware(state)
    quiet = state["phase"] != "moving" and seen
    if quiet:
        residual_nmm: float | None = None
        residuals_deg: list[float] = []
        try:
            residual_nmm, residuals_deg = _calibrated(calibration)
        except BadInput as error:
            yield check.Finding("calibration", "warn", str(error), "needle-rig calibrate")
        yield from check.check_noise(config, seen, residual_nmm, residuals_deg)
    yield from check.check_drive(state)


def _moved(client: DaemonClient, config: RigConfig, turn_deg: float) -> Iterator[Finding]:
    """Turn the base and back, with the display and the stop of every command that moves."""
    from needle_rig.cli._motion import commanding, end_as_by_ctrl_c, follow, moved, view
    from needle_rig.service.setup import check

    end_as_by_ctrl_c()
    seen = []
    with commanding(client, "check"):
        for by_deg in (turn_deg, -turn_deg):
            seen.append(_mean(_listen(client, 0.5)))
            jog = functools.partial(client.command, "jog", {"by_deg": by_deg})
            state = follow(client, jog, view(quiet=True), moved)
            if state["phase"] in ("fault", "aborted"):
                yield check.Finding(
                    "move", "fail", state["fault"] or "stopped by a person", "needle-rig clear"
                )
                return
    yield from check.check_move(config, seen[0], seen[1], turn_deg)


def _listen(client: DaemonClient, seconds_s: float) -> list[Sensors]:
    """Every measurement that the daemon tells in the next seconds."""
    seen: list[Sensors] = []
    end_s = time.monotonic() + seconds_s
    with client.stream() as documents:
        for document in documents:
            if document["type"] == "state" and document["sensors"] is not None:
                seen.append(document["sensors"])
            if time.monotonic() > end_s:
                break
    if not seen:
        raise RigFault("the daemon told no measurement; see what failed above")
    return seen


def _mean(seen: list[Sensors]) -> Sensors:
    """The newest measurement, with the means of torque and Hall angles over all."""
    last = seen[-1]
    torques = [each["torque_nmm"] for each in seen if each["torque_nmm"] is not None]
    halls = zip(*(each["hall_deg"] for each in seen), strict=True)
    means = [statistics.fmean(values) if None not in values else None for values in halls]
    return {**last, "torque_nmm": statistics.fmean(torques) if torques else None, "hall_deg": means}


def _running(socket: Path | None, config: RigConfig, rig_file: Path | None) -> DaemonClient | None:
    """The daemon that owns the rig; None where one must be started."""
    from needle_rig.service.client import find_daemon, the_daemon

    if socket is not None:
        return the_daemon(socket)
    found = find_daemon()
    if found is not None and rig_file is not None and (of := found.state()["rig"]["name"]) != config.name:
        raise BadInput(
            f"{rig_file}: is of {config.name!r}, but the daemon at {found.path} has {of!r}; stop it first"
        )
    return found


@contextmanager
def _daemon(running: DaemonClient | None, rig_file: Path) -> Iterator[DaemonClient]:
    from needle_rig.service.client import private_daemon

    if running is not None:
        yield running
        return
    with private_daemon([f"--config={rig_file}"]) as client:
        yield client


def _calibrated(folder: Path) -> tuple[float | None, list[float]]:
    """What calibration left: of the torque in N·mm, of each Hall sensor in degrees. Raises BadInput."""
    from needle_rig.calibration.kept import read_calibration

    torque, hall = (
        read_calibration(file) if (file := folder / name).is_file() else {}
        for name in ("torque.yaml", "hall.yaml")
    )
    residual = torque.get("worst_residual_nmm")
    found = hall.get("sensors")
    sensors = found if isinstance(found, list) else []
    return (
        float(residual) if isinstance(residual, int | float) else None,
        [
            float(each["residual_deg"])
            for each in sensors
            if isinstance(each, dict) and "residual_deg" in each
        ],
    )


def _that_exists(folder: Path) -> Path:
    """The folder, or the nearest above it that exists."""
    return next(each for each in (folder, *folder.absolute().parents) if each.exists())


def _first_line(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""


def _synchronized() -> bool | None:
    try:
        command = ["timedatectl", "show", "--property=NTPSynchronized", "--value"]
        said = subprocess.run(command, capture_output=True, text=True, timeout=5.0, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
    return {"yes": True, "no": False}.get(said)
