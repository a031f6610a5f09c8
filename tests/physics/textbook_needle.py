"""A needle with Stribeck friction as textbooks write it, followed by small explicit steps.

It shares no code with the solver. Springs between cells are taken at the start of a step, friction, damping
and inertia of each cell at its end:

    I dω/dt = load − (υ(|ω|) + b′|ω|) sign ω,    υ(ω) = υ_k + (υ_s − υ_k) e^{−(ω/ω_s)^p}

p = 1 is the exponential form (Bo and Pavelescu, Wear 82, 1982), p = 2 the Gaussian one (Armstrong-Hélouvry,
Dupont, Canudas de Wit, Automatica 30, 1994). Below a rate ω_c the resistance falls with the rate and a cell
cannot stay there: it sticks until its load is above υ_s, is then at the rate on the rising branch that
balances the load, and sticks again where that branch ends.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from needle_rig.physics.effect import Trial
from needle_rig.physics.rod import Layout

Array = npt.NDArray[np.float64]

LEAST_RISE = 0.2
"""Part of the damping below which the resistance counts as falling with the rate: there the law has no answer
but that of its cells and steps, and those need only follow the rising branch."""


@dataclass(frozen=True)
class Friction:
    """The law, per length: N, N·s, rad/s; `kinetic_over_static` is υ_k/υ_s."""

    kinetic_n: float
    kinetic_over_static: float = 1.0
    stribeck_rate_rad_s: float = 0.2
    exponent: float = 1.0
    damping_ns: float = 5e-5
    inertia_kgm: float = 0.0
    """Polar moment of inertia per length; 0 leaves inertia out."""


@dataclass(frozen=True, eq=False)
class Push:
    """A torque per length on the needle between two places that depends on its angle there, as a table (n,)
    over even angles; straight between them, constant beyond."""

    from_m: float
    to_m: float
    low_rad: float
    high_rad: float
    torque_n: Array


NO_PUSH = Push(0.0, 0.0, 0.0, 1.0, np.zeros(2))


@dataclass(frozen=True, eq=False)
class TextbookNeedle:
    """A needle, where its cells stand after the last motion, and what was seen in it.

    Answers what `control` and the workbench ask of a `SettledNeedle`. Arrays: `cells_rad` and `rates_rad_s`
    (cells,), `torques_nm` (samples,), `halls_rad` (samples, sensors).
    """

    layout: Layout
    torsional_rigidity_nm2: float
    friction: Friction
    cell_m: float = 2.5e-3
    push: Push | None = None
    cells_rad: Array = dataclasses.field(default_factory=lambda: np.empty(0))
    rates_rad_s: Array = dataclasses.field(default_factory=lambda: np.empty(0))
    base_rad: float = 0.0
    torques_nm: Array = dataclasses.field(default_factory=lambda: np.empty(0))
    halls_rad: Array = dataclasses.field(default_factory=lambda: np.empty((0, 0)))

    def moved(self, path: Trial) -> TextbookNeedle:
        """The needle after its base went along the line through the path's samples."""
        places, tissue = self._cells()
        still = np.full(len(places), self.base_rad)
        cells = self.cells_rad.copy() if self.cells_rad.size else still
        rates = self.rates_rad_s.copy() if self.rates_rad_s.size else np.zeros(len(places))
        springs = self.torsional_rigidity_nm2 / np.diff(np.append(0.0, places))
        law, push = self.friction, self.push or NO_PUSH
        seen, torque = _follow(
            springs,
            tissue,
            np.where((places >= push.from_m) & (places <= push.to_m), tissue, 0.0),
            (push.low_rad, (push.torque_n.size - 1) / (push.high_rad - push.low_rad)),
            push.torque_n,
            np.full(len(places), self.cell_m) * law.inertia_kgm,
            (law.kinetic_n, law.kinetic_n / law.kinetic_over_static - law.kinetic_n),
            (law.stribeck_rate_rad_s, law.exponent, law.damping_ns),
            np.ascontiguousarray(path.time_s, dtype=np.float64),
            np.ascontiguousarray(path.base_angle_rad, dtype=np.float64),
            self._step_s(springs.max()),
            cells,
            rates,
        )
        known = np.column_stack([path.base_angle_rad, seen])
        sensors = np.array(self.layout.sensor_positions_m)
        halls = np.array([np.interp(sensors, np.append(0.0, places), row) for row in known])
        return dataclasses.replace(
            self,
            cells_rad=cells,
            rates_rad_s=rates,
            base_rad=float(path.base_angle_rad[-1]),
            torques_nm=torque,
            halls_rad=halls.reshape(len(torque), -1),
        )

    def _cells(self) -> tuple[Array, Array]:
        """Places of the cells and the length of tissue on each."""
        law, ends = self.friction, [0.0]
        for section in self.layout.tissue_sections_m:
            ends += section
        ends.append(self.layout.needle_length_m)
        places: list[Array] = []
        tissue: list[Array] = []
        for number, (start, end) in enumerate(itertools.pairwise(ends)):
            count = round((end - start) / self.cell_m)
            if count == 0 or not (number % 2 or law.inertia_kgm > 0.0):
                continue
            length = (end - start) / count
            places.append(start + length * (np.arange(count, dtype=np.float64) + 0.5))
            tissue.append(np.full(count, length if number % 2 else 0.0))
        return np.concatenate(places), np.concatenate(tissue)

    def _step_s(self, spring: float) -> float:
        law = self.friction
        if law.inertia_kgm > 0.0:
            return 0.5 * math.sqrt(law.inertia_kgm * self.cell_m / spring)
        # as stiff as where the resistance rises least with the rate
        fall = law.kinetic_n / law.kinetic_over_static - law.kinetic_n
        x = 1.0 - 1.0 / law.exponent
        steepest = law.exponent * x**x * math.exp(-x) * fall / law.stribeck_rate_rad_s
        rise = law.damping_ns - steepest
        rise = rise if rise > LEAST_RISE * law.damping_ns else law.damping_ns
        return 0.4 * rise * self.cell_m / spring

    def reading(self, window: slice) -> tuple[float, float, Array]:
        """Base angle, torque and Hall angles, means over the samples `window`, in which the base stands."""
        return self.base_rad, float(self.torques_nm[window].mean()), self.halls_rad[window].mean(axis=0)

    @property
    def tissue(self) -> slice:
        """Cells in tissue."""
        return slice(None)

    @property
    def position_m(self) -> Array:
        """Places of the cells."""
        return self._cells()[0]

    @property
    def angle_rad(self) -> Array:
        """Angles of the cells."""
        return self.cells_rad

    @property
    def tip_rad(self) -> float:
        """Angle of the tip, beyond which nothing resists."""
        return float(self.cells_rad[-1])

    @property
    def torque_nm(self) -> float:
        """Torque that the base exerts on the needle."""
        return float(self.torques_nm[-1])


@njit(cache=True, nogil=True, error_model="numpy")
def _balance(load: float, slope: float, kinetic: float, fall: float, rate: float, p: float) -> float:
    """Largest ω with slope·ω + kinetic + fall·e^{−(ω/rate)^p} = load, or 0 where there is none."""
    if load <= kinetic:
        return 0.0
    high = (load - kinetic) / slope
    if fall == 0.0 or high > 40.0 * rate:
        return high
    # steps of Newton's method from above, cut to where the rate would fall by half
    w = high
    for _ in range(200):
        x: float = (w / rate) ** p
        left = fall * math.exp(-x)
        steep = slope - p * x / w * left
        if steep <= 0.0:
            return 0.0
        change = (load - kinetic - slope * w - left) / steep
        w += max(change, -0.5 * w)
        if abs(change) < 1e-10 * high:
            return w
        if w < 1e-9 * rate:
            return 0.0
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(  # type: ignore[no-untyped-def]
    springs, tissue, pushed, axis, pushes, inertia, limits, law, times, base, step, cells, rates
):
    """Angles of the cells (samples, cells) and the base torque (samples,); `cells`, `rates` are moved on."""
    n = springs.size
    kinetic, fall = limits
    rate, p, damping = law
    out = np.zeros((times.size, n))
    torque = np.zeros(times.size)
    load = np.zeros(n)
    out[0] = cells
    torque[0] = springs[0] * (base[0] - cells[0])
    for row in range(1, times.size):
        steps = math.ceil((times[row] - times[row - 1]) / step - 1e-9)
        dt = (times[row] - times[row - 1]) / steps
        turn = (base[row] - base[row - 1]) / steps
        k = 0
        while k < steps:
            k += 1
            at = base[row - 1] + k * turn
            moving = 0
            for i in range(n):
                before = at if i == 0 else cells[i - 1]
                load[i] = springs[i] * (before - cells[i])
                if i < n - 1:
                    load[i] += springs[i + 1] * (cells[i + 1] - cells[i])
                if pushed[i] > 0.0:
                    place = min(max((cells[i] - axis[0]) * axis[1], 0.0), pushes.size - 1.0)
                    j = min(int(place), pushes.size - 2)
                    load[i] += pushed[i] * (pushes[j] + (place - j) * (pushes[j + 1] - pushes[j]))
            for i in range(n):
                length = tissue[i]
                push = load[i] + inertia[i] / dt * rates[i]
                slope = damping * length + inertia[i] / dt
                if length == 0.0:
                    rates[i] = push / slope
                elif rates[i] == 0.0 and abs(push) <= (kinetic + fall) * length:
                    continue
                else:
                    w = _balance(abs(push), slope, kinetic * length, fall * length, rate, p)
                    # a cell that has stopped has its way back from there
                    turned = push * rates[i] < 0.0 and abs(push) <= (kinetic + fall) * length
                    rates[i] = 0.0 if turned else math.copysign(w, push)
                moving += rates[i] != 0.0
            if moving == 0:
                # nothing moves until the base has loaded the first cell to its limit
                room = (kinetic + fall) * tissue[0] - math.copysign(1.0, turn) * load[0]
                left = room / (abs(turn) * springs[0]) if turn != 0.0 else float(steps)
                k += int(min(max(left - 1.0, 0.0), float(steps - k)))
                continue
            for i in range(n):
                cells[i] += dt * rates[i]
        out[row] = cells
        torque[row] = springs[0] * (base[row] - cells[0])
    return out, torque


def needle(layout: Layout, torsional_rigidity_nm2: float, **law: Any) -> TextbookNeedle:
    """A relaxed needle with a law of the given values."""
    return TextbookNeedle(layout, torsional_rigidity_nm2, Friction(**law))
