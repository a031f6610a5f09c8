"""Faults that go on after they began: creeping, flapping, a slow host."""

from __future__ import annotations

from campaigns.rig.hazard.trial import STEP_S, Inject, Trial
from needle_rig.units import nm, rad


def encoder_creeps(rate_deg_s: float) -> Inject:
    """An encoder that counts what was not turned."""

    def creep(trial: Trial) -> None:
        trial.rig.faults.encoder.offset += trial.direction * rad(rate_deg_s) * STEP_S

    return lambda trial: trial.every_ms(1, creep)


def encoder_fades(to: float, seconds: float) -> Inject:
    """An encoder whose gain goes from 1 to `to`."""

    def fade(trial: Trial) -> None:
        reading = trial.rig.faults.encoder
        reading.gain = max(to, reading.gain - (1.0 - to) * STEP_S / seconds)

    return lambda trial: trial.every_ms(1, fade)


def torque_creeps(rate_nmm_s: float) -> Inject:
    """A torque cell whose bias drifts."""

    def creep(trial: Trial) -> None:
        trial.rig.faults.torque.offset += nm(rate_nmm_s) * STEP_S

    return lambda trial: trial.every_ms(1, creep)


def hall_creeps(rate_deg_s: float) -> Inject:
    """One Hall sensor, any, that drifts."""

    def inject(trial: Trial) -> None:
        reading = trial.rig.faults.hall_reading(trial.any_sensor())

        def creep(_trial: Trial) -> None:
            reading.offset += rad(rate_deg_s) * STEP_S

        trial.every_ms(1, creep)

    return inject


def backlash(rate_deg_s: float) -> Inject:
    """A coupling with a gap that grows: the needle is not turned while the base is within it."""

    def inject(trial: Trial) -> None:
        width_deg, place_deg, before_deg = 0.0, 0.0, trial.true_deg

        def grow(trial: Trial) -> None:
            nonlocal width_deg, place_deg, before_deg
            width_deg += rate_deg_s * STEP_S
            place_deg = min(max(place_deg + trial.true_deg - before_deg, 0.0), width_deg)
            before_deg = trial.true_deg
            trial.rig.faults.coupling_slip = float(0.0 < place_deg < width_deg)

        trial.every_ms(1, grow)

    return inject


def flaps(name: str, seconds: float) -> Inject:
    """A link that dies and comes back, again and again."""

    def flap(trial: Trial) -> None:
        link = getattr(trial.rig.links, name)
        link.fault = "" if link.fault else "silence"

    def inject(trial: Trial) -> None:
        flap(trial)
        trial.every_ms(round(seconds / STEP_S), flap)

    return inject


def slow_host(period_ms: int) -> Inject:
    """The host comes late from now on, and a link dies."""

    def inject(trial: Trial) -> None:
        trial.tick_ms = max(trial.tick_ms, period_ms)
        trial.rig.links.hall.fault = "silence"

    return inject
