"""The plant behind its nodes in real time: absolute deadlines, ports of the machine, faults on request."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import RigConfig
from needle_rig.records import DriveState, Measurement
from needle_rig.simulation.bench.bench_lines import Said
from needle_rig.simulation.bench.socketcan_port import SocketCanPort
from needle_rig.simulation.faults import Faults, Link, over_index
from needle_rig.simulation.nodes.cia402_node import Cia402Node
from needle_rig.simulation.nodes.netft_sensor import NetFtPorts
from needle_rig.simulation.nodes.node_set import build_nodes
from needle_rig.simulation.nodes.slcan_hub import CanPort, Frame, Pty, SlcanHub, SlcanPort
from needle_rig.units import deg, rad
from needle_rig.wire.can_frames import CanCodec, DriveCommand

LINKS = ("torque", "drive", "hall", "can")
FAULTS = {
    "unplug": "off the bus; for hall and can the port hangs up",
    "silence": "sends nothing",
    "garble": "sends random bytes",
    "freeze": "repeats its last frame",
    "fade": "for hall: the magnet of the last sensor is out of reach",
    "restore": "works again",
}
MACHINE = {
    "encoder": ("stick", "halve", "reverse", "restore"),
    "motor": ("short", "dead", "reverse", "restore"),
    "coupling": ("slip", "restore"),
    "torque-cell": ("dead", "stick", "restore"),
    "estop": ("press", "restore"),
}
"""What else can be made to break, and how; `drive reset` restarts the drive, `drive emergency` breaks one of
another make from within."""
LONGEST_DELAY_MS = 1000.0
"""Four times the oldest value that a shipped rig uses."""
_EMERGENCY_CODE = 0x2310
_GIVE_UP_S = 0.03
_REGAIN = 0.2
_REGAIN_AT_MOST_S = 0.5
_STEPS_A_WAKE = 12
_HANDED_OVER_S = 0.008
"""At rest what the nodes send is handed over so often at least: half of what a USB adapter takes, and more
than a tick of 200 Hz, so that a host's commands set the pace. To wake up for a step costs more than it."""
_TOO_OFTEN = 5
_ALL_OF_A_CORE = 0.8
_HAND_RAD_S = rad(120.0)
_SHORTED_RAD_S = rad(180.0)
"""The speed of the simulated motor at full duty."""


class WorldPlant(Protocol):
    """What the bench needs of the plant."""

    faults: Faults
    supply_on: bool

    @property
    def true_base_rad(self) -> float:
        """True angle of the motor's shaft."""

    def read(self) -> Measurement:
        """Sensor values now."""

    def turn(self, velocity_rad_s: float, dt_s: float, *, powered: bool = True) -> None:
        """Let the world go on for `dt_s` with this command at the motor."""

    def turn_by_hand(self, velocity_rad_s: float, dt_s: float) -> None:
        """The same, with the base turned by a person."""


class BenchLoop:
    """Plant, nodes and ports. `say` receives what happens, as objects for JSON.

    The nodes on CAN are on the SocketCAN `interface` when one is named, else on an slcan port in `ports`.
    """

    def __init__(
        self,
        config: RigConfig,
        plant: WorldPlant,
        ports: Path,
        say: Callable[[Said], None],
        interface: str | None = None,
    ) -> None:
        if config.simulation is None:
            raise ValueError("a bench needs the simulation section")
        self._plant = plant
        self._say = say
        self._loop_hz = config.simulation.sensor_rate_hz
        self._codec = CanCodec(find_config_file("needle_rig.dbc"))
        nodes = build_nodes(config, self._codec)
        self._torque, self._hall, self._drive = nodes.torque, nodes.hall, nodes.drive
        self._netft = None if nodes.netft is None else NetFtPorts(nodes.netft)
        self._inputs, self._front_end = nodes.inputs, nodes.front_end
        self._no_field = nodes.no_field
        self._by_hand_rad = 0.0
        self._taps = {link: Link(seed=seed) for seed, link in enumerate(LINKS)}
        self._hub = SlcanHub()
        self._ports_folder = ports
        self._interface = interface
        self._can_port: CanPort | None = None
        self._hall_port: Pty | None = None
        self._plug_can()
        self._plug_hall()
        self._hub.attach(self._on_bus)
        self._now_us = 0
        self._start_s = 0.0
        self._behind_s = 0.0
        self._regain_s = 0.0
        self._late_at_s = 0.0
        self._late_in_a_row = 0
        self._late_since = (0.0, 0.0)
        self._last_command: tuple[bool, bool] | None = None
        self._last_state: Any = None
        self._velocity_rad_s = 0.0
        self._base_rad = plant.true_base_rad
        """Before the newest step."""

    @property
    def ports(self) -> dict[str, str]:
        """Where the rig's links are."""
        can, hall = (str(self._ports_folder / name) for name in ("can", "hall"))
        network = {} if self._netft is None else {"torque": self._netft.place}
        return {"can": self._interface or can, "hall": hall, **network}

    def run(self, control_fd: int, *, end_with_control: bool = True) -> None:
        """Run until `control_fd` ends; commands come from it, a line each."""
        rest = b""
        self._start_s = deadline_s = time.monotonic()
        watched: list[Any] = [control_fd]
        sockets = [] if self._netft is None else self._netft.waited_on
        while True:
            ports = [self._can_port] if self._can_port is not None else []
            wake_s = deadline_s + self._rest_s
            ready, _, _ = select.select(
                [*watched, *ports, *sockets], [], [], max(wake_s - time.monotonic(), 0.0)
            )
            spoken = self._can_port in ready
            for _ in range(_STEPS_A_WAKE):
                late_s = time.monotonic() - max(wake_s, deadline_s)
                if late_s > _GIVE_UP_S:
                    self._stand_still(late_s)
                    deadline_s += late_s
                    wake_s += late_s
                if deadline_s > time.monotonic():
                    break
                if spoken and deadline_s >= wake_s:
                    # commands of the meantime are heard before a drive looks at its clock
                    self._serve(deadline_s)
                self._now_us = round((deadline_s - self._start_s) * 1e6)
                self._step()
                deadline_s += 1.0 / self._loop_hz - self._regained_s()
                spoken = True
            if spoken:
                # where steps are still due, the nodes' clocks are behind
                self._serve(min(time.monotonic(), deadline_s))
            self._hand_over()
            for asked in sockets:
                if asked in ready and self._netft is not None:
                    self._netft.serve(asked)
            if control_fd in ready:
                text = os.read(control_fd, 4096)
                if not text and end_with_control:
                    return
                if not text:
                    watched.clear()
                *lines, rest = (rest + text).split(b"\n")
                for line in lines:
                    self._obey(line.decode("utf-8", "replace").split())

    @property
    def _rest_s(self) -> float:
        """How much longer than to its next step the bench may sleep, unless it is spoken to."""
        moves = (
            self._drive.state is DriveState.RUNNING
            or self._plant.true_base_rad != self._base_rad
            or self._by_hand_rad
        )
        return 0.0 if moves else max(_HANDED_OVER_S - 1.0 / self._loop_hz, 0.0)

    def close(self) -> None:
        """Hang up every port."""
        for port in self._hub.ports:
            port.close()
        if self._hall_port is not None:
            self._hall_port.close()
        if self._netft is not None:
            self._netft.close()
        for name in ("can", "hall"):
            (self._ports_folder / name).unlink(missing_ok=True)

    def _stand_still(self, late_s: float) -> None:
        """The machine was away. The world and the nodes' clocks stood still: a drive that looked at its clock
        now would blame a host that may have been away too.
        """
        self._start_s += late_s
        self._behind_s += late_s
        if late_s <= _REGAIN_AT_MOST_S:
            self._regain_s += late_s
        self._say({"event": "late", "late_s": round(late_s, 4)})
        now_s, cpu_s = time.monotonic(), time.process_time()
        if now_s - self._late_at_s > 1.0:
            self._late_in_a_row, self._late_since = 0, (now_s, cpu_s)
        self._late_at_s = now_s
        self._late_in_a_row += 1
        since_s, cpu_since_s = self._late_since
        if self._late_in_a_row >= _TOO_OFTEN and cpu_s - cpu_since_s > _ALL_OF_A_CORE * (now_s - since_s):
            be_urgent(False)

    def _regained_s(self) -> float:
        """How much sooner the next step comes. Clocks that stay behind would make fresh data look old for
        ever; after a pause of more than a quarter of a second a host takes them for new clocks anyway.
        """
        regained_s = min(self._regain_s, _REGAIN / self._loop_hz)
        self._regain_s -= regained_s
        self._behind_s -= regained_s
        self._start_s -= regained_s
        return regained_s

    def _step(self) -> None:
        dt_s = 1.0 / self._loop_hz
        self._base_rad = self._plant.true_base_rad
        if self._by_hand_rad and not self._drive.powered:
            turn = math.copysign(min(abs(self._by_hand_rad), _HAND_RAD_S * dt_s), self._by_hand_rad)
            self._by_hand_rad -= turn
            self._plant.turn_by_hand(turn / dt_s, dt_s)
        else:
            self._plant.supply_on = self._drive.supply_on
            self._plant.turn(self._velocity_rad_s, dt_s, powered=self._drive.powered)
        now_us, counts = self._now_us, self._inputs(self._plant.read())
        if self._netft is not None:
            record = self._netft.sensor.step(now_us, counts.torque)
            self._netft.send((self._taps["torque"].through(record, now_us * 1e-6) if record else None) or b"")
        else:
            for frame in self._torque.step(now_us, counts.torque):
                self._send("torque", frame)
        frames, self._velocity_rad_s = self._drive.step(
            now_us,
            counts.encoder,
            index=over_index(self._plant.true_base_rad),
            emergency_stop=self._plant.faults.emergency_stop,
        )
        for frame in frames:
            self._send("drive", frame)
        if self._drive.state is not self._last_state:
            self._last_state = self._drive.state
            faults = int(self._drive.faults)
            late_s = time.monotonic() - self._start_s - now_us * 1e-6
            state = self._last_state.name.lower()
            self._say({"event": "drive", "state": state, "faults": faults, "late_s": round(late_s, 6)})
        hall = self._taps["hall"]
        pairs = (*counts.hall[:-1], self._no_field) if hall.fault == "fade" else counts.hall
        sent = self._hall.step(now_us, pairs)
        data = hall.through(sent, now_us * 1e-6) if sent else None
        if self._hall_port is not None:
            self._hall_port.write(data or b"")

    def _serve(self, at_s: float) -> None:
        """Let the nodes hear what came into the CAN port, at this instant."""
        self._now_us = round((at_s - self._start_s) * 1e6)
        if self._can_port is not None:
            self._hub.serve(self._can_port)

    def _hand_over(self) -> None:
        """What the nodes sent since the last time; Hall and CAN together."""
        if self._hall_port is not None:
            self._hall_port.flush()
        self._hub.flush()

    def _send(self, link: str, frame: Frame) -> None:
        now_s = self._now_us * 1e-6
        data = self._taps[link].through(frame[1], now_s, frame[0])
        if data is None:
            return
        if link == "torque" and self._taps["drive"].fault != "unplug":
            self._drive.receive(self._now_us, frame[0], data)
        if self._taps["can"].fault == "garble" and self._can_port is not None:
            self._can_port.send_garbled(
                (frame[0], data), lambda line: self._taps["can"].through(line, now_s) or b""
            )
        elif not self._taps["can"].fault:
            self._hub.send((frame[0], data), sender=self._on_bus)

    def _on_bus(self, frame: Frame) -> None:
        """A frame that came in through a port."""
        content = self._codec.decode(*frame)
        if isinstance(content, DriveCommand):
            asked = (content.command.enable, content.command.clear)
            if asked != self._last_command:
                self._last_command = asked
                self._say({"event": "command", "enable": asked[0], "clear": asked[1]})
        if self._taps["drive"].fault != "unplug" and not self._taps["can"].fault:
            self._drive.receive(self._now_us, *frame)

    def _obey(self, words: list[str]) -> None:
        if words == ["status"]:
            now = self._plant.read()
            self._say(
                {
                    "base_deg": round(deg(now.base_angle_rad), 4),
                    "true_base_deg": round(deg(self._plant.true_base_rad), 4),
                    "supply_on": self._drive.supply_on,
                    "velocity_deg_s": round(deg(self._velocity_rad_s), 4),
                    "drive": self._drive.state.name.lower(),
                    "faults": {link: tap.fault for link, tap in self._taps.items() if tap.fault},
                    "node_clock_zero_s": self._start_s,
                    "plant_s": round(now.time_s, 3),
                    "behind_s": round(self._behind_s, 4),
                    "cpu_s": round(time.process_time(), 3),
                }
            )
        elif len(words) == 2 and words[0] in LINKS and words[1] in FAULTS:
            link, fault = words
            tap = self._taps[link]
            tap.fault = "" if fault == "restore" else fault
            tap.delay_s = 0.0
            if link == "hall" and fault in ("unplug", "restore"):
                self._plug_hall(fault == "restore")
            if link == "torque" and self._netft is not None:
                self._netft.plugged = fault != "unplug"
            if link == "can" and fault in ("unplug", "restore"):
                self._plug_can(fault == "restore")
            self._say({"event": "fault", "link": link, "fault": fault})
        elif len(words) == 3 and words[0] in LINKS and words[1] == "delay":
            self._delay(words[0], words[2])
        elif words == ["drive", "reset"]:
            self._drive.reset(self._now_us)
            self._say({"event": "fault", "link": "drive", "fault": "reset"})
        elif len(words) == 3 and words[1] == "protocol":
            self._speak(words[0], words[2])
        elif words == ["drive", "emergency"] and isinstance(self._drive, Cia402Node):
            self._drive.fail(_EMERGENCY_CODE)
            self._say({"event": "fault", "link": "drive", "fault": "emergency"})
        elif len(words) == 2 and words[1] in MACHINE.get(words[0], ()):
            self._break(*words)
            self._say({"event": "fault", "link": words[0], "fault": words[1]})
        elif len(words) == 2 and words[0] in ("turn", "weigh"):
            self._handle(*words)
        elif words:
            links = "|".join(LINKS)
            choices = [f"{links} {'|'.join(FAULTS)}", f"{links} delay MS", "drive reset|emergency"]
            choices += ["torque|drive protocol N|none"]
            choices += [f"{place} {'|'.join(ways)}" for place, ways in MACHINE.items()]
            self._say({"error": f"{' '.join(words)!r}: give one of: {'; '.join(choices)}; or: status"})

    def _delay(self, link: str, amount: str) -> None:
        """What a node sends arrives so many milliseconds later; `restore` ends it."""
        try:
            delay_ms = float(amount)
        except ValueError:
            delay_ms = math.nan
        if not 0.0 <= delay_ms <= LONGEST_DELAY_MS:
            self._say({"error": f"{link} delay {amount!r}: give milliseconds, 0 to {LONGEST_DELAY_MS:g}"})
            return
        self._taps[link].delay_s = delay_ms * 1e-3
        self._say({"event": "fault", "link": link, "fault": f"delay {amount}"})

    def _speak(self, node: str, protocol: str) -> None:
        """A node restarts with a firmware of another protocol, or with one that says nothing of itself."""
        nodes = {"torque": self._torque, "drive": self._drive}
        introduction = getattr(nodes.get(node), "introduction", None)
        number = None if protocol == "none" else int(protocol) if protocol.isdecimal() else -1
        if introduction is None or (number is not None and not 0 <= number <= 255):
            self._say({"error": f"{node} protocol {protocol!r}: give torque or drive, and 0 to 255 or none"})
            return
        introduction.protocol = number
        introduction.reset()
        if node == "drive":
            self._drive.reset(self._now_us)
        self._say({"event": "fault", "link": node, "fault": f"protocol {protocol}"})

    def _break(self, place: str, how: str) -> None:
        """Break a part of the machine, or mend it: an encoder counts on from what it showed."""
        faults = self._plant.faults
        if place == "encoder":
            faults.encoder.stuck = how == "stick"
            faults.encoder.gain = {"halve": 0.5, "reverse": -1.0}.get(how, 1.0)
        elif place == "motor":
            faults.shorted_rad_s = _SHORTED_RAD_S if how == "short" else None
            faults.motor_gain = {"dead": 0.0, "reverse": -1.0}.get(how, 1.0)
        elif place == "coupling":
            faults.coupling_slip = 1.0 if how == "slip" else 0.0
        elif place == "torque-cell":
            faults.torque.dead_at = 0.0 if how == "dead" else None
            faults.torque.stuck = how == "stick"
        else:
            faults.emergency_stop = how == "press"

    def _handle(self, what: str, amount: str) -> None:
        """What a person does: turn the base by hand (degrees), hang a weight on the cell (N·mm)."""
        try:
            value = float(amount)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or abs(value) > 3600:
            self._say({"error": f"{what} {amount!r}: give degrees (turn) or N.mm (weigh), 3600 at most"})
        elif what == "turn":
            self._by_hand_rad += rad(value)
            self._say({"event": "turn", "turn_deg": value})
        elif self._front_end is None:
            self._say({"error": "weigh: only the firmware's load cell takes weights (simulation.nodes)"})
        else:
            self._front_end.weight_nmm = value
            self._say({"event": "weigh", "weight_nmm": value})

    def _plug_can(self, plugged: bool = True) -> None:
        if plugged and self._can_port is None:
            self._can_port = SlcanPort() if self._interface is None else SocketCanPort(self._interface)
            self._hub.plug(self._can_port)
            if self._interface is None:
                self._link("can", self._can_port.name)
        elif not plugged and self._can_port is not None:
            self._hub.remove_port(self._can_port)
            self._can_port = None
            if self._interface is None:
                (self._ports_folder / "can").unlink()

    def _plug_hall(self, plugged: bool = True) -> None:
        if plugged and self._hall_port is None:
            self._hall_port = Pty()
            self._link("hall", self._hall_port.name)
        elif not plugged and self._hall_port is not None:
            self._hall_port.close()
            self._hall_port = None
            (self._ports_folder / "hall").unlink()

    def _link(self, name: str, target: str) -> None:
        """A name that stays when a port is pulled and plugged in again."""
        with (
            tempfile.TemporaryDirectory(dir=self._ports_folder) as folder,
            contextlib.suppress(FileExistsError),
        ):
            link = Path(folder) / name
            link.symlink_to(target)
            link.replace(self._ports_folder / name)


def be_urgent(urgent: bool = True) -> None:
    """Run before ordinary programs where the system allows it: a rig does not wait for the machine.

    Not for a bench that is late because it needs more than a core: it would leave nothing to the others.
    """
    policy, priority = (os.SCHED_FIFO, 1) if urgent else (os.SCHED_OTHER, 0)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, policy, os.sched_param(priority))


def speak(stream_fd: int) -> Callable[[Said], None]:
    """A `say` that writes one JSON line, with the time, or drops it when nobody reads."""
    os.set_blocking(stream_fd, False)

    def say(what: Said) -> None:
        line = json.dumps({**what, "time_s": round(time.monotonic(), 6)}) + "\n"
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(stream_fd, line.encode())

    return say
