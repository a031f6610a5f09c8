"""Noise as it is, on simulated datasets: coloured, of the mains, quantised, with outliers and gaps."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from scipy.signal import lfilter

from needle_rig.dataset import Dataset
from needle_rig.numerics import Array
from needle_rig.units import nm, rad
from needle_rig.workbench.virtual.noise import Noise

Random = np.random.Generator
WANDER_SHARE = 0.5
"""Size of coloured noise and of hum in units of the white noise beside it."""
MAINS_HZ = 50.0
MAINS_OFF_HZ = 0.17
"""By which the mains, or the sampling, is off: the beat that is seen where the rate divides the mains."""
AVERAGED_SAMPLES = 10
GONE_SHARE, GONE_SAMPLES = 0.1, 15
OUTLIER_SHARE, OUTLIER_SIGMAS = 0.02, 25.0
STUDENT_DOF = 3.0


def _white(random: Random, time_s: Array) -> Array:
    return random.standard_normal(time_s.size)


def _wanders(tau_s: float) -> Callable[[Random, Array], Array]:
    def made(random: Random, time_s: Array) -> Array:
        keep = np.exp(-float(np.median(np.diff(time_s))) / tau_s)
        driven = np.sqrt(1.0 - keep**2) * random.standard_normal(time_s.size)
        driven[0] = random.standard_normal()
        noise: Array = _white(random, time_s) + WANDER_SHARE * lfilter([1.0], [1.0, -keep], driven)
        return noise

    return made


def _hum(random: Random, time_s: Array) -> Array:
    phase = 2 * np.pi * ((MAINS_HZ + MAINS_OFF_HZ) * time_s + random.random())
    noise: Array = _white(random, time_s) + WANDER_SHARE * np.sqrt(2.0) * np.sin(phase)
    return noise


def _averaged(random: Random, time_s: Array) -> Array:
    rough = random.standard_normal(time_s.size + AVERAGED_SAMPLES - 1)
    noise: Array = np.convolve(rough, np.full(AVERAGED_SAMPLES, AVERAGED_SAMPLES**-0.5), "valid")
    return noise


def _outliers(random: Random, time_s: Array) -> Array:
    hit = random.random(time_s.size) < OUTLIER_SHARE
    return _white(random, time_s) + OUTLIER_SIGMAS * hit * random.standard_normal(time_s.size)


def _gaps(random: Random, time_s: Array) -> Array:
    noise = _white(random, time_s)
    for begin in np.flatnonzero(random.random(time_s.size) < GONE_SHARE / GONE_SAMPLES):
        noise[begin : begin + GONE_SAMPLES] = np.nan
    return noise


def _heavy_tails(random: Random, time_s: Array) -> Array:
    scale = np.sqrt(STUDENT_DOF / (STUDENT_DOF - 2.0))
    noise: Array = random.standard_t(STUDENT_DOF, time_s.size) / scale
    return noise


KINDS: Mapping[str, Callable[[Random, Array], Array]] = {
    "white": _white,
    "wanders over 0.5 s": _wanders(0.5),
    "wanders over 2 s": _wanders(2.0),
    "wanders over 10 s": _wanders(10.0),
    "hum": _hum,
    "quantised": _white,
    "averaged": _averaged,
    "outliers": _outliers,
    "drop-outs": _gaps,
    "heavy tails": _heavy_tails,
}
"""Noise of one channel of one trial, (n,) in units of the standard deviation of its white part."""


def noisy(dataset: Dataset, kind: str, noise: Noise, seed: int) -> Dataset:
    """A dataset that was made without sensor noise, with noise of this kind where there are samples."""
    random = np.random.default_rng(seed)

    def read(values: Array, time_s: Array, size: float) -> Array:
        known = np.isfinite(values)
        seen = np.full_like(values, np.nan)
        if known.any():
            seen[known] = values[known] + size * KINDS[kind](random, time_s[known])
        return size * np.rint(seen / size) if kind == "quantised" else seen

    trials = []
    for given in dataset.trials:
        time_s = given.trial.time_s
        torque = read(given.torque_nm, time_s, nm(noise.torque_nmm))
        halls = [read(column, time_s, rad(noise.hall_deg)) for column in given.hall_rad.T]
        trials.append(dataclasses.replace(given, torque_nm=torque, hall_rad=np.column_stack(halls)))
    return dataclasses.replace(dataset, trials=tuple(trials))
