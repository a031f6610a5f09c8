"""What a dataset holds once it is read: SI, radians, one record a trial."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.machine import NEEDLE, MachineName
from needle_rig.physics.rod import Layout
from needle_rig.physics.torque_scale import torque_scale
from needle_rig.records import JsonObject

Mask = npt.NDArray[np.bool_]
Names = npt.NDArray[np.str_]
Start: TypeAlias = Literal["relaxed", "wound", "zeroed"]
"""How the shaft was when the recording began: without twist; with an unknown one, readings counted from the
relaxed shaft; with an unknown one, readings counted from there."""

UNKNOWN_SIGMA = 1.5
"""Standard deviation of the logarithm of a rigidity that is only guessed: a factor of 4.5."""


@dataclass(frozen=True)
class Needle:
    """The needle's stated constants, and how well its torsional rigidity is known."""

    diameter_m: float
    shear_modulus_pa: float
    density_kg_m3: float
    rigidity_sigma: float = 0.02
    """One standard deviation of the torsional rigidity, as a fraction of it."""

    @classmethod
    def of_rigidity(cls, torsional_rigidity_nm2: float, rigidity_sigma: float = 0.02) -> Needle:
        """A shaft that is known by its torsional rigidity alone, as a wire of 1 mm with that rigidity."""
        return cls(1e-3, torsional_rigidity_nm2 * 32.0 / (math.pi * 1e-12), 6450.0, rigidity_sigma)

    @property
    def rigidity_is_known(self) -> bool:
        """Whether its torsional rigidity was stated, and not only guessed from torque and angles."""
        return self.rigidity_sigma < UNKNOWN_SIGMA

    @property
    def torsional_rigidity_nm2(self) -> float:
        """π d⁴/32 · G, the product that twist depends on (PHYSICS eq. 1), in N·m²."""
        return math.pi * self.diameter_m**4 / 32.0 * self.shear_modulus_pa


@dataclass(frozen=True)
class TrialCommand:
    """What the rig was told to do. Equal for trials that repeat each other."""

    kind: str
    target_deg: float | None = None
    speed_deg_s: float | None = None
    settle_s: float | None = None
    steps_deg: tuple[float, ...] = ()
    other: tuple[tuple[str, str], ...] = ()
    """Further keys of the trial in dataset.yaml, as written, by name."""

    def file_keys(self) -> JsonObject:
        """The keys that dataset and protocol files write for this command."""
        keys = {
            "target_deg": self.target_deg,
            "steps_deg": list(self.steps_deg) or None,
            "speed_deg_s": self.speed_deg_s,
            "settle_s": self.settle_s,
        }
        return {"kind": self.kind} | {key: value for key, value in keys.items() if value is not None}


@dataclass(frozen=True)
class DatasetTrial:
    """One trial: what drives the model, what it must predict, and where it comes from.

    Measured values that are missing are NaN; `torque_ok` and `hall_ok` are True where there is one.
    """

    trial: Trial
    """Input of the model: the base path with the encoder's noise taken out (see `denoised_base`), and the
    tip's torque as recorded, where one was."""
    base_measured_rad: Array
    """The encoder as recorded, (samples,), NaN where missing."""
    base_residual_rad: float
    """Root mean square of what was taken out of the encoder's reading."""
    torque_nm: Array
    hall_rad: Array
    phase: Names
    """Name of the motion at each sample, (samples,)."""
    command: TrialCommand
    file: str
    torque_column: str = "base_torque_nmm"
    """What the file calls the torque, with its unit."""
    notes: tuple[str, ...] = ()
    """What was found wrong with the file and how it was handled, a sentence each."""
    start: Start = "relaxed"
    turns_before_rad: tuple[float, ...] = ()
    """Turning points of the base from a relaxed shaft at 0 to where the trial begins, that friction has not
    forgotten; none where the trial begins relaxed."""
    turns_before_s: tuple[float, ...] = ()
    """How long before the trial's beginning the base came to each of them; none where nobody knows."""
    start_change: Array | None = None
    """What an unknown start changes of the readings, (changes, channels, samples), torque first: independent
    standard deviations."""
    start_found: bool = False
    """Whether what is compared depends on the start that was found for it; not after a run-in."""

    @property
    def torque_ok(self) -> Mask:
        """True where there is a torque, (samples,)."""
        return np.isfinite(self.torque_nm)

    @property
    def hall_ok(self) -> Mask:
        """True where there is an angle, (samples, sensors)."""
        return np.isfinite(self.hall_rad)


@dataclass(frozen=True)
class Dataset:
    """Trials of one rig in the order in which they were made."""

    name: str
    layout: Layout
    sensor_names: tuple[str, ...]
    needle: Needle
    trials: tuple[DatasetTrial, ...]
    notes: tuple[str, ...] = field(default=())
    """What was found wrong and how it was handled, those of the trials included."""
    simulated: bool = False
    """It was recorded on a simulated rig; no real needle was turned."""
    machine: MachineName = NEEDLE
    """What it was recorded on."""
    lever_m: float | None = None
    """Radius by which what slides was made to turn; None of what turns itself."""

    @cached_property
    def torque_scale(self) -> float:
        """Size of its torques over the needle's, see `physics.torque_scale`."""
        spans = [float(np.ptp(t.torque_nm[t.torque_ok])) for t in self.trials if t.torque_ok.any()]
        told_nm2 = self.needle.torsional_rigidity_nm2 if self.needle.rigidity_is_known else None
        return torque_scale(float(np.median(spans)) if spans else 0.0, told_nm2)

    @property
    def replicates(self) -> dict[TrialCommand, tuple[int, ...]]:
        """Places in `trials` of those that repeat each other, by command."""
        groups: dict[TrialCommand, list[int]] = {}
        for place, trial in enumerate(self.trials):
            groups.setdefault(trial.command, []).append(place)
        return {command: tuple(places) for command, places in groups.items()}


def in_series(trials: tuple[DatasetTrial, ...]) -> tuple[DatasetTrial, ...]:
    """`trials` ordered by their start, each told its index and the base travel of those before it."""
    ordered = sorted(trials, key=lambda t: t.trial.start_s)
    travel_rad, placed = 0.0, []
    for index, trial in enumerate(ordered):
        driven = dataclasses.replace(trial.trial, index=index, travel_before_rad=travel_rad)
        placed.append(dataclasses.replace(trial, trial=driven))
        travel_rad += float(np.abs(np.diff(driven.base_angle_rad)).sum())
    return tuple(placed)
