"""Whole runs in virtual time: a brain against a plant, tick by tick, without a clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from needle_rig.control.brain import Brain
from needle_rig.control.compensation import ACTIVE
from needle_rig.control.reports import BrainState, Outcome, Request
from needle_rig.control.strategy import SettledMotion
from needle_rig.errors import RigFault
from needle_rig.numerics import Array
from needle_rig.records import Sample
from needle_rig.simulation.plant import Plant

LONGEST_S = 7200.0


@dataclass(frozen=True)
class VirtualRun:
    """A run that ended. `shafts_rad` holds the true shaft, shape (nodes,), after each settled motion."""

    outcome: Outcome
    settled: tuple[SettledMotion, ...]
    samples: tuple[Sample, ...]
    shafts_rad: tuple[Array, ...]
    time_s: float


def run_virtual(
    brain: Brain,
    plant: Plant,
    request: Request,
    *,
    tick_s: float = 0.005,
    ticks: Iterator[float] | None = None,
    on_tick: Callable[[Sample, BrainState], None] | None = None,
    shafts: bool = False,
) -> VirtualRun:
    """Run `request` to its end. `ticks` gives the length of every tick where they are not all `tick_s`.

    Raises what `Brain.compensate` raises, and RigFault when the run does not end within two hours.
    """
    brain.compensate(request)
    samples: list[Sample] = []
    pictures: list[Array] = []
    start_s = plant.time_s
    settled = 0
    while True:
        dt_s = next(ticks) if ticks is not None else tick_s
        plant.advance(dt_s)
        command, sample = brain.step(plant.read(), dt_s)
        plant.write(command)
        samples.append(sample)
        if on_tick is not None:
            on_tick(sample, brain.state)
        if shafts and len(brain.settled) > settled:
            settled = len(brain.settled)
            pictures.append(plant.shaft_rad())
        if sample.phase not in ACTIVE:
            break
        if plant.time_s - start_s > LONGEST_S:
            raise RigFault(f"the virtual run did not end within {LONGEST_S:g} s; it waits in {sample.phase}")
    outcome = brain.state.outcome
    assert outcome is not None
    return VirtualRun(outcome, brain.settled, tuple(samples), tuple(pictures), plant.time_s - start_s)
