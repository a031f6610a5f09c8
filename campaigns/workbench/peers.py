"""What predicts commands left out beside `learn`: SINDy, symbolic regression, a discrepancy.

Each peer is fitted to the trials of all commands but one, and predicts the readings of that one from its
command alone, in the bins that a diagnosis uses. Angles in rad, torques in N·m, times in s.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.numerics import Array
from needle_rig.physics.trial_variables import rate_rad_s
from needle_rig.workbench.estimation.baseline import Baseline
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import start_vector
from needle_rig.workbench.observations.binning import BinnedTrial, sample_weights

TORQUE_UNIT_NM = 1e-4
"""Torques are given to the peers in this unit: as large as angles in rad."""


class Peer(Protocol):
    """A way of predicting; fitted once for every command that is left out, and once to all."""

    @property
    def name(self) -> str:
        """As it is called in the table."""

    @property
    def settings(self) -> str:
        """How it was asked, in words."""

    def fitted(self, trials: Sequence[int]) -> Predictor:
        """Fitted to trials (their places)."""


class Predictor(Protocol):
    """A fitted peer."""

    def readings(self, trial: int) -> Array:
        """Bin means (C, K) of a trial: torque in N·m, Hall angles in rad."""

    def says(self) -> str:
        """What it says of the needle, in short."""


@dataclass(frozen=True)
class Data:
    """A dataset as all get it: in samples, in bins, and the null model fitted to it."""

    baseline: Baseline

    @property
    def dataset(self) -> Dataset:
        return self.baseline.dataset

    @property
    def binned(self) -> tuple[BinnedTrial, ...]:
        return self.baseline.problem.trials

    @property
    def channels(self) -> list[str]:
        return ["torque", *self.dataset.sensor_names]

    @cached_property
    def linear(self) -> LinearisedFit:
        return LinearisedFit.of(self.baseline.problem, self.baseline.current)

    def scaled(self, trial: int) -> Array:
        """Bin means (C, K), torques in TORQUE_UNIT_NM."""
        return np.asarray(self.binned[trial].mean / self.units[:, None])

    @cached_property
    def units(self) -> Array:
        """(C,) that scaled values are multiplied by."""
        return np.asarray(np.r_[TORQUE_UNIT_NM, np.ones(len(self.channels) - 1)])

    @cached_property
    def noise(self) -> Array:
        """Standard deviation of the noise of one bin mean in the middle (C,), N·m and rad."""
        return np.array(
            [
                np.median(
                    np.concatenate(
                        [1.0 / np.diag(b.own) for w in self.whiteners for b in w.channels[c].blocks]
                    )
                )
                for c in range(len(self.channels))
            ]
        )

    @property
    def whiteners(self) -> Any:
        return self.baseline.problem.whiteners

    def error(self, left: Sequence[Array]) -> float:
        """Root mean square of data minus predicted (C, K), a trial each, in units of the noise.

        The trial's own friction is unknown: what it changes of the readings, as the null model has it, is
        taken out as far as its scatter allows, as in the project's cross-validation.
        """
        chi2 = 0.0
        for terms, whiten, each in zip(self.linear.trials, self.whiteners, left, strict=True):
            rows = whiten(each)
            step = float(terms.random_effect @ rows)
            chi2 += float(rows @ rows) - step**2 / terms.stiffness
        return float(np.sqrt(chi2 / self.baseline.problem.size))


def left_out_error(data: Data, peer: Peer) -> float:
    """Every command left out in turn and predicted."""
    left: list[Array] = [np.zeros(0)] * len(data.binned)
    for group in data.baseline.problem.groups:
        others = [t for t in range(len(data.binned)) if t not in group]
        model = peer.fitted(others)
        for t in group:
            left[t] = data.binned[t].mean - model.readings(t)
    return data.error(left)


def of_command(binned: BinnedTrial) -> tuple[list[str], Array]:
    """What is known of each bin before it is measured: names, values (K, 6)."""
    begun = [0.0]
    for number in range(1, len(binned.motions)):
        begun.append(float(binned.base_rad[np.flatnonzero(binned.motion < number)[-1]]))
    names = ["base", "rate", "direction", "begun", "stopped", "time"]
    columns = (
        binned.base_rad,
        binned.base_rate_rad_s,
        np.sign(binned.last_move_rad),
        np.array(begun)[binned.motion],
        binned.since_stop_s,
        binned.time_s,
    )
    return names, np.column_stack(columns)


# -- SINDy ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sindy:
    """PySINDy with control: d/dt of torque and Hall angles from these and the base's motion."""

    data: Data
    name: str = "PySINDy"
    settings: str = (
        "states: torque and Hall angles at 50 Hz; inputs: base angle, rate, |rate|; derivatives by smoothed"
        " finite differences; terms: linear, products of two, or these with sines and cosines of once to"
        " three times each variable; STLSQ with a threshold of 0.003 … 0.3; terms and threshold are those"
        " that, from each half of the commands given, predict the other best; then fitted to all given;"
        " simulated from rest by Heun's method"
    )

    THRESHOLDS = (0.003, 0.01, 0.03, 0.1, 0.3)

    def fitted(self, trials: Sequence[int]) -> Predictor:
        groups = [[t for t in group if t in trials] for group in self.data.baseline.problem.groups]
        groups = [group for group in groups if group]
        halves = [[t for group in groups[k::2] for t in group] for k in (0, 1)]
        rated: list[tuple[float, Terms, float]] = []
        for terms in TERMS:
            errors = np.zeros(len(self.THRESHOLDS))
            for given, left in (halves, halves[::-1]):
                models = [self._model(given, threshold, terms) for threshold in self.THRESHOLDS]
                wanted = np.concatenate([self.data.scaled(t) for t in left], axis=1)
                for k, told in enumerate(simulated(self.data, models, left)):
                    errors[k] += float(np.nansum((wanted - np.concatenate(told, axis=1)) ** 2))
            rated += [(float(e), terms, t) for e, t in zip(errors, self.THRESHOLDS, strict=True)]
        _, terms, threshold = min(rated, key=lambda r: r[0])
        return self._model(trials, threshold, terms)

    def _model(self, trials: Sequence[int], threshold: float, terms: Terms) -> SindyModel:
        import pysindy

        library: Any = pysindy.PolynomialLibrary(degree=terms.degree)
        if terms.fourier:
            library = library + pysindy.FourierLibrary(n_frequencies=FREQUENCIES)
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-3, max_iter=50),
            feature_library=library,
            differentiation_method=pysindy.SmoothedFiniteDifference(),
        )
        given = [self.data.dataset.trials[t] for t in trials]
        states = [np.column_stack([each.torque_nm / TORQUE_UNIT_NM, each.hall_rad]) for each in given]
        names = [*self.data.channels, "base", "rate", "|rate|"]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(
                states,
                t=[each.trial.time_s for each in given],
                u=[driven_by(each) for each in given],
                feature_names=names,
            )
        return SindyModel(self.data, model, terms)


@dataclass(frozen=True)
class Terms:
    """Which terms a system may have."""

    degree: int
    fourier: bool = False


TERMS = (Terms(1), Terms(2), Terms(2, fourier=True))


def library_features(x: Array, terms: Terms) -> Array:
    """The library's terms (n, F) at rows of variables (n, V), a hundred times as fast as it gives them."""
    i, j = np.triu_indices(x.shape[1])
    parts = [np.ones((len(x), 1)), x, *([x[:, i] * x[:, j]] if terms.degree > 1 else [])]
    for n in range(1, 1 + FREQUENCIES) if terms.fourier else ():
        parts.append(np.stack([np.sin(n * x), np.cos(n * x)], axis=2).reshape(len(x), -1))
    return np.hstack(parts)


def driven_by(trial: DatasetTrial) -> Array:
    """Base angle, rate and |rate| (samples, 3)."""
    rate = rate_rad_s(trial.trial)
    return np.column_stack([trial.trial.base_angle_rad, rate, np.abs(rate)])


FREQUENCIES = 3
FAR = 20.0
"""Scaled states are held within this: an unstable system ends there."""


def simulated(data: Data, models: Sequence[SindyModel], trials: Sequence[int]) -> list[list[Array]]:
    """Scaled bin means (C, K) of each trial by each model, all of one library, from rest by Heun's method."""
    given = [data.dataset.trials[t] for t in trials]
    most = max(each.trial.time_s.size for each in given)
    inputs = np.array([_padded(driven_by(each), most) for each in given])
    steps = np.diff([_padded(each.trial.time_s, most) for each in given], axis=1)
    coefficients = np.array([np.asarray(m.model.coefficients()) for m in models])
    terms = models[0].terms
    shape = (len(models), len(given), len(data.channels))

    def slope(x: Array, u: Array) -> Array:
        rows = np.concatenate([x, np.broadcast_to(u, (*x.shape[:2], u.shape[-1]))], axis=2)
        features = library_features(rows.reshape(-1, rows.shape[-1]), terms)
        return np.asarray(np.einsum("mcf,mtf->mtc", coefficients, features.reshape(*shape[:2], -1)))

    states = np.zeros((most, *shape))
    for k in range(most - 1):
        x, step = states[k], steps[:, k, None]
        first = slope(x, inputs[:, k])
        second = slope(np.clip(x + step * first, -FAR, FAR), inputs[:, k + 1])
        states[k + 1] = np.clip(x + 0.5 * step * (first + second), -FAR, FAR)
    weights = [sample_weights(each) for each in given]
    return [
        [
            np.array([w @ states[: w.shape[1], m, t, c] for c, w in enumerate(of_trial)])
            for t, of_trial in enumerate(weights)
        ]
        for m in range(len(models))
    ]


def _padded(values: Array, most: int) -> Array:
    """Its last value repeated."""
    return np.concatenate([values, np.repeat(values[-1:], most - len(values), axis=0)])


@dataclass(frozen=True)
class SindyModel:
    """A fitted system."""

    data: Data
    model: Any
    terms: Terms

    def readings(self, trial: int) -> Array:
        return np.asarray(simulated(self.data, [self], [trial])[0][0] * self.data.units[:, None])

    def says(self) -> str:
        coefficients = np.asarray(self.model.coefficients())
        names = self.model.get_feature_names()
        first = np.argsort(-np.abs(coefficients[0]))[:2]
        terms = " + ".join(f"{coefficients[0, k]:.2g} {names[k]}" for k in first if coefficients[0, k])
        count = int((coefficients != 0).sum())
        return f"{len(coefficients)} equations, {count} terms; torque′ = {terms or '0'} + …"


# -- symbolic regression -------------------------------------------------------------------------------------

Regressor = Callable[[], Any]
"""Makes what has fit(X, y), predict(X) and formula(names)."""


@dataclass(frozen=True)
class Symbolic:
    """One formula a channel."""

    data: Data
    make: Regressor
    name: str
    settings: str
    beside: bool = False
    """Whether a channel is also given all the others and their derivatives, which no command tells."""

    def fitted(self, trials: Sequence[int]) -> Predictor:
        models = []
        for channel in range(len(self.data.channels)):
            given = [self.inputs(t, channel) for t in trials]
            values = [self.data.scaled(t)[channel] for t in trials]
            inputs, wanted = np.vstack(given), np.concatenate(values)
            there = np.isfinite(wanted) & np.isfinite(inputs).all(axis=1)
            model = self.make()
            model.fit(inputs[there], wanted[there])
            models.append(model)
        return SymbolicModel(self, models)

    def names(self, channel: int) -> list[str]:
        """Of the inputs."""
        names = of_command(self.data.binned[0])[0]
        others = [name for k, name in enumerate(self.data.channels) if k != channel]
        return [*names, *others, *(f"{name}′" for name in others)] if self.beside else names

    def inputs(self, trial: int, channel: int) -> Array:
        """Of a channel (K, inputs)."""
        binned = self.data.binned[trial]
        known = of_command(binned)[1]
        if not self.beside:
            return known
        others = np.delete(self.data.scaled(trial), channel, axis=0)
        rates = np.gradient(others, binned.time_s, axis=1)
        return np.column_stack([known, others.T, rates.T])


@dataclass(frozen=True)
class SymbolicModel:
    """Formulas, fitted."""

    of: Symbolic
    models: Sequence[Any]

    def readings(self, trial: int) -> Array:
        data = self.of.data
        told = [m.predict(self.of.inputs(trial, c)) for c, m in enumerate(self.models)]
        return np.array(told) * data.units[:, None]

    def says(self) -> str:
        worst = int(np.argmax([self._left(c) for c in range(len(self.models))]))
        return f"{self.of.data.channels[worst]} = {self.models[worst].formula(self.of.names(worst))}"

    def _left(self, channel: int) -> float:
        """Of one channel, in units of its noise: where the formula has most to say that it does not."""
        data = self.of.data
        parts = []
        for t in range(len(data.binned)):
            told = self.models[channel].predict(self.of.inputs(t, channel)) * data.units[channel]
            parts.append(data.binned[t].mean[channel] - told)
        return float(np.sqrt(np.nanmean(np.concatenate(parts) ** 2)) / data.noise[channel])


# -- a discrepancy -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Discrepancy:
    """The null model, calibrated, and a Gaussian process for what it leaves, a channel each.

    Kennedy, O'Hagan, J. R. Statist. Soc. B 63 (2001); modular: calibrated first, then the discrepancy, as
    Liu, Bayarri, Berger, Bayesian Analysis 4 (2009).
    """

    data: Data
    name: str = "Gaussian-process discrepancy"
    settings: str = (
        "friction and rigidity of the null model fitted to the trials given; what it leaves in each channel,"
        " at each trial's own friction: a Gaussian process over base angle, rate, direction and time"
        " (anisotropic squared exponential plus white noise, likelihood maximised from two starts on a third"
        " of the bins; scikit-learn)"
    )

    INPUTS = ("base", "rate", "direction", "time")
    THIN = 3
    """Of so many bins one serves for the likelihood of a process; its mean is that of all."""

    def fitted(self, trials: Sequence[int]) -> Predictor:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

        data = self.data
        problem = data.baseline.problem.over([data.binned[t] for t in trials])
        current = data.baseline.current
        begin = start_vector(problem, current.vector.log_friction)
        calibrated = fit(problem, (), begin)
        assert calibrated is not None
        model = data.baseline.problem.model((), calibrated.vector)
        inputs = np.vstack([self.inputs(t) for t in trials])
        centre, width = inputs.mean(axis=0), inputs.std(axis=0) + 1e-9
        processes = []
        # at each trial's own friction: its scatter is no discrepancy
        told = problem.predict(calibrated.parameters, calibrated.vector)
        left = [b.mean - r for b, r in zip(problem.trials, told, strict=True)]
        for channel in range(len(data.channels)):
            wanted = np.concatenate([each[channel] for each in left]) / data.noise[channel]
            rows = np.flatnonzero(np.isfinite(wanted))
            at, few = (inputs - centre) / width, rows[:: self.THIN]
            kernel = ConstantKernel(10.0, (1e-3, 1e5)) * RBF(
                np.ones(len(self.INPUTS)), (0.02, 100.0)
            ) + WhiteKernel(1.0, (0.1, 1e4))
            learnt = GaussianProcessRegressor(kernel, n_restarts_optimizer=1, random_state=0)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                learnt.fit(at[few], wanted[few])
            process = GaussianProcessRegressor(learnt.kernel_, optimizer=None)
            processes.append(process.fit(at[rows], wanted[rows]))
        return DiscrepancyModel(self, model, processes, centre, width)

    def inputs(self, trial: int) -> Array:
        """(K, 4)."""
        names, values = of_command(self.data.binned[trial])
        return values[:, [names.index(name) for name in self.INPUTS]]


@dataclass(frozen=True)
class DiscrepancyModel:
    """Calibrated, with its processes."""

    of: Discrepancy
    model: Any
    processes: Sequence[Any]
    centre: Array
    width: Array

    def readings(self, trial: int) -> Array:
        data = self.of.data
        at = (self.of.inputs(trial) - self.centre) / self.width
        added = np.array([p.predict(at) for p in self.processes]) * data.noise[:, None]
        return np.asarray(data.baseline.problem.readings([self.model], [trial])[0] + added)

    def says(self) -> str:
        sizes = [float(np.sqrt(p.kernel_.k1.k1.constant_value)) for p in self.processes]
        worst = int(np.argmax(sizes))
        lengths = np.atleast_1d(self.processes[worst].kernel_.k1.k2.length_scale)
        along = self.of.INPUTS[int(np.argmin(lengths))]
        return f"most in {self.of.data.channels[worst]}: {sizes[worst]:.1f} × its noise, mostly along {along}"
