"""Holds encoder, torque cell and Hall sensors against one another: three witnesses of one elastic shaft.

Between the base and the first Hall sensor the shaft is a torsion spring: base - hall_1 = T c, where c is the
length over the torsional rigidity. Past it the friction of the tissue may hold any twist that the torque at
the base once made, and no more. Only changes since the last `begin` are judged: offsets of the sensors and
what the shaft was wound by before are in all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.following import CLEAR_TEXT
from needle_rig.physics.rod import Layout
from needle_rig.records import Measurement
from needle_rig.units import deg, nmm, rad

SMOOTHING_S = 0.02
"""Low-pass of the disagreement: a Hall sensor's noise of 0.25° stays 10 times below the limit."""
TORQUE_SHARE = 0.5
"""Of the twist that the torque stands for: a chuck that gives, a cell's gain, friction before the first
sensor. The tests ask every effect of the library at its typical size: it stays below the limit."""
FLICKER = 0.25
"""Share of the twist that a witness must show to count as having seen it."""
STEP_RAD = rad(1.0)
"""Travel is counted in steps of this size: an encoder that flickers travels nowhere."""
STRENGTH = 1.3
"""Spread of rigidity and torque cell in the twist that a torque can make: 2 % known, 30 % allowed."""


@dataclass(frozen=True)
class ShaftLimits:
    """SI. `disagreement_rad` between encoder and first Hall angle, and on top `disagreement_share` of what
    was turned (gain and eccentricity of a sensor); `pair_rad` likewise between neighbouring Hall sensors;
    `jump_rad` within one tick; `windup_rad` of the needle; `travel_rad` of the base in one sequence."""

    disagreement_rad: float
    disagreement_share: float
    pair_rad: float
    jump_rad: float
    windup_rad: float
    travel_rad: float


@dataclass(frozen=True)
class Spring:
    """The shaft from the base to its first Hall sensor, rad/(N·m): `least` when the tissue on the way takes
    all of the torque at once, `most` when it takes none."""

    least: float
    most: float

    @property
    def middle(self) -> float:
        """Half of the friction on the way."""
        return 0.5 * (self.least + self.most)


def spring_to_first_sensor(layout: Layout, torsional_rigidity_nm2: float) -> Spring:
    """The bounds of the compliance between the base and the first Hall sensor of `layout`."""
    first_m = layout.sensor_positions_m[0]
    free_m = min((first_m, *(start for start, _ in layout.tissue_sections_m)))
    return Spring(free_m / torsional_rigidity_nm2, first_m / torsional_rigidity_nm2)


def base_by_hall_rad(measurement: Measurement, spring: Spring) -> float:
    """Where the base must stand by the first Hall angle and the torque; the encoder is not asked."""
    return measurement.hall_rad[0] + spring.middle * measurement.torque_nm


class ShaftWatch:
    """Judges every tick of a sequence from `begin` on."""

    def __init__(self, limits: ShaftLimits, layout: Layout, torsional_rigidity_nm2: float) -> None:
        self._limits = limits
        self._rigidity_nm2 = torsional_rigidity_nm2
        places_m = layout.sensor_positions_m
        self._spring = spring_to_first_sensor(layout, torsional_rigidity_nm2) if places_m else None
        self._gaps_m = tuple(b - a for a, b in pairwise(places_m))
        self._start: Measurement | None = None
        self._at_rest: Measurement | None = None
        self._last: Measurement | None = None
        self._disagreement_rad = 0.0
        self._most_torque_nm = 0.0
        self._most_before_nm = 0.0
        self._travel_rad = 0.0
        self._counted_rad = 0.0

    def begin(self) -> None:
        """A sequence starts: its first measurement is what all changes are counted from."""
        self._start = self._last = None
        self._most_before_nm = max(self._most_before_nm, self._most_torque_nm)
        self._most_torque_nm = self._travel_rad = 0.0
        self.motion()

    def motion(self) -> None:
        """The next motion starts: slow drifts of sensors until here are forgiven."""
        self._at_rest = None
        self._disagreement_rad = 0.0

    def step(self, now: Measurement, dt_s: float) -> Fault | None:
        """One tick of `dt_s` after the last; every value of `now` is fresh and finite."""
        start = self._start = self._start or now
        at_rest = self._at_rest = self._at_rest or now
        last, self._last = self._last or now, now
        turned_rad = abs(now.base_angle_rad - last.base_angle_rad)
        if now is start:
            self._counted_rad = now.base_angle_rad
        step_rad = abs(now.base_angle_rad - self._counted_rad)
        if step_rad >= STEP_RAD:
            self._travel_rad, self._counted_rad = self._travel_rad + step_rad, now.base_angle_rad
        self._most_torque_nm = max(self._most_torque_nm, abs(now.torque_nm))
        if self._travel_rad > self._limits.travel_rad:
            return _fault(
                FaultName.TRAVEL_LIMIT,
                "drive",
                f"the base turned by {deg(self._travel_rad):.0f}° in this sequence, limit"
                f" {deg(self._limits.travel_rad):g}° (drive.travel_limit_deg); give the needle fewer turns",
            )
        if self._spring is None:
            return None
        return (
            self._jump(now, last, turned_rad)
            or self._windup(now, start)
            or self._against_encoder(now, at_rest, dt_s, self._spring)
            or self._neighbours(now, start)
        )

    def _jump(self, now: Measurement, last: Measurement, turned_rad: float) -> Fault | None:
        for number, (angle, before) in enumerate(zip(now.hall_rad, last.hall_rad, strict=True), 1):
            if abs(angle - before) > self._limits.jump_rad + turned_rad:
                return _fault(
                    FaultName.HALL_JUMP,
                    "hall",
                    f"Hall sensor {number} jumped by {deg(angle - before):.0f}° from one reading to the next,"
                    f" limit {deg(self._limits.jump_rad):g}°; check its magnet and cable",
                )
        return None

    def _windup(self, now: Measurement, start: Measurement) -> Fault | None:
        windup_rad = now.base_angle_rad - now.hall_rad[-1] - (start.base_angle_rad - start.hall_rad[-1])
        if abs(windup_rad) <= self._limits.windup_rad:
            return None
        return _fault(
            FaultName.WINDUP_LIMIT,
            "drive",
            f"the needle is wound up by {deg(abs(windup_rad)):.0f}° between base and tip, limit"
            f" {deg(self._limits.windup_rad):g}° (drive.windup_limit_deg); free the needle",
        )

    def _against_encoder(
        self, now: Measurement, then: Measurement, dt_s: float, spring: Spring
    ) -> Fault | None:
        base_rad = now.base_angle_rad - then.base_angle_rad
        hall_rad = now.hall_rad[0] - then.hall_rad[0]
        torque_nm = now.torque_nm - then.torque_nm
        sprung_rad = spring.middle * torque_nm
        raw_rad = base_rad - hall_rad - sprung_rad
        kept = math.exp(-dt_s / SMOOTHING_S)
        self._disagreement_rad += (1.0 - kept) * (raw_rad - self._disagreement_rad)
        limit_rad = (
            self._limits.disagreement_rad
            + self._limits.disagreement_share * max(abs(base_rad), abs(hall_rad))
            + TORQUE_SHARE * abs(sprung_rad)
        )
        if abs(self._disagreement_rad) <= limit_rad:
            return None
        seen = (
            f"in this motion the encoder turned by {deg(base_rad):.1f}°, Hall sensor 1 by"
            f" {deg(hall_rad):.1f}°,"
            f" the torque changed by {nmm(torque_nm):.3f} N·mm, which leaves {deg(raw_rad):.1f}°,"
            f" limit {deg(limit_rad):.1f}° (drive.disagreement_deg)"
        )
        twist_rad = base_rad - hall_rad
        if abs(sprung_rad) < FLICKER * abs(twist_rad):
            if abs(base_rad) < FLICKER * abs(hall_rad):
                return _fault(
                    FaultName.ENCODER_DISAGREES, "drive", f"the needle turns and the encoder does not: {seen}"
                )
            return _fault(
                FaultName.TWIST_WITHOUT_TORQUE,
                "torque",
                f"the shaft is twisted and the torque cell does not feel it: {seen}; the cell is dead, or the"
                " coupling between base and needle slips",
            )
        if max(abs(base_rad), abs(hall_rad)) < FLICKER * abs(sprung_rad):
            return _fault(
                FaultName.TORQUE_WITHOUT_TWIST,
                "torque",
                f"there is a torque without a twist: {seen}; check the torque cell and the encoder",
            )
        return _fault(
            FaultName.ENCODER_DISAGREES,
            "drive",
            f"encoder, torque and Hall angles do not fit together: {seen}; check the encoder's scale, the"
            " coupling and Hall sensor 1",
        )

    def _neighbours(self, now: Measurement, start: Measurement) -> Fault | None:
        twists = zip(now.hall_rad, now.hall_rad[1:], start.hall_rad, start.hall_rad[1:], strict=False)
        turned_rad = abs(now.base_angle_rad - start.base_angle_rad)
        for number, ((a, b, a0, b0), gap_m) in enumerate(zip(twists, self._gaps_m, strict=True), 1):
            twist_rad = (a - b) - (a0 - b0)
            # the start may have been wound one way by an earlier sequence, and this one winds the other way
            wound_nm = self._most_torque_nm + self._most_before_nm
            possible_rad = STRENGTH * wound_nm * gap_m / self._rigidity_nm2
            limit_rad = self._limits.pair_rad + self._limits.disagreement_share * turned_rad + possible_rad
            if abs(twist_rad) > limit_rad:
                return _fault(
                    FaultName.HALL_DISAGREES,
                    "hall",
                    f"Hall sensors {number} and {number + 1} came {deg(twist_rad):.0f}° apart, more than the"
                    f" largest torque of this sequence can twist the shaft between them, limit"
                    f" {deg(limit_rad):.0f}°; one of them stands still or lost its zero",
                )
        return None


def _fault(name: FaultName, link: str, text: str) -> Fault:
    return Fault(name, link, text + CLEAR_TEXT, latching=True)


def shaft_limits(disagreement_deg: float, windup_limit_deg: float, travel_limit_deg: float) -> ShaftLimits:
    """Limits from a rig file's numbers; neighbouring Hall sensors may disagree as encoder and first one may."""
    return ShaftLimits(
        disagreement_rad=rad(disagreement_deg),
        disagreement_share=0.05,
        pair_rad=rad(disagreement_deg),
        jump_rad=rad(30.0),
        windup_rad=rad(windup_limit_deg),
        travel_rad=rad(travel_limit_deg),
    )
