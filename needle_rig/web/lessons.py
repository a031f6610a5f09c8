"""Each effect in a standard trial: what it changes against the null model, in units of the noise.

The base's path is that of the null model's own compensation, so that every difference is the effect's.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, ParameterInfo, Reading, Trial
from needle_rig.physics.effect_text import effect_called
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.simulation.base_drive import phases
from needle_rig.simulation.protocol import compensation
from needle_rig.units import deg, nmm
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


def effects_document(directories: Sequence[Path]) -> list[Document]:
    """Every effect of the library: law, source and parameters with their ranges."""
    return [
        {
            "name": name,
            "text": inspect.getdoc(sys.modules[effect.__module__]) or "",
            "first": (inspect.getdoc(sys.modules[effect.__module__]) or name).splitlines()[0],
            "parameters": [_parameter(field, info) for field, info in effect.parameters().items()],
            "relatives": list(effect.relatives),
            "redundant_with": list(effect.redundant_with),
            "hooks": [hook for hook in ("drive", "shape", "torque", "observe") if effect.has(hook)],
        }
        for name, effect in find_effects(directories).items()
    ]


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


def lesson(effect: str, values: Mapping[str, float], directories: Sequence[Path] = ()) -> Document:
    """The standard trial with and without `effect` at `values`, in units of files.

    Raises BadInput, SolverError.
    """
    kind = effect_called(effect, find_effects(directories))
    known = kind.parameters()
    for name in values:
        if name not in known:
            raise BadInput(f"{effect} has no parameter {name}; it has {', '.join(known)}")
    null, trial, names = _standard()
    base = _read(null, trial)
    changed = _read(null.with_effects(_effect(kind, values)), trial)
    noise = Noise()
    channels = []
    for c in range(base.shape[0]):
        spread, unit = (noise.torque_nmm, "N·mm") if c == 0 else (noise.hall_deg, "°")
        decimals = 5 if c == 0 else 3
        difference = (changed[c] - base[c]) / spread
        channels.append(
            {
                "name": "torque" if c == 0 else f"hall_{c}",
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
        "phases": names,
        "channels": channels,
    }


def _effect(kind: type[Effect], values: Mapping[str, float]) -> Effect:
    typical = kind.at_strength(1.0)
    return kind(**{field: getattr(typical, field) for field in kind.parameters()} | dict(values))


@cache
def _standard() -> tuple[NeedleModel, Trial, list[Document]]:
    """The null model, the trial and where its motions begin."""
    null = dataclasses.replace(load_parameters(PARAMETERS), effects=(), element_length_m=ELEMENT_M)
    command, random = compensation(TARGET_DEG), np.random.default_rng(0)
    motions = planned_motions(null, command, PLACE, NO_NOISE, random, null.torsional_rigidity_nm2, RATE_HZ)
    trial = driven(motions, motions[-1].end_s, PLACE, RATE_HZ)
    named = phases(motions, trial.time_s)
    starts = np.r_[0, np.flatnonzero(named[1:] != named[:-1]) + 1]
    return null, trial, [{"name": str(named[i]), "start_s": float(trial.time_s[i])} for i in starts]


def _read(model: NeedleModel, trial: Trial) -> Array:
    """Channels (C, samples) in N·mm and degrees."""
    reading: Reading = model.predict(trial)
    return np.vstack([nmm(reading.torque_nm)[None, :], deg(reading.hall_rad.T)])


def _rounded(values: Array, decimals: int) -> list[float]:
    return [float(v) for v in np.round(values, decimals)]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
