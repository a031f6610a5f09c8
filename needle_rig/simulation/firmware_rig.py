"""The plant behind its nodes' firmware in virtual time: what the bench is in real time, without ports."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import RigConfig
from needle_rig.numerics import Array
from needle_rig.records import Command, DriveFault, Firmware, Measurement
from needle_rig.rig import RawReadings
from needle_rig.simulation.faults import Faults, Links, over_index
from needle_rig.simulation.nodes.node_set import build_nodes
from needle_rig.simulation.plant import Plant
from needle_rig.wire.can_frames import (
    DRIVE_COMMAND_ID,
    DRIVE_REFERENCE_ID,
    TORQUE_OK,
    CanCodec,
    CanContent,
    DriveCommand,
    DriveHealth,
    DriveReference,
    DriveStatus,
    TorqueStatus,
)
from needle_rig.wire.hall_frames import HallFrame, decode_hall
from needle_rig.wire.hall_turns import HallTurns
from needle_rig.wire.node_identity import NodeIdentity

STEP_S = 0.001
HEALTH_PERIOD_S = 0.01
FRESH_S = 0.1
LONGEST_START_TICKS = 200


class FirmwareRig:
    """Implements Rig: every value was made by a node and every command was judged by one.

    Time passes in `advance` alone, a millisecond at a time. `heard` receives each frame that a node sent.
    Raises BadInput when the nodes of `config` cannot be made.
    """

    def __init__(
        self,
        config: RigConfig,
        plant: Plant,
        *,
        raw: RawReadings | None = None,
        heard: Callable[[bytes], None] | None = None,
    ) -> None:
        self.plant = plant
        self.codec = CanCodec(find_config_file("needle_rig.dbc"))
        self.nodes = build_nodes(config, self.codec)
        self.links = Links()
        """Between the nodes and the host."""
        self._raw = raw
        self._heard = heard
        self._velocity_rad_s = 0.0
        self._left_s = 0.0
        self._ticks = 0
        self._sent = 0
        self._own = False
        self.hall_frame: HallFrame | None = None
        """The newest frame of the Hall node."""
        self.hand_rad_s = 0.0
        """How fast a person turns the base while the bridge is off."""
        names = tuple(sensor.name for sensor in config.layout.hall_sensors)
        self._hall = HallTurns(names)
        self._identities = {node: NodeIdentity(self.codec, node) for node in ("torque", "drive")}
        self._newest: dict[str, tuple[int, float]] = {}
        self._measurement = plant.read()
        for _ in range(LONGEST_START_TICKS):  # as a host waits for the first reading of every link
            self.step()
            now = self.read()
            if max(now.torque_age_s, now.hall_age_s, now.drive_age_s) < math.inf:
                break

    async def open(self) -> None:
        """Nothing to connect."""

    def firmware(self) -> dict[str, Firmware]:
        """See `Rig.firmware`."""
        return {node: each.told(self.plant.time_s) for node, each in self._identities.items()}

    async def close(self) -> None:
        """Nothing to release."""

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self.plant.time_s

    def shaft_rad(self) -> Array:
        """True angle of every node of the shaft."""
        return self.plant.shaft_rad()

    @property
    def sent(self) -> int:
        """How many commands the host has sent: its counter and heartbeat."""
        return self._sent

    @property
    def faults(self) -> Faults:
        """What is broken in the machine."""
        return self.plant.faults

    @property
    def true_base_rad(self) -> float:
        """True angle of the motor's shaft."""
        return self.plant.true_base_rad

    def read(self) -> Measurement:
        """What the nodes said last, with its age."""
        now_s = self.plant.time_s
        ages_s = {link: now_s - at_s for link, (_, at_s) in self._newest.items()}
        refused = {node: identity.refusal for node, identity in self._identities.items()}
        drive_age_s = max(ages_s.get("drive", math.inf), ages_s.get("health", math.inf) - HEALTH_PERIOD_S)
        return replace(
            self._measurement,
            time_s=now_s,
            torque_age_s=math.inf if refused["torque"] else ages_s.get("torque", math.inf),
            torque_complaint=refused["torque"],
            drive_age_s=math.inf if refused["drive"] else drive_age_s,
            drive_complaint=refused["drive"],
            hall_age_s=max(ages_s.get("hall", math.inf), now_s - self._hall.healthy_s),
            hall_complaint=self._hall.complaint,
        )

    def write(self, command: Command) -> None:
        """Send one command frame to the drive node, and the reference that comes with it."""
        if command.release or self._identities["drive"].refusal:
            return
        self._sent += 1
        self._own = True
        self.send(DRIVE_COMMAND_ID, self.codec.encode_command(command, self._sent, self._sent))
        if command.reference_rad is not None:
            reference = self.codec.encode_reference(command.reference_rad, self._sent, self._sent)
            self.send(DRIVE_REFERENCE_ID, reference)
            self._hall.refer(command.reference_rad)
        self._own = False

    def send(self, frame_id: int, data: bytes) -> None:
        """Put any frame on the bus; the host takes a command for the drive that is not its own as foreign."""
        if self._own:
            arrived = self.links.command.through(data, self.plant.time_s, frame_id)
            if arrived is not None:
                self.nodes.drive.receive(self._ticks * 1000, frame_id, arrived)
            return
        self.nodes.drive.receive(self._ticks * 1000, frame_id, data)
        if isinstance(self.codec.decode(frame_id, data), DriveCommand | DriveReference):
            foreign = self._measurement.foreign_commands + 1
            self._measurement = replace(self._measurement, foreign_commands=foreign)

    def reset_drive(self) -> None:
        """The drive node restarts: it is silent and its counts start at zero."""
        self.nodes.drive.reset(self._ticks * 1000)

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` pass; what does not fill a millisecond waits for the next call."""
        self._left_s += dt_s
        while self._left_s >= STEP_S - 1e-9:
            self._left_s -= STEP_S
            self.step()

    def step(self) -> None:
        """One millisecond: world, then every node once."""
        self._ticks += 1
        nodes, plant, now_us = self.nodes, self.plant, self._ticks * 1000
        if self.hand_rad_s and not nodes.drive.powered:
            plant.turn_by_hand(self.hand_rad_s, STEP_S)
        else:
            plant.supply_on = nodes.drive.supply_on
            plant.turn(self._velocity_rad_s, STEP_S, powered=nodes.drive.powered)
        counts = nodes.inputs(plant.read())
        torque = nodes.torque.step(now_us, counts.torque)
        arrived = [(each, self.links.torque.through(data, plant.time_s, each)) for each, data in torque]
        for frame_id, reached in arrived:
            if reached is not None:
                nodes.drive.receive(now_us, frame_id, reached)
        drive, self._velocity_rad_s = nodes.drive.step(
            now_us,
            counts.encoder,
            index=over_index(plant.true_base_rad),
            emergency_stop=plant.faults.emergency_stop,
        )
        faded = self.links.hall_faded
        pairs = (
            [nodes.no_field if i in faded else pair for i, pair in enumerate(counts.hall)]
            if faded
            else counts.hall
        )
        hall = nodes.hall.step(now_us, pairs)
        if self._heard is not None:
            for frame in (*(data for _, data in (*torque, *drive)), hall):
                self._heard(frame)
        for frame_id, reached in arrived:
            self._take_torque(None if reached is None else self.codec.decode(frame_id, reached))
        for frame_id, data in drive:
            reached = self.links.drive.through(data, plant.time_s, frame_id)
            self._take_drive(None if reached is None else self.codec.decode(frame_id, reached))
        self._take_hall(self.links.hall.through(hall, plant.time_s))

    def _is_news(self, link: str, counter: int) -> bool:
        """Whether a frame is newer than the one before; then its link's age counts from now."""
        if link in self._newest and self._newest[link][0] == counter:
            return False
        self._newest[link] = (counter, self.plant.time_s)
        return True

    def _take_torque(self, content: CanContent | None) -> None:
        identity = self._identities["torque"]
        identity.take(content, self.plant.time_s)
        if not isinstance(content, TorqueStatus) or identity.refusal:
            return
        if self._raw is not None:
            row = (self.plant.time_s, content.node_time_s, float(content.counter), content.torque_nm)
            self._raw("torque", row)
        if content.state == TORQUE_OK and self._is_news("torque", content.counter):
            self._measurement = replace(self._measurement, torque_nm=content.torque_nm)

    def _take_drive(self, content: CanContent | None) -> None:
        identity = self._identities["drive"]
        identity.take(content, self.plant.time_s)
        if identity.refusal:
            return
        if isinstance(content, DriveHealth) and self._is_news("health", content.counter):
            self._measurement = replace(
                self._measurement,
                drive_faults=self._measurement.drive_faults & 0xFF | content.faults,
                referenced=content.referenced,
                supply_on=content.supply_on,
                emergency_stop=content.emergency_stop,
                index_rad=content.index_rad,
            )
        if not isinstance(content, DriveStatus):
            return
        faults = content.faults | self._measurement.drive_faults & ~0xFF
        if self._raw is not None:
            row = (self.plant.time_s, content.node_time_s, float(content.counter), content.angle_rad)
            self._raw("drive", (*row, float(content.state), float(faults)))
        if self._is_news("drive", content.counter):
            self._measurement = replace(
                self._measurement,
                base_angle_rad=content.angle_rad,
                drive_state=content.state,
                drive_faults=DriveFault(faults),
            )

    def _take_hall(self, data: bytes | None) -> None:
        frame = None if data is None else decode_hall(data[:-1])
        if frame is None or not self._is_news("hall", frame.counter):
            return
        self.hall_frame = frame
        now_s = self.plant.time_s
        fresh = now_s - self._newest["drive"][1] < FRESH_S if "drive" in self._newest else False
        base_rad = self._measurement.base_angle_rad if fresh else math.nan
        self._hall.take(frame.angle_rad, frame.complaints, now_s, base_rad)
        self._measurement = replace(self._measurement, hall_rad=self._hall.angle_rad)
        if self._raw is not None:
            self._raw("hall", (now_s, frame.node_time_s, float(frame.counter), *self._hall.angle_rad))
