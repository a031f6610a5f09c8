"""Every way in which a rig is broken, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass

from campaigns.rig.hazard import growing
from campaigns.rig.hazard.needle import SpringNeedle
from campaigns.rig.hazard.trial import Inject, Trial
from needle_rig.records import Command
from needle_rig.units import nm, rad

BOTH, OWN, OTHER = ("own", "cia402"), ("own",), ("cia402",)
OVER_CURRENT, CAN_PASSIVE = 0x2310, 0x8120


@dataclass(frozen=True)
class Fault:
    """One thing that breaks. `turns_deg_s` and `turns_times` say how fast the motor turns then, by itself or
    as a multiple of what it is asked."""

    inject: Inject
    turns_deg_s: float = 0.0
    turns_times: float = 1.0
    lies_by_little: bool = False
    """An encoder that the node cannot tell from a true one: the host sees it by the Hall angles alone."""
    drives: tuple[str, ...] = BOTH
    watch_s: float = 1.2
    """How long to look at least: until what was pressed is released, and a while after."""
    slow: bool = False
    """It shows after tens of seconds: broken in scenes that last as long, and in those alone."""

    def turning_deg_s(self, speed_deg_s: float) -> float:
        """How fast the motor turns at most, asked for `speed_deg_s`."""
        return max(self.turns_deg_s, self.turns_times * speed_deg_s)


def change(what: object, **changes: object) -> None:
    """Set fields."""
    for name, value in changes.items():
        setattr(what, name, value)


def encoder(**changes: object) -> Inject:
    """The encoder, changed so from now on."""
    return lambda trial: change(trial.rig.faults.encoder, **changes)


def torque(**changes: object) -> Inject:
    """The torque cell."""
    return lambda trial: change(trial.rig.faults.torque, **changes)


def hall(**changes: object) -> Inject:
    """One of the Hall sensors, any."""
    return lambda trial: change(trial.rig.faults.hall_reading(trial.any_sensor()), **changes)


def machine(**changes: object) -> Inject:
    """Motor, power stage, coupling, emergency stop."""
    return lambda trial: change(trial.rig.faults, **changes)


def link(name: str, **changes: object) -> Inject:
    """The frames of one link."""
    return lambda trial: change(getattr(trial.rig.links, name), **changes)


def spoil(*fields: str) -> Inject:
    """Values that reach the host as no numbers, as a device file of one's own may give them."""
    return lambda trial: trial.spoilt.update(fields)


def fade(trial: Trial) -> None:
    """A magnet out of reach."""
    trial.rig.links.hall_faded.add(trial.any_sensor())


def shorted(speed_deg_s: float) -> Fault:
    """The motor turns by itself, one way or the other."""
    return Fault(
        lambda trial: change(trial.rig.faults, shorted_rad_s=trial.any_way() * rad(speed_deg_s)),
        turns_deg_s=speed_deg_s,
    )


def master(*, follows: bool) -> Inject:
    """Another master that wants 60°/s, with a counter of its own or the host's."""

    def inject(trial: Trial) -> None:
        wish = Command(velocity_rad_s=trial.any_way() * rad(60.0), enable=True)
        ahead = 1 if follows else trial.random.randrange(1000, 60000)
        trial.every_ms(5, lambda trial: trial.rig.foreign(wish, number=ahead))

    return inject


def replay(trial: Trial) -> None:
    """Frames of a faster motion, recorded a while ago, once more."""
    wish = Command(velocity_rad_s=rad(trial.direction * 60.0), enable=True)
    trial.every_ms(5, lambda trial: trial.rig.foreign(wish, number=-500))


def held_tip(trial: Trial) -> None:
    """The needle is caught: its tip stays where it is."""
    plant = trial.rig.plant
    plant.model = SpringNeedle.caught(plant.model, len(plant.shaft_rad()))


def for_a_while(seconds: float, begin: Inject, end: Inject) -> Inject:
    """`begin` now, `end` later."""

    def inject(trial: Trial) -> None:
        begin(trial)
        trial.after_s(seconds, end)

    return inject


def press(seconds: float) -> Fault:
    """The emergency stop, pressed so long."""
    pressed = for_a_while(seconds, machine(emergency_stop=True), machine(emergency_stop=False))
    return Fault(pressed, watch_s=seconds + 1.5)


def silent(name: str, seconds: float) -> Fault:
    """A link that comes back."""
    return Fault(
        for_a_while(seconds, link(name, fault="silence"), link(name, fault="")), watch_s=seconds + 1.2
    )


FAULTS: dict[str, Fault] = {
    "encoder stands still": Fault(encoder(stuck=True)),
    "encoder reads half": Fault(encoder(gain=0.5)),
    "encoder reads double": Fault(encoder(gain=2.0)),
    "encoder counts backwards": Fault(encoder(gain=-1.0)),
    "encoder jumps by 90°": Fault(encoder(offset=rad(90.0))),
    "encoder jumps by -10°": Fault(encoder(offset=rad(-10.0))),
    "encoder reads 0": Fault(encoder(dead_at=0.0)),
    "encoder reads 1.05": Fault(encoder(gain=1.05), lies_by_little=True),
    "encoder reads 0.95": Fault(encoder(gain=0.95), lies_by_little=True),
    "encoder reads 0.9": Fault(encoder(gain=0.9), lies_by_little=True),
    "encoder reads 0.7": Fault(encoder(gain=0.7), lies_by_little=True),
    "encoder creeps 0.05°/s": Fault(growing.encoder_creeps(0.05), lies_by_little=True, slow=True),
    "encoder creeps 0.1°/s": Fault(growing.encoder_creeps(0.1), lies_by_little=True, slow=True),
    "encoder creeps 0.3°/s": Fault(growing.encoder_creeps(0.3), lies_by_little=True, slow=True),
    "encoder fades to half in 20 s": Fault(growing.encoder_fades(0.5, 20.0), lies_by_little=True, slow=True),
    "motor is dead": Fault(machine(motor_gain=0.0)),
    "motor turns at 10 %": Fault(machine(motor_gain=0.1)),
    "motor turns at 25 %": Fault(machine(motor_gain=0.25)),
    "motor turns at double": Fault(machine(motor_gain=2.0), turns_times=2.0),
    "motor turns at triple": Fault(machine(motor_gain=3.0), turns_times=3.0),
    "motor is wired backwards": Fault(machine(motor_gain=-1.0)),
    "power stage shorted, 180°/s": shorted(180.0),
    "power stage shorted, 110°/s": shorted(110.0),
    "power stage shorted, 20°/s": shorted(20.0),
    "power stage shorted, 3°/s": shorted(3.0),
    "supply relay welded": Fault(machine(supply_welded=True)),
    "coupling slips": Fault(machine(coupling_slip=1.0)),
    "coupling slips by half": Fault(machine(coupling_slip=0.5)),
    "coupling slips by a tenth": Fault(machine(coupling_slip=0.1), slow=True),
    "backlash grows 1°/s": Fault(growing.backlash(1.0), slow=True),
    "needle caught, tip held fast": Fault(held_tip),
    "drive resets": Fault(lambda trial: trial.rig.reset_drive()),
    "drive fails, over-current": Fault(lambda trial: trial.rig.fail_drive(OVER_CURRENT), drives=OTHER),
    "drive fails, CAN passive": Fault(lambda trial: trial.rig.fail_drive(CAN_PASSIVE), drives=OTHER),
    "torque reads 0": Fault(torque(dead_at=0.0)),
    "torque stands still": Fault(torque(stuck=True)),
    "torque jumps by 0.3 N·mm": Fault(torque(offset=nm(0.3))),
    "torque jumps by 3 N·mm": Fault(torque(offset=nm(3.0))),
    "torque 3 N·mm for 1 s": Fault(for_a_while(1.0, torque(offset=nm(3.0)), torque(offset=0.0)), watch_s=2.5),
    "torque creeps 0.01 N·mm/s": Fault(growing.torque_creeps(0.01), slow=True),
    "torque is no number": Fault(spoil("torque_nm")),
    "torque is no number for 0.2 s": Fault(
        for_a_while(0.2, spoil("torque_nm"), lambda trial: trial.spoilt.clear())
    ),
    "Hall angle jumps by 90°": Fault(hall(offset=rad(90.0))),
    "Hall angle stands still": Fault(hall(stuck=True)),
    "Hall angle reads 0": Fault(hall(dead_at=0.0)),
    "Hall angle creeps 0.3°/s": Fault(growing.hall_creeps(0.3), slow=True),
    "Hall angle creeps 3°/s": Fault(growing.hall_creeps(3.0)),
    "Hall angles are no numbers": Fault(spoil("hall_rad")),
    "Hall magnet out of reach": Fault(fade),
    "base angle is no number": Fault(spoil("base_angle_rad")),
    "torque link silent": Fault(link("torque", fault="silence")),
    "torque link silent for 80 ms": silent("torque", 0.08),
    "torque link garbled": Fault(link("torque", fault="garble")),
    "torque link frozen": Fault(link("torque", fault="freeze")),
    "torque link 0.2 s late": Fault(link("torque", delay_s=0.2), drives=OWN),
    "drive link silent": Fault(link("drive", fault="silence")),
    "drive link silent for 0.3 s": silent("drive", 0.3),
    "drive link garbled": Fault(link("drive", fault="garble")),
    "drive link frozen": Fault(link("drive", fault="freeze")),
    "Hall link silent": Fault(link("hall", fault="silence")),
    "Hall link silent for 0.3 s": silent("hall", 0.3),
    "Hall link comes and goes": Fault(growing.flaps("hall", 0.3)),
    "Hall link frozen": Fault(link("hall", fault="freeze")),
    "commands do not arrive": Fault(link("command", fault="silence")),
    "commands do not arrive for 80 ms": silent("command", 0.08),
    # CAN's own checksum drops such a frame; the node's second one is asked, which CANopen lacks
    "commands arrive garbled": Fault(link("command", fault="garble"), drives=OWN),
    "another master, own counter": Fault(master(follows=False), turns_deg_s=60.0),
    "another master, same counter": Fault(master(follows=True), turns_deg_s=60.0, drives=OWN),
    "old commands replayed": Fault(replay, turns_deg_s=60.0, drives=OWN),
    "a foreign reference": Fault(lambda trial: trial.rig.foreign_reference(math.pi / 2.0), drives=OWN),
    "emergency stop": Fault(machine(emergency_stop=True)),
    "emergency stop for 10 ms": press(0.01),
    "emergency stop for 1 s": press(1.0),
    "host stands still for 45 ms": Fault(lambda trial: trial.pause(0.045)),
    "host stands still for 300 ms": Fault(lambda trial: trial.pause(0.3)),
    "host every 20 ms, Hall link dead": Fault(growing.slow_host(20)),
    "host every 45 ms, Hall link dead": Fault(growing.slow_host(45)),
}
PASSING = (
    "Hall link silent",
    "Hall magnet out of reach",
    "Hall link comes and goes",
    "torque is no number",
    "Hall angles are no numbers",
    "torque link silent",
    "drive link silent",
)
"""Faults of the host that end with their cause: what comes under them must latch all the same."""
LATCHING = (
    "emergency stop for 10 ms",
    "emergency stop for 1 s",
    "power stage shorted, 180°/s",
    "power stage shorted, 20°/s",
    "power stage shorted, 3°/s",
    "motor is wired backwards",
    "torque 3 N·mm for 1 s",
    "encoder jumps by 90°",
    "another master, own counter",
)
"""Faults that a person must have looked at."""


def faults_of(drive: str, only: str = "") -> list[str]:
    """Names of the quick faults of a rig with this drive that hold `only`."""
    return [n for n, f in FAULTS.items() if drive in f.drives and not f.slow and only in n]
