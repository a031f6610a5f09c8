"""The plant behind its nodes' firmware in virtual time: what the bench is in real time, without ports."""

from __future__ import annotations

import math
from collections.abc import Callable

from needle_rig.config.files import find_config_file
from needle_rig.config.schema import RigConfig
from needle_rig.records import Command, Measurement
from needle_rig.rig import RawReadings
from needle_rig.simulation.node_set import build_nodes
from needle_rig.simulation.plant import Array, Plant
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, CanCodec, DriveStatus, TorqueStatus
from needle_rig.wire.hall_frames import HallFrame, decode_hall

STEP_S = 0.001


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
        self._raw = raw
        self._heard = heard
        self._velocity_rad_s = 0.0
        self._left_s = 0.0
        self._ticks = 0
        self._sent = 0
        self.hall_frame: HallFrame | None = None
        """The newest frame of the Hall node."""
        self.hand_rad_s = 0.0
        """How fast a person turns the base while the bridge is off."""
        self._angle_rad: list[float] | None = None
        self._measurement = plant.read()
        self.step()

    async def open(self) -> None:
        """Nothing to connect."""

    async def close(self) -> None:
        """Nothing to release."""

    @property
    def time_s(self) -> float:
        """Virtual time."""
        return self.plant.time_s

    def shaft_rad(self) -> Array:
        """True angle of every node of the shaft."""
        return self.plant.shaft_rad()

    def read(self) -> Measurement:
        """What the nodes said last."""
        return self._measurement

    def write(self, command: Command) -> None:
        """Send one command frame to the drive node."""
        self._sent += 1
        self.send(DRIVE_COMMAND_ID, self.codec.encode_command(command, self._sent, self._sent))

    def send(self, frame_id: int, data: bytes) -> None:
        """Put any frame on the bus."""
        self.nodes.drive.receive(self._ticks * 1000, frame_id, data)

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` pass; what does not fill a millisecond waits for the next call."""
        self._left_s += dt_s
        while self._left_s >= STEP_S - 1e-9:
            self._left_s -= STEP_S
            self.step()

    def step(self, *, torque_plugged: bool = True) -> None:
        """One millisecond: world, then every node once."""
        self._ticks += 1
        nodes, now_us = self.nodes, self._ticks * 1000
        if self.hand_rad_s and not nodes.drive.powered:
            self.plant.turn(self.hand_rad_s, STEP_S)
        else:
            self.plant.turn(self._velocity_rad_s, STEP_S, powered=nodes.drive.powered)
        counts = nodes.inputs(self.plant.read())
        torque_id, torque = nodes.torque.step(now_us, counts.torque)
        if torque_plugged:
            nodes.drive.receive(now_us, torque_id, torque)
        (drive_id, drive), self._velocity_rad_s = nodes.drive.step(now_us, counts.encoder)
        hall = nodes.hall.step(now_us, counts.hall)
        if self._heard is not None:
            for frame in (torque, drive, hall):
                self._heard(frame)
        self._take(self.codec.decode(torque_id, torque), self.codec.decode(drive_id, drive), hall)

    def _take(self, torque: object, drive: object, hall: bytes) -> None:
        angles = decode_hall(hall[:-1])
        assert isinstance(torque, TorqueStatus)
        assert isinstance(drive, DriveStatus)
        assert angles is not None
        self.hall_frame = angles
        before = self._angle_rad or [0.0] * len(angles.angle_rad)
        self._angle_rad = [
            last + math.remainder(angle - last, math.tau)
            for last, angle in zip(before, angles.angle_rad, strict=True)
        ]
        self._measurement = Measurement(
            time_s=self.plant.time_s,
            base_angle_rad=drive.angle_rad,
            torque_nm=torque.torque_nm,
            hall_rad=tuple(self._angle_rad),
            drive_state=drive.state,
            drive_faults=drive.faults,
            torque_age_s=0.0,
            hall_age_s=0.0,
            drive_age_s=0.0,
        )
        if self._raw is not None:
            time_s = self.plant.time_s
            self._raw("torque", (time_s, torque.node_time_s, float(torque.counter), torque.torque_nm))
            self._raw("hall", (time_s, angles.node_time_s, float(angles.counter), *self._angle_rad))
            drive_row = (drive.angle_rad, float(drive.state), float(drive.faults))
            self._raw("drive", (time_s, drive.node_time_s, float(drive.counter), *drive_row))
