"""The paper's identification experiments, run on the simulated rig with its sensors' noise.

Torsional rigidity from a 90° turn with the tip held; damping from the base torque of steady turns at several
rates; friction from the torque that stays after a turn (Reed, BioRob 2008).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.config.schema import SimulationSection
from needle_rig.control.lag import effective_length_m, tissue_length_m
from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.effect_text import parse_effects
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout
from needle_rig.records import JsonObject
from needle_rig.simulation.plant import Plant
from needle_rig.units import nmm, per_100mm

TICK_S = 0.02
RATES_RAD_S = (0.04, 0.08, 0.12)
"""The paper's 0.08 rad/s and two others."""
WIRE_LENGTH_M = 0.410
AVERAGED_S = 5.0
LONGEST_S = 300.0
LATE_S = 20.0
"""After a turn: the faster time constants have gone."""
WITHIN_PERCENT = 2.0
"""What torsional rigidity is known to unless a file says otherwise."""
DAMPING = "viscous_slip"
CLAMP = "tip_friction=1"
"""1 N·mm at the tip holds it against the 0.24 N·mm of the 90° turn."""


@dataclass(frozen=True)
class Identified:
    """What an experiment found, beside what the simulated rig has."""

    quantity: str
    value: float
    uncertainty: float
    """One standard deviation, from the readings' scatter."""
    unit: str
    plant_value: float
    experiment: str
    readings: tuple[dict[str, float], ...]

    @property
    def error_percent(self) -> float:
        """Found minus the rig's, in percent of the rig's."""
        return 100.0 * (self.value / self.plant_value - 1.0)

    def as_document(self) -> JsonObject:
        """What `--json` prints."""
        return dataclasses.asdict(self) | {
            "error_percent": self.error_percent,
            "within": abs(self.error_percent) <= WITHIN_PERCENT,
        }


def identify_jg(model: NeedleModel, settings: SimulationSection) -> Identified:
    """Torsional rigidity from a wire of 41 cm whose tip is held while the base turns by 90°."""
    rig = Bench(_held_tip(model, WIRE_LENGTH_M), settings)
    rig.turn_to(math.radians(90.0), math.radians(45.0))
    rig.wait(1.0)
    torque, sigma, base = rig.average(AVERAGED_S)
    value = torque * WIRE_LENGTH_M / base
    return Identified(
        quantity="torsional rigidity JG",
        value=value * 1e6,
        uncertainty=sigma * WIRE_LENGTH_M / base * 1e6,
        unit="N·mm²",
        plant_value=model.torsional_rigidity_nm2 * 1e6,
        experiment="tip of a wire of 410 mm held, base turned by 90°, torque averaged over 5 s",
        readings=({"base_deg": math.degrees(base), "torque_nmm": nmm(torque)},),
    )


def identify_damping(
    model: NeedleModel, settings: SimulationSection, rates_rad_s: Sequence[float] = RATES_RAD_S
) -> Identified:
    """Damping from the slope of the base torque over the rate of steady turns.

    Each turn goes on until the torque no longer rises. Raises BadInput when the rig has no damping to find.
    """
    rod = model.rod(Trial(np.zeros(1), np.zeros(1)))
    in_tissue = tissue_length_m(model.layout)
    plant_value = per_100mm(float(rod.viscous_nms_per_rad.sum()) / in_tissue)
    if plant_value <= 0.0:
        raise BadInput(f"{model.name} has no damping to find; add some as an effect, e.g. {DAMPING}=2.8")
    readings, rates, torques, sigmas = [], [], [], []
    for number, rate in enumerate(rates_rad_s):
        rig = Bench(model, settings.model_copy(update={"seed": settings.seed + number}))
        torque, sigma, seen_rate = rig.turn_steadily(rate)
        readings.append({"rate_rad_s": seen_rate, "torque_nmm": nmm(torque), "after_s": rig.plant.time_s})
        rates.append(seen_rate)
        torques.append(torque)
        sigmas.append(sigma)
    slope, spread = _slope(np.array(rates), np.array(torques), np.array(sigmas))
    return Identified(
        quantity="damping of the slip",
        value=per_100mm(slope / in_tissue),
        uncertainty=per_100mm(spread / in_tissue),
        unit="N·mm·s/rad per 100 mm",
        plant_value=plant_value,
        experiment="steady turns at "
        + ", ".join(f"{r:g}" for r in rates_rad_s)
        + " rad/s until the torque stays",
        readings=tuple(readings),
    )


def identify_friction(model: NeedleModel, settings: SimulationSection) -> Identified:
    """Friction from the torque that stays at rest after the whole shaft has slipped in one direction."""
    rod = model.rod(Trial(np.zeros(1), np.zeros(1)))
    in_tissue = tissue_length_m(model.layout)
    rig = Bench(model, settings)
    rig.turn_steadily(RATES_RAD_S[1])
    rig.wait_until_still()
    torque, sigma, base = rig.average(AVERAGED_S)
    return Identified(
        quantity="Coulomb friction",
        value=per_100mm(torque / in_tissue),
        uncertainty=per_100mm(sigma / in_tissue),
        unit="N·mm per 100 mm",
        plant_value=per_100mm(float(rod.slip_plus_nm.sum()) / in_tissue),
        experiment="turned at 0.08 rad/s until the torque stays, stopped, torque at rest averaged over 5 s",
        readings=({"base_deg": math.degrees(base), "torque_nmm": nmm(torque), "after_s": rig.plant.time_s},),
    )


EXPERIMENTS: dict[str, Callable[[NeedleModel, SimulationSection], Identified]] = {
    "jg": identify_jg,
    "damping": identify_damping,
    "friction": identify_friction,
}


def held_tip_torque_nm(
    torsional_rigidity_nm2: float, length_m: float, turn_rad: float = math.pi / 2
) -> float:
    """Base torque of the model's wire with the tip held and the base turned, without noise."""
    wire = NeedleModel("wire", _wire_layout(length_m), torsional_rigidity_nm2, 0.0)
    trial = Trial(np.array([0.0, 1.0, 2.0]), np.array([0.0, turn_rad, turn_rad]))
    return float(with_effect(wire, CLAMP).predict(trial).torque_nm[-1])


def settling_time_s(model: NeedleModel, damping_nmms_per_rad_per_100mm: float) -> float:
    """Slowest time constant with which the torque falls after a turn, by the model without dry friction."""
    damped = with_effect(
        dataclasses.replace(model, friction_n=0.0), f"{DAMPING}={damping_nmms_per_rad_per_100mm:g}"
    )
    time_s = np.arange(0.0, 60.0, 0.05)
    base = np.minimum(time_s / 1.0, 1.0) * math.radians(45.0)
    torque = damped.predict(Trial(time_s, base)).torque_nm
    late = (time_s > LATE_S) & (torque > 0.0)
    return float(-1.0 / np.polyfit(time_s[late], np.log(torque[late]), 1)[0])


def with_effect(model: NeedleModel, text: str) -> NeedleModel:
    """`model` with one effect of the library, written as on the command line."""
    return model.with_effects(*parse_effects((text,), find_effects()))


class Bench:
    """The simulated rig in virtual time, turned by hand: no guard, no controller, sensors as configured."""

    def __init__(self, model: NeedleModel, settings: SimulationSection) -> None:
        self.plant = Plant(model, settings)
        self._full_lag_rad = (
            2.0
            * float(model.rod(Trial(np.zeros(1), np.zeros(1))).slip_plus_nm.sum())
            * effective_length_m(model.layout)
            / model.torsional_rigidity_nm2
        )

    def turn_to(self, angle_rad: float, speed_rad_s: float) -> None:
        """Turn the base to about `angle_rad` and brake; the encoder tells where it came to rest."""
        for _ in range(max(1, round(angle_rad / (speed_rad_s * TICK_S)))):
            self.plant.turn(speed_rad_s, TICK_S)
        self.wait(1.0)

    def wait(self, duration_s: float) -> None:
        """Let time pass with the base braked."""
        self._readings(duration_s, 0.0)

    def average(self, duration_s: float, rate_rad_s: float = 0.0) -> tuple[float, float, float]:
        """Mean torque, its standard deviation from the readings' scatter, and the last base angle."""
        torque, _, base = self._readings(duration_s, rate_rad_s)
        return float(torque.mean()), float(torque.std() / math.sqrt(len(torque))), float(base[-1])

    def turn_steadily(self, rate_rad_s: float) -> tuple[float, float, float]:
        """Turn until the torque stays; mean torque, its standard deviation, and the rate by the encoder.

        Raises BadInput when the torque still changes after 300 s.
        """
        self._readings(self._full_lag_rad / rate_rad_s, rate_rad_s)
        before = np.inf
        while True:
            torque, time_s, base = self._readings(AVERAGED_S, rate_rad_s)
            sigma = float(torque.std() / math.sqrt(len(torque)))
            mean = float(torque.mean())
            if abs(mean - before) < max(0.001 * abs(mean), 1.5 * sigma):
                return mean, sigma, float(np.polyfit(time_s, base, 1)[0])
            before = mean
            if self.plant.time_s > LONGEST_S:
                raise BadInput(
                    f"turning at {rate_rad_s:g} rad/s the torque still changes after {LONGEST_S:g} s "
                    f"({nmm(mean):.4f} N·mm); the shaft does not slip steadily with these parameters"
                )

    def wait_until_still(self) -> None:
        """Hold the base until the torque no longer falls. Raises BadInput after 300 s more."""
        before, start_s = np.inf, self.plant.time_s
        while True:
            mean, sigma, _ = self.average(AVERAGED_S)
            if abs(mean - before) < max(0.0005 * abs(mean), 1.5 * sigma):
                return
            before = mean
            if self.plant.time_s - start_s > LONGEST_S:
                raise BadInput(
                    f"the torque at rest still changes after {LONGEST_S:g} s; less damping, or wait on"
                )

    def _readings(self, duration_s: float, rate_rad_s: float) -> tuple[Array, Array, Array]:
        count = max(2, round(duration_s / TICK_S))
        torque, time_s, base = np.empty(count), np.empty(count), np.empty(count)
        for k in range(count):
            self.plant.turn(rate_rad_s, TICK_S, powered=rate_rad_s != 0.0)
            shown = self.plant.read()
            torque[k], time_s[k], base[k] = shown.torque_nm, shown.time_s, shown.base_angle_rad
        return torque, time_s, base


def _wire_layout(length_m: float) -> Layout:
    """A wire in no tissue: its last millimetres are a section that gets no friction."""
    return Layout(length_m, ((length_m - 0.002, length_m - 0.001),), ())


def _held_tip(model: NeedleModel, length_m: float) -> NeedleModel:
    """The needle out of the tissue with its tip in a clamp; effects of chuck and sensors stay."""
    kept = tuple(e for e in model.effects if not e.has("shape") and not e.has("torque"))
    wire = dataclasses.replace(model, friction_n=0.0, layout=_wire_layout(length_m), effects=kept)
    return with_effect(wire, CLAMP)


def _slope(x: Array, y: Array, sigma: Array) -> tuple[float, float]:
    """Slope of the weighted line through (x, y) and its standard deviation."""
    weight = 1.0 / np.maximum(sigma, 1e-12) ** 2
    centre = float((weight * x).sum() / weight.sum())
    inertia = float((weight * (x - centre) ** 2).sum())
    return float((weight * (x - centre) * y).sum() / inertia), float(1.0 / math.sqrt(inertia))
