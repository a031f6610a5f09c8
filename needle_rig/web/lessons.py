"""Each effect in a standard trial: what it changes against the null model, in units of the noise.

The base's path is that of the null model's own compensation, so that every difference is the effect's. The
shaft is the paper's, or that of a dataset with its own noise.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import compensation
from needle_rig.errors import BadInput
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, ParameterInfo, Reading, Trial
from needle_rig.physics.effect_text import effect_called
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.simulation.drive.base_drive import phases
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.baseline import element_length, null_model
from needle_rig.workbench.learning.observations import Traces, read_observations
from needle_rig.workbench.virtual.dataset import driven, planned_motions
from needle_rig.workbench.virtual.noise import NO_NOISE, Noise

PARAMETERS = "rig_rigid"
TARGET_DEG = 45.0
RATE_HZ = 25.0
"""A plot has as many dots; a bin of the workbench is longer."""
ELEMENT_M = 4e-3
"""As in fits."""
PLACE = Trial(np.empty(0), np.empty(0), 600.0, 10, 60.0)
"""Of the trial in its series, so that what drifts or wears has had time: ten trials in as many minutes."""

_UNIT = re.compile(r"_(nmms?_per_rad(_per_100mm)?|nmm_per_100mm|nmm_per_min|nmm|deg_s|deg|mm|m?s)$")

Document = dict[str, Any]


def effects_document(directories: Sequence[Path]) -> Document:
    """Every effect of the library: law, source and parameters with their ranges; and what cannot be used."""
    library = find_effects(directories)
    return {
        "effects": [
            {
                "name": name,
                "text": inspect.getdoc(sys.modules[effect.__module__]) or "",
                "first": (inspect.getdoc(sys.modules[effect.__module__]) or name).splitlines()[0],
                "parameters": [_parameter(field, info) for field, info in effect.parameters().items()],
                "relatives": list(effect.relatives),
                "redundant_with": list(effect.redundant_with),
                "hooks": effect.hooks(),
            }
            for name, effect in library.items()
        ],
        "broken": [sentence for _, sentence in library.broken],
    }


def _parameter(field: str, info: ParameterInfo) -> Document:
    low, high = info.literature
    return {
        "name": field,
        "words": _words(field),
        "unit": info.unit,
        "off": _finite(info.off),
        "typical": info.typical,
        "smallest": info.smallest,
        "lower": info.lower,
        "upper": _finite(info.upper),
        "literature": [low, _finite(high)],
        "scale": info.scale,
        "per": info.per,
        "shapes": info.shapes,
    }


def _words(field: str) -> str:
    """A field without its unit, as people read it."""
    return _UNIT.sub("", field).replace("_", " ")


@dataclass(frozen=True, eq=False)
class Setting:
    """A shaft without effects and its trial."""

    null: NeedleModel
    trial: Trial
    phases: list[Document]
    """Where its motions begin."""
    channels: tuple[str, ...]
    noise: tuple[float, ...]
    """Standard deviation of each channel: torque N·mm, then angles °."""
    told: str
    """Which shaft it is, for a person."""


def lesson(
    effect: str, values: Mapping[str, float], data: str | None = None, directories: Sequence[Path] = ()
) -> Document:
    """The standard trial with and without `effect` at `values`, in units of files.

    On the shaft of the dataset or run at `data`; without it on the paper's. Raises BadInput, SolverError.
    """
    kind = effect_called(effect, find_effects(directories))
    known = kind.parameters()
    for name in values:
        if name not in known:
            raise BadInput(f"{effect} has no parameter {name}; it has {', '.join(known)}")
    setting = _standard() if data is None else _of_dataset(data)
    trial = setting.trial
    base = _read(setting.null, trial)
    changed = _read(setting.null.with_effects(_effect(kind, values)), trial)
    channels = []
    for c, (name, spread) in enumerate(zip(setting.channels, setting.noise, strict=True)):
        unit = "N·mm" if c == 0 else "°"
        decimals = max(0, 2 - math.floor(math.log10(spread)))
        difference = (changed[c] - base[c]) / spread
        channels.append(
            {
                "name": name,
                "unit": unit,
                "noise": spread,
                "null": _rounded(base[c], decimals),
                "effect": _rounded(changed[c], decimals),
                "sigmas": _rounded(difference, 2),
                "rms_sigmas": round(float(np.sqrt(np.mean(difference**2))), 2),
                "most_sigmas": round(float(np.abs(difference).max()), 2),
            }
        )
    return {
        "time_s": _rounded(trial.time_s, 3),
        "base_deg": _rounded(deg(trial.base_angle_rad), 2),
        "phases": setting.phases,
        "shaft": setting.told,
        "channels": channels,
    }


def _effect(kind: type[Effect], values: Mapping[str, float]) -> Effect:
    typical = kind.at_strength(1.0)
    return kind(**{field: getattr(typical, field) for field in kind.parameters()} | dict(values))


@cache
def _standard() -> Setting:
    """The shaft of the paper's experiment, with the noise of the practice datasets."""
    null = dataclasses.replace(load_parameters(PARAMETERS), effects=(), element_length_m=ELEMENT_M)
    noise, sensors = Noise(), len(null.layout.sensor_positions_m)
    channels = ("torque", *(f"hall_{k + 1}" for k in range(sensors)))
    return _setting(
        null, channels, (noise.torque_nmm, *(noise.hall_deg,) * sensors), "the experiment's layout"
    )


@cache
def _of_dataset(data: str) -> Setting:
    """The shaft of a dataset, with the noise of its channels. Raises BadInput."""
    observed = read_observations([data])
    if not isinstance(observed, Traces):
        raise BadInput(f"{observed.name}: holds settled values only; choose a dataset of traces")
    dataset = observed.data
    null = null_model(dataset)
    null = dataclasses.replace(null, element_length_m=element_length(null))
    told = f"the layout of {observed.name}, with the noise of its channels"
    return _setting(null, ("torque", *dataset.sensor_names), _white_noise(dataset), told)


def _white_noise(dataset: Dataset) -> tuple[float, ...]:
    """Of each channel, from the differences of neighbouring samples; that of the practice datasets where a
    channel has none, or does not change.
    """
    usual = Noise()
    found = []
    for c in range(1 + len(dataset.sensor_names)):
        steps = [np.diff(nmm(t.torque_nm) if c == 0 else deg(t.hall_rad[:, c - 1])) for t in dataset.trials]
        size = np.abs(np.concatenate(steps))
        spread = float(np.median(size[np.isfinite(size)])) / (0.6745 * math.sqrt(2.0)) if size.size else 0.0
        fallback = usual.torque_nmm if c == 0 else usual.hall_deg
        found.append(spread if math.isfinite(spread) and spread > 0 else fallback)
    return tuple(found)


def _setting(null: NeedleModel, channels: tuple[str, ...], noise: tuple[float, ...], told: str) -> Setting:
    command, random = compensation(TARGET_DEG), np.random.default_rng(0)
    motions = planned_motions(null, command, PLACE, NO_NOISE, random, null.torsional_rigidity_nm2, RATE_HZ)
    trial = driven(motions, motions[-1].end_s, PLACE, RATE_HZ)
    named = phases(motions, trial.time_s)
    starts = np.r_[0, np.flatnonzero(named[1:] != named[:-1]) + 1]
    begun = [{"name": str(named[i]), "start_s": float(trial.time_s[i])} for i in starts]
    return Setting(null, trial, begun, channels, noise, told)


def _read(model: NeedleModel, trial: Trial) -> Array:
    """Channels (C, samples) in N·mm and degrees."""
    reading: Reading = model.predict(trial)
    return np.vstack([nmm(reading.torque_nm)[None, :], deg(reading.hall_rad.T)])


def _rounded(values: Array, decimals: int) -> list[float]:
    return [float(v) for v in np.round(values, decimals)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
