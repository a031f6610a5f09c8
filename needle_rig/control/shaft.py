"""Holds encoder, torque cell and Hall sensors against one another: three witnesses of one elastic shaft.

Between the base and the first Hall sensor the shaft is a torsion spring: base - hall_1 = T c, where c is the
length over the torsional rigidity. Past it the friction of the tissue may hold any twist that the torque at
the base once made, and no more. Every change counts from the same datum: the reading to which the drive's
reference belongs. Offsets of the sensors are in all of them. Motions, rests, holds, other faults and a
person's clear do not move the datum; a new reference alone does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
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
SAME_TWIST_SHARE = 0.25
"""Torques are the same when the unknown half of the spring twists by less than this share of
`disagreement_rad` between them."""
PACE_MEMORY_S = 0.1
"""A reading may be so old; the speed of that time says how far the base is from where it was then."""
FLICKER = 0.25
"""Share of the twist that a witness must show to count as having seen it."""
STEP_RAD = rad(1.0)
"""Travel is counted in steps of this size: an encoder that flickers travels nowhere."""
STRENGTH = 1.3
"""Spread of rigidity and torque cell in the twist that a torque can make: 2 % known, 30 % allowed."""


@dataclass(frozen=True)
class ShaftLimits:
    """SI. `disagreement_rad` between encoder and first Hall angle, and on top `disagreement_share` of what
    was turned, at most half a turn (a sensor's error comes again with every turn of its magnet); `pair_rad`
    likewise between neighbouring Hall sensors; `jump_rad` from one reading to the next; `windup_rad` of the
    needle; `travel_rad` of the base in one sequence."""

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

    @property
    def spread(self) -> float:
        """All of the friction on the way: twist may differ by so much at the same torque."""
        return self.most - self.least


def spring_to_first_sensor(layout: Layout, torsional_rigidity_nm2: float) -> Spring:
    """The bounds of the compliance between the base and the first Hall sensor of `layout`."""
    first_m = layout.sensor_positions_m[0]
    free_m = min((first_m, *(start for start, _ in layout.tissue_sections_m)))
    return Spring(free_m / torsional_rigidity_nm2, first_m / torsional_rigidity_nm2)


def base_by_hall_rad(measurement: Measurement, spring: Spring) -> float:
    """Where the base must stand by the first Hall angle and the torque; the encoder is not asked."""
    return measurement.hall_rad[0] + spring.middle * measurement.torque_nm


class ShaftWatch:
    """Judges every tick in which all three witnesses are heard, from the datum on."""

    def __init__(self, limits: ShaftLimits, layout: Layout, torsional_rigidity_nm2: float) -> None:
        self._limits = limits
        self._rigidity_nm2 = torsional_rigidity_nm2
        places_m = layout.sensor_positions_m
        self._spring = spring_to_first_sensor(layout, torsional_rigidity_nm2) if places_m else None
        self._gaps_m = tuple(b - a for a, b in pairwise(places_m))
        self._middle = self._spring.middle if self._spring else 1.0
        self._spread = self._spring.spread if self._spring else 0.0
        self._same_nm = SAME_TWIST_SHARE * limits.disagreement_rad / (TORQUE_SHARE * self._middle)
        self._travel_rad = 0.0
        self._counted_rad: float | None = None
        self._past_rad = 0.0
        """Twist past the first Hall sensor at the last datum or reading before one."""
        self._turns_rad = 0.0
        """Whole turns that the Hall angles count and the twist does not."""
        self._last: Measurement | None = None
        self.rebase()

    def rebase(self, datum: Measurement | None = None) -> None:
        """The drive gets a reference, to which the reading `datum` belongs; without one, the next reading."""
        if self._last is not None:
            self._past_rad = _past_rad(self._last) - self._turns_rad
        self._datum = datum
        self._last = None
        self._motion_start: Measurement | None = None
        self._wound_before_rad = 0.0
        self._pairs: tuple[tuple[float, float, float], ...] = ()
        self._disagreement_rad = 0.0
        self._torque_nm = 0.0
        self._most_torque_nm = 0.0
        self._pace_rad_s = 0.0
        self._seen_rad: dict[int, tuple[float, float]] = {}
        """Least and largest disagreement at each torque."""
        if datum is not None:
            self._begin_at(datum)

    def begin(self) -> None:
        """A sequence starts: its travel is counted anew."""
        self._travel_rad, self._counted_rad = 0.0, None
        self.motion()

    def motion(self) -> None:
        """The next motion starts: what a fault says is measured from here on. No limit counts from here."""
        self._motion_start = None

    def step(self, now: Measurement, dt_s: float) -> Fault | None:
        """One tick of `dt_s` after the last; every value of `now` is heard and finite."""
        datum = self._datum
        if datum is None:
            datum = self._datum = now
            self._begin_at(now)
        last, self._last = self._last or now, now
        self._motion_start = self._motion_start or now
        turned_rad = abs(now.base_angle_rad - last.base_angle_rad)
        self._most_torque_nm = max(self._most_torque_nm, abs(now.torque_nm))
        self._pace_rad_s *= math.exp(-dt_s / PACE_MEMORY_S)
        if turned_rad > 0.0:
            # an answer that comes every few ticks is what was turned in all of them
            between_s = (now.time_s - now.drive_age_s) - (last.time_s - last.drive_age_s)
            self._pace_rad_s = max(self._pace_rad_s, turned_rad / max(between_s, dt_s))
        fault = self._travel(now)
        if fault is not None or self._spring is None:
            return fault
        return (
            self._jump(now, last, turned_rad)
            or self._windup(now, datum)
            or self._against_encoder(now, datum, dt_s)
            or self._neighbours(now, datum)
        )

    def _begin_at(self, datum: Measurement) -> None:
        self._torque_nm = datum.torque_nm
        self._wound_before_rad = self._own_twist_rad(datum)
        self._pairs = tuple(self._pairs_at(datum))

    def _own_twist_rad(self, now: Measurement) -> float:
        """What the shaft is wound by as torque and Hall angles tell it: the encoder's zero is not asked.

        Hall angles count turns from switch-on: the first twist is known within half a turn, every later one
        by what it was before.
        """
        if self._spring is None:
            return 0.0
        past_rad = _past_rad(now)
        self._turns_rad = math.tau * round((past_rad - self._past_rad) / math.tau)
        self._past_rad = past_rad - self._turns_rad
        return self._middle * now.torque_nm + self._past_rad

    def _travel(self, now: Measurement) -> Fault | None:
        if self._counted_rad is None:
            self._counted_rad = now.base_angle_rad
        step_rad = abs(now.base_angle_rad - self._counted_rad)
        if step_rad >= STEP_RAD:
            self._travel_rad, self._counted_rad = self._travel_rad + step_rad, now.base_angle_rad
        if self._travel_rad <= self._limits.travel_rad:
            return None
        return _fault(
            FaultName.TRAVEL_LIMIT,
            "drive",
            f"the base turned by {deg(self._travel_rad):.0f}° in this sequence, limit"
            f" {deg(self._limits.travel_rad):g}° (drive.travel_limit_deg); give the needle fewer turns",
        )

    def _jump(self, now: Measurement, last: Measurement, turned_rad: float) -> Fault | None:
        limit_rad = self._limits.jump_rad + turned_rad
        for number, (angle, before) in enumerate(zip(now.hall_rad, last.hall_rad, strict=True), 1):
            if not abs(angle - before) <= limit_rad:
                return _fault(
                    FaultName.HALL_JUMP,
                    "hall",
                    f"Hall sensor {number} jumped by {deg(angle - before):.0f}° from one reading to the next,"
                    f" limit {deg(self._limits.jump_rad):g}°; check its magnet and cable",
                )
        return None

    def _windup(self, now: Measurement, datum: Measurement) -> Fault | None:
        since_rad = now.base_angle_rad - now.hall_rad[-1] - (datum.base_angle_rad - datum.hall_rad[-1])
        windup_rad = since_rad + self._wound_before_rad
        if abs(windup_rad) <= self._limits.windup_rad:
            return None
        return _fault(
            FaultName.WINDUP_LIMIT,
            "drive",
            f"the needle is wound up by {deg(abs(windup_rad)):.0f}° between base and tip, limit"
            f" {deg(self._limits.windup_rad):g}° (drive.windup_limit_deg); free the needle",
        )

    def _share_rad(self, turned_rad: float) -> float:
        """What gain and eccentricity of a sensor may make of a turn."""
        return self._limits.disagreement_share * min(turned_rad, math.pi)

    def _against_encoder(self, now: Measurement, datum: Measurement, dt_s: float) -> Fault | None:
        base_rad = now.base_angle_rad - datum.base_angle_rad
        hall_rad = now.hall_rad[0] - datum.hall_rad[0]
        sprung_rad = self._middle * (now.torque_nm - datum.torque_nm)
        new = 1.0 - math.exp(-dt_s / SMOOTHING_S)
        self._disagreement_rad += new * (base_rad - hall_rad - sprung_rad - self._disagreement_rad)
        self._torque_nm += new * (now.torque_nm - self._torque_nm)
        size_rad = abs(self._disagreement_rad)
        # the base turned on between the two samples
        apart_rad = self._pace_rad_s * abs(now.hall_age_s - now.drive_age_s)
        limit_rad = (
            self._limits.disagreement_rad
            + self._share_rad(max(abs(base_rad), abs(hall_rad)))
            + TORQUE_SHARE * abs(sprung_rad)
            + apart_rad
        )
        if not size_rad <= limit_rad:
            return self._named(now, size_rad, limit_rad)
        return self._at_the_same_torque(now, apart_rad)

    def _at_the_same_torque(self, now: Measurement, apart_rad: float) -> Fault | None:
        """The same torque twists the shaft by the same, whatever its spring: unknown stiffness drops out."""
        same = round(self._torque_nm / self._same_nm)
        least_rad, most_rad = self._seen_rad.get(same, (math.inf, -math.inf))
        least_rad = min(least_rad, self._disagreement_rad + apart_rad)
        most_rad = max(most_rad, self._disagreement_rad - apart_rad)
        self._seen_rad[same] = least_rad, most_rad
        limit_rad = self._limits.disagreement_rad + self._spread * self._most_torque_nm
        if most_rad - least_rad <= limit_rad:
            return None
        return self._named(now, most_rad - least_rad, limit_rad)

    def _named(self, now: Measurement, size_rad: float, limit_rad: float) -> Fault:
        """Which witness it is, by what each of them saw in this motion."""
        then = self._motion_start or now
        base_rad = now.base_angle_rad - then.base_angle_rad
        hall_rad = now.hall_rad[0] - then.hall_rad[0]
        torque_nm = now.torque_nm - then.torque_nm
        sprung_rad = self._middle * torque_nm
        seen = (
            f"they are {deg(size_rad):.1f}° apart since the last reference, limit {deg(limit_rad):.1f}°"
            f" (drive.disagreement_deg); in this motion the encoder turned by {deg(base_rad):.1f}°, Hall"
            f" sensor 1 by {deg(hall_rad):.1f}°, the torque changed by {nmm(torque_nm):.3f} N·mm"
        )
        if abs(sprung_rad) < FLICKER * abs(base_rad - hall_rad):
            if abs(base_rad) < FLICKER * abs(hall_rad):
                return _disagreement(
                    FaultName.ENCODER_DISAGREES, "drive", f"the needle turns and the encoder does not: {seen}"
                )
            return _disagreement(
                FaultName.TWIST_WITHOUT_TORQUE,
                "torque",
                f"the shaft is twisted and the torque cell does not feel it: {seen}; the cell is dead, or the"
                " coupling between base and needle slips",
            )
        if max(abs(base_rad), abs(hall_rad)) < FLICKER * abs(sprung_rad):
            return _disagreement(
                FaultName.TORQUE_WITHOUT_TWIST,
                "torque",
                f"there is a torque without a twist: {seen}; check the torque cell and the encoder",
            )
        return _disagreement(
            FaultName.ENCODER_DISAGREES,
            "drive",
            f"encoder, torque and Hall angles do not fit together: {seen}; check the encoder's scale, the"
            " coupling and Hall sensor 1",
        )

    def _neighbours(self, now: Measurement, datum: Measurement) -> Fault | None:
        hall_rad, most_nm = now.hall_rad, self._most_torque_nm
        common_rad = self._limits.pair_rad + self._share_rad(abs(now.base_angle_rad - datum.base_angle_rad))
        for i, (twist_rad, before_rad, strength) in enumerate(self._pairs):
            apart_rad = hall_rad[i] - hall_rad[i + 1] - twist_rad
            limit_rad = common_rad + strength * most_nm + before_rad
            if not abs(apart_rad) <= limit_rad:
                return _disagreement(
                    FaultName.HALL_DISAGREES,
                    "hall",
                    f"Hall sensors {i + 1} and {i + 2} came {deg(apart_rad):.0f}° apart, more than the"
                    f" largest torque since the last reference can twist the shaft between them, limit"
                    f" {deg(limit_rad):.0f}°; one of them stands still or lost its zero",
                )
        return None

    def _pairs_at(self, datum: Measurement) -> Iterator[tuple[float, float, float]]:
        """Of each pair of neighbours: their twist at the datum, what of it may come undone, and the twist
        that a torque can make, rad/(N·m)."""
        for (a_rad, b_rad), gap_m in zip(pairwise(datum.hall_rad), self._gaps_m, strict=True):
            # the shaft may have been wound one way at the datum, and the other way since
            undone_rad = abs(math.remainder(a_rad - b_rad, math.tau))
            yield a_rad - b_rad, undone_rad, STRENGTH * gap_m / self._rigidity_nm2


def _past_rad(now: Measurement) -> float:
    """From the first Hall sensor to the last, whole turns included; 0 without a sensor."""
    return now.hall_rad[0] - now.hall_rad[-1] if now.hall_rad else 0.0


def _disagreement(name: FaultName, link: str, text: str) -> Fault:
    """Two witnesses of one shaft disagree until one of them is put right and the base gets a reference."""
    told = f"{text}; then give the base its angle: needle-rig home --by hall, or --here ANGLE if you know it"
    return Fault(name, link, told, latching=True)


def _fault(name: FaultName, link: str, text: str) -> Fault:
    return Fault(name, link, text + CLEAR_TEXT, latching=True)


def shaft_limits(disagreement_deg: float, windup_limit_deg: float, travel_limit_deg: float) -> ShaftLimits:
    """Limits from a rig file's numbers; neighbouring Hall sensors may disagree like encoder and first one."""
    return ShaftLimits(
        disagreement_rad=rad(disagreement_deg),
        disagreement_share=0.05,
        pair_rad=rad(disagreement_deg),
        jump_rad=rad(30.0),
        windup_rad=rad(windup_limit_deg),
        travel_rad=rad(travel_limit_deg),
    )
