"""One rig and its host, millisecond by millisecond, and what became of them."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, replace

from campaigns.rig.hazard.figures import Asked, Commanded, Latches
from campaigns.rig.hazard.needle import SpringNeedle
from campaigns.rig.hazard.rigs import Rig, make_rig
from campaigns.rig.hazard.scenes import Scene
from campaigns.rig.hazard.setups import Setup
from needle_rig.control.brain import Brain
from needle_rig.errors import RigFault
from needle_rig.records import Command, Measurement
from needle_rig.units import deg

STEP_S = 0.001
STILL_DEG_S = 0.5
QUIET_S = 0.6
"""A base that stood and was off for so long has ended: three times the period in which a latch was lost."""
LONGER_S = 65.0
"""A base that turns when a healthy run is over has so long to come to an end: what never settles ends after
`sequence.motion_timeout_s`, 60 s."""
ORDERED = ("rest", "moving", "settling", "measuring", "holding")
FIRST_ORDER_S, NEXT_ORDER_S = 0.2, 0.1

Inject = Callable[["Trial"], None]


@dataclass(frozen=True)
class Result:
    """What became of a fault."""

    commanded_deg: float
    """Farthest of the base outside what the host commanded."""
    asked_deg: float
    """Farthest of the base outside what the person asked."""
    windup_deg: float
    """Largest true angle between base and tip."""
    ended: bool
    """At the end the base stood, or its motor had no supply."""
    off_ms: float | None
    """From the fault until the motor stood and was off for good; None: it was on to the end."""
    name: str
    """What the host called it first; empty when it did not notice."""
    named_ms: float | None
    woken: int
    moved: int


class Trial:
    """A host that gives the orders of `scene` to a rig; healthy until something is injected."""

    def __init__(
        self, setup: Setup, scene: Scene, speed_deg_s: float, seed: int, *, finite_elements: bool = False
    ) -> None:
        self.random = random.Random(seed)
        self.direction = self.random.choice((-1, 1))
        self.rig: Rig = make_rig(setup, seed)
        plant = self.rig.plant
        if not finite_elements:
            plant.model = SpringNeedle.slipping(plant.model, len(plant.shaft_rad()))
        self.brain = Brain(setup.config(seed))
        self.scene, self.speed_deg_s = scene, speed_deg_s
        self.tick_ms, self._jitter_ms = setup.tick_ms, setup.jitter_ms
        self.spoilt: set[str] = set()
        """Fields of a measurement that reach the host as no numbers."""
        self.commanded, self.asked = Commanded(self.true_deg), Asked(self.true_deg)
        self.latches = Latches()
        self.orders_given = 0
        self.ticks = 0
        self.tick_ended = False
        """The host has just looked."""
        self.oldest_ms = 0.0
        """Greatest age of the drive's answer at a tick."""
        self._tasks: list[tuple[float, float, Inject]] = []
        self._command = Command()
        self._ms = self._since_tick_ms = 0
        self._due_ms = self.tick_ms
        self._free_ms = 0
        self._before_deg = self.true_deg
        self.moving = False
        self._latched = self._ordered = False

    @property
    def true_deg(self) -> float:
        """Where the motor's shaft stands."""
        return deg(self.rig.true_base_rad)

    @property
    def time_s(self) -> float:
        """Since the start."""
        return self._ms * STEP_S

    def any_sensor(self) -> int:
        """A Hall sensor."""
        return self.random.randrange(4)

    def any_way(self) -> int:
        """One way or the other."""
        return self.random.choice((-1, 1))

    def after_s(self, seconds: float, inject: Inject) -> None:
        """`inject` once, later."""
        self._tasks.append((self.time_s + seconds - STEP_S / 2.0, math.inf, inject))

    def every_ms(self, period_ms: int, inject: Inject) -> None:
        """`inject` from now on, again and again."""
        self._tasks.append((self.time_s + (period_ms - 0.5) * STEP_S, period_ms * STEP_S, inject))

    def pause(self, seconds: float) -> None:
        """The host stands still from now on."""
        self._due_ms = self._since_tick_ms + round(seconds / STEP_S)

    def step(self) -> None:
        """One millisecond of the world, and the host's share of it."""
        self._ms += 1
        self._break()
        self.rig.step()
        if self._command.enable:
            self.commanded.went(deg(self._command.velocity_rad_s), STEP_S)
        now_deg = self.true_deg
        self.moving = abs(now_deg - self._before_deg) / STEP_S > STILL_DEG_S
        self._before_deg = now_deg
        self._since_tick_ms += 1
        self.tick_ended = self._since_tick_ms >= self._due_ms
        if self.tick_ended:
            self._tick()
        self.latches.look(
            latched=self._latched or self.rig.latched,
            pressed=self.rig.faults.emergency_stop,
            awake=self.rig.awake,
            running=self.rig.running and self._command.enable,
            moving=self.moving,
            ordered=self._ordered,
        )

    def tick(self) -> None:
        """Go on until the host has looked once more."""
        self.step()
        while not self.tick_ended:
            self.step()

    def place(self) -> str:
        """Where in its scene the host is."""
        if not self.orders_given:
            return "before"
        phase = self.brain.state.phase.value
        return {"rest": "between", "settling": "between", "measuring": "between"}.get(phase, phase)

    def _break(self) -> None:
        due = [task for task in self._tasks if task[0] <= self.time_s]
        for task in due:
            self._tasks.remove(task)
            at_s, period_s, inject = task
            if period_s < math.inf:
                self._tasks.append((at_s + period_s, period_s, inject))
            inject(self)

    def _tick(self) -> None:
        dt_s = self._since_tick_ms * STEP_S
        self.ticks += 1
        self._since_tick_ms = 0
        self._due_ms = self.tick_ms + (self._jitter_ms if self.ticks % 2 else -self._jitter_ms)
        self._order()
        measurement = self._seen()
        if self.orders_given:
            self.oldest_ms = max(self.oldest_ms, measurement.drive_age_s * 1e3)
        self._command, sample = self.brain.step(measurement, dt_s)
        self.rig.write(self._command)
        if math.isfinite(sample.waypoint_rad) and self._ordered:
            self.asked.waypoint(deg(sample.waypoint_rad))
        self._latched = self.brain.state.latched
        self._ordered = sample.phase.value in ORDERED

    def _order(self) -> None:
        """The next order of the scene, a moment after the last one was done."""
        orders = self.scene.orders
        if self._ordered or self.orders_given == len(orders):
            self._free_ms = self._ms
            return
        wait_s = NEXT_ORDER_S if self.orders_given else FIRST_ORDER_S
        if (self._ms - self._free_ms) * STEP_S < wait_s:
            return
        self.orders_given += 1
        try:
            orders[self.orders_given - 1](self.brain, self.direction, self.speed_deg_s)
        except RigFault:
            return
        self._ordered = True
        self.asked.order(self.true_deg)

    def _seen(self) -> Measurement:
        now = self.rig.read()
        spoilt: dict[str, object] = dict.fromkeys(self.spoilt, math.nan)
        if "hall_rad" in spoilt:
            spoilt["hall_rad"] = (math.nan, *now.hall_rad[1:])
        return replace(now, **spoilt) if spoilt else now  # type: ignore[arg-type]


def aftermath(trial: Trial, breaks: list[tuple[float, Inject]], watch_s: float, left_s: float) -> Result:
    """Break the rig of `trial` at these times from now on, and look until it stands or `left_s` are over."""
    start_s, last_s = trial.time_s, max(at_s for at_s, _ in breaks)
    commanded_deg = asked_deg = windup_deg = 0.0
    already = (trial.commanded.beyond_deg(trial.true_deg), trial.asked.beyond_deg(trial.true_deg))
    for at_s, inject in breaks:
        if at_s > 0.0:
            trial.after_s(at_s, inject)
        else:
            inject(trial)
    woken, moved = trial.latches.woken, trial.latches.moved
    name, named_ms, off_s, stood_s = "", None, None, 0.0
    while True:
        trial.step()
        since_s, true_deg = trial.time_s - start_s, trial.true_deg
        commanded_deg = max(commanded_deg, trial.commanded.beyond_deg(true_deg) - already[0])
        asked_deg = max(asked_deg, trial.asked.beyond_deg(true_deg) - already[1])
        windup_deg = max(windup_deg, abs(true_deg - deg(float(trial.rig.plant.hall_rad[-1]))))
        if trial.tick_ended and not name:
            name = trial.brain.state.fault_name or ""
            named_ms = since_s * 1e3 if name else None
        on = trial.moving or trial.rig.running
        stood_s = 0.0 if trial.moving else stood_s + STEP_S
        off_s = None if on else since_s if off_s is None else off_s
        quiet_s = 0.0 if off_s is None else since_s - off_s
        if name and quiet_s > QUIET_S and since_s > last_s + watch_s:
            break
        over_s = since_s - max(left_s, last_s + watch_s)
        if over_s > LONGER_S or (over_s > 0.0 and (off_s is not None or stood_s > QUIET_S)):
            break
    return Result(
        commanded_deg=commanded_deg,
        asked_deg=asked_deg,
        windup_deg=windup_deg,
        ended=off_s is not None or stood_s > QUIET_S,
        off_ms=None if off_s is None else off_s * 1e3,
        name=name,
        named_ms=named_ms,
        woken=trial.latches.woken - woken,
        moved=trial.latches.moved - moved,
    )
