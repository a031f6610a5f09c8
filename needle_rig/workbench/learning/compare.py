"""Where a model fails on measurements: by channel, motion and direction, in degrees, N·mm and noise units."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from needle_rig.dataset import Dataset
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.observations.binning import direction_of
from needle_rig.workbench.selection.answer import fitted_sentences, left_out_error
from needle_rig.workbench.selection.documents import ChannelError, CompareDocument, FittedNumber, PlaceError

WORST, WORST_OF_A_CHANNEL = 8, 2
"""Places that are told, and those of one channel."""
NOISE_LIMIT = 3.0
"""Error in units of the noise above which a place is told."""
FEWEST_DEPTHS = 3
"""Sensors from which a trend along the needle is told."""
GROWTH = 1.3
"""Ratio of errors at the two ends of the needle from which they differ."""
OTHER_WAY = 0.3
"""Share of an error below which the other direction of motion does not have it."""


@dataclass(frozen=True)
class Place:
    """One channel in one motion (moving or settled), all trials of one direction together."""

    channel: str
    motion: str
    state: str
    direction: str
    model: float
    measured: float
    error: float
    """Root mean square of measured minus model over the trials, in `unit`."""
    noise: float
    """Standard deviation of the same from noise and the scatter of the trials, in `unit`."""
    unit: str
    trial: str
    """File of the trial in which it is worst."""
    words: str = ""

    @property
    def sigmas(self) -> float:
        """Error in units of the noise."""
        return self.error / self.noise if self.noise > 0 else 0.0

    def as_json(self) -> PlaceError:
        """As it stands in the JSON answer."""
        return {
            "channel": self.channel,
            "motion": self.motion,
            "state": self.state,
            "direction": self.direction,
            "model": round(self.model, 5),
            "measured": round(self.measured, 5),
            "error": round(self.error, 5),
            "noise": round(self.noise, 5),
            "sigmas": round(self.sigmas, 2),
            "unit": self.unit,
            "trial": self.trial,
            "words": self.words,
        }


@dataclass(frozen=True)
class TraceComparison:
    """The answer to `needle-rig compare` on traces."""

    baseline: Baseline = field(repr=False)
    every_place: tuple[Place, ...]
    """Every channel × motion × state × direction."""
    worst: tuple[Place, ...]
    channels: dict[str, ChannelError]
    free_parameters: dict[str, FittedNumber]
    reduced_chi2: float
    held_out_error: float

    def headline(self) -> tuple[str, str]:
        """The dataset's name, and what is said of it."""
        return self.baseline.dataset.name, (
            f"against the model {self.baseline.problem.base.name}: error on commands left out"
            f" {left_out_error(self.held_out_error)} × the noise, reduced χ² {self.reduced_chi2:.2f}"
        )

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headings of the table by channel, and its rows."""
        rows: list[tuple[str, ...]] = []
        for name, of in self.channels.items():
            whitened = "—" if of["whitened"] is None else f"{of['whitened']:.3g}"
            rows.append((name, f"{of['rmse']} {of['unit']}", f"{of['noise']} {of['unit']}", whitened))
        return ("channel", "rmse", "noise", "in units of the noise"), rows

    def sentences(self) -> list[str]:
        """The worst places, fitted parameters and notes."""
        worst = ["Worst places:"] if self.worst else ["No place is above 3 × its noise."]
        worst += [f"  {place.sigmas:6.0f}σ  {place.words}" for place in self.worst]
        return [*worst, *fitted_sentences(self.free_parameters), *(f"note: {n}" for n in self.notes)]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the dataset and of the baseline fit."""
        return *self.baseline.dataset.notes, *self.baseline.notes

    def places(self) -> list[PlaceError]:
        """Every channel × motion × state × direction."""
        return [p.as_json() for p in self.every_place]

    def traces(self) -> TraceComparison:
        """What can be drawn: all of it."""
        return self

    def as_json(self) -> CompareDocument:
        """The stated form of the answer."""
        return {
            "dataset": self.baseline.dataset.name,
            "model": self.baseline.problem.base.name,
            "free_parameters": self.free_parameters,
            "held_out_error": _finite(self.held_out_error),
            "noise_floor": 1.0,
            "reduced_chi2": _finite(self.reduced_chi2),
            "channels": self.channels,
            "worst": [p.as_json() for p in self.worst],
            "notes": list(self.notes),
        }


def _finite(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None


def compare(
    dataset: Dataset, library: Mapping[str, type[Effect]], model: NeedleModel | None = None
) -> TraceComparison:
    """Fit the model to the dataset and look where it still fails. Raises BadInput, SolverError."""
    return compared(fit_baseline(dataset, model, library))


def compared(baseline: Baseline) -> TraceComparison:
    """The comparison of a model that is fitted already."""
    problem, found = baseline.problem, baseline.current
    readings = problem.predict(found.parameters, found.vector)
    names = ("torque", *baseline.dataset.sensor_names)
    places = _places(baseline, readings, names)
    worst = sorted((p for p in places if p.sigmas > NOISE_LIMIT), key=lambda p: -p.sigmas)
    shown: list[Place] = []
    for place in worst:
        if sum(p.channel == place.channel for p in shown) < WORST_OF_A_CHANNEL:
            shown.append(_in_words(place, places, names))
        if len(shown) == WORST:
            break
    vector = found.vector
    free: dict[str, FittedNumber] = {
        "friction_nmm_per_100mm": {"value": float(f"{np.exp(vector.log_friction) * 100:.6g}")},
        "torsional_rigidity_nmm2": {
            "value": float(f"{np.exp(vector.log_rigidity) * 1e6:.6g}"),
            "pull_sigma": round(found.pull_rigidity, 2),
        },
        "friction_scatter": {"value": float(f"{found.scatter:.3g}")},
    }
    for parameter, at in zip(found.parameters, vector.scaled_values, strict=True):
        free[f"{parameter.effect}.{parameter.name}"] = {
            "value": float(f"{parameter.value(float(at)):.6g}"),
            "unit": parameter.info.unit,
        }
    return TraceComparison(
        baseline=baseline,
        every_place=tuple(places),
        worst=tuple(shown),
        channels=_channels(baseline, readings, names, places),
        free_parameters=free,
        reduced_chi2=found.chi2 / max(1, problem.size - 2 - len(found.parameters)),
        held_out_error=baseline.validation.error,
    )


def scale_of(channel: int) -> tuple[float, str]:
    """Factor from SI to what people read, and its unit."""
    return (nmm(1.0), "N·mm") if channel == 0 else (deg(1.0), "°")


def motion_words(name: str) -> str:
    """A motion's name as people read it."""
    return name.replace("_", " ")


def _places(baseline: Baseline, readings: list[Array], names: tuple[str, ...]) -> list[Place]:
    problem = baseline.problem
    noise = problem.noise
    groups: dict[tuple[int, str, str, str], list[tuple[float, float, float, float, str]]] = {}
    for binned, reading in zip(problem.trials, readings, strict=True):
        for m, motion in enumerate(binned.motions):
            move = binned.last_move_rad[binned.motion == m]
            way = {0.0: "", 1.0: "up", -1.0: "down"}[float(direction_of(move[:1]).sum())]
            for state in ("moving", "settled"):
                inside = (binned.motion == m) & (binned.moving == (state == "moving"))
                if not inside.any():
                    continue
                for c in range(len(names)):
                    use = inside & np.isfinite(binned.mean[c])
                    if not use.any():
                        continue
                    weight = binned.count[c][use]
                    measured = float(np.average(binned.mean[c][use], weights=weight))
                    modelled = float(np.average(reading[c][use], weights=weight))
                    left = binned.mean[c][use] - reading[c][use]
                    rms = float(np.sqrt(np.average(left**2, weights=weight)))
                    if state == "settled":
                        rms = abs(measured - modelled)
                    variance = (
                        noise.white[c] ** 2 / (weight.sum() if state == "settled" else weight.mean())
                        + noise.correlated[c] ** 2
                        / max(1.0, binned.duration_s[use].sum() / (2 * noise.correlation_s[c]))
                        + noise.offset[c] ** 2
                        + noise.motion[c] ** 2
                        + (noise.jitter_s * np.abs(binned.base_rate_rad_s[use]).max()) ** 2 * (c > 0)
                    )
                    groups.setdefault((c, motion, state, way), []).append(
                        (measured, modelled, rms, float(np.sqrt(variance)), binned.file)
                    )
    places = []
    for (c, motion, state, way), seen in groups.items():
        factor, unit = scale_of(c)
        worst = max(seen, key=lambda s: s[2])
        rms = float(np.sqrt(np.mean([s[2] ** 2 for s in seen])))
        expected = float(np.sqrt(np.mean([s[3] ** 2 for s in seen])))
        places.append(
            Place(
                names[c],
                motion,
                state,
                way,
                factor * worst[1],
                factor * worst[0],
                factor * rms,
                factor * expected,
                unit,
                worst[4],
            )
        )
    return places


def _in_words(place: Place, places: list[Place], names: tuple[str, ...]) -> Place:
    digits = 3 if place.unit == "N·mm" else 1
    when = (
        f"settled after {motion_words(place.motion)}"
        if place.state == "settled"
        else f"during {motion_words(place.motion)}"
    )
    way = {"up": " (base turned up)", "down": " (base turned down)"}.get(place.direction, "")
    text = (
        f"{place.channel} {when}{way}: model {place.model:.{digits}f} {place.unit},"
        f" measured {place.measured:.{digits}f} {place.unit}"
    )
    more = []
    if place.channel != "torque":
        same = [
            p.error
            for n in names[1:]
            for p in places
            if (p.channel, p.motion, p.state, p.direction) == (n, place.motion, place.state, place.direction)
        ]
        if len(same) >= FEWEST_DEPTHS:
            first, last = same[0], same[-1]
            if last > GROWTH * first:
                more.append("grows with depth")
            elif first > GROWTH * last:
                more.append("falls with depth")
            else:
                more.append("alike at every depth")
    twin = [
        p
        for p in places
        if (p.channel, p.motion, p.direction) == (place.channel, place.motion, place.direction)
        and p.state != place.state
    ]
    if twin and place.state == "settled":
        more.append("there while moving too" if twin[0].sigmas > NOISE_LIMIT else "only once settled")
    elif twin:
        more.append("stays when settled" if twin[0].sigmas > NOISE_LIMIT else "gone once settled")
    other = [
        p
        for p in places
        if (p.channel, p.state) == (place.channel, place.state) and p.direction not in ("", place.direction)
    ]
    if other and place.direction and max(p.error for p in other) < OTHER_WAY * place.error:
        more.append("in this direction alone")
    words = text + ("; " + "; ".join(more) if more else "")
    return dataclasses.replace(place, words=words)


def _channels(
    baseline: Baseline, readings: list[Array], names: tuple[str, ...], places: list[Place]
) -> dict[str, ChannelError]:
    problem = baseline.problem
    found: dict[str, ChannelError] = {}
    for c, name in enumerate(names):
        factor, unit = scale_of(c)
        squares, count, noise = 0.0, 0.0, problem.noise
        for binned, reading in zip(problem.trials, readings, strict=True):
            use = np.isfinite(binned.mean[c])
            squares += float(((binned.mean[c][use] - reading[c][use]) ** 2 * binned.count[c][use]).sum())
            count += float(binned.count[c][use].sum())
        white = np.hypot(noise.white[c], noise.correlated[c])
        phases: dict[str, dict[str, dict[str, float]]] = {}
        for p in places:
            if p.channel == name:
                key = p.motion if not p.direction else f"{p.motion} {p.direction}"
                phases.setdefault(key, {})[p.state] = {
                    "error": round(p.error, 5),
                    "noise": round(p.noise, 5),
                    "sigmas": round(p.sigmas, 2),
                }
        whitened = np.concatenate(
            [r[w.channel == c] for r, w in zip(baseline.current.residuals, problem.whiteners, strict=True)]
        )
        found[name] = {
            "rmse": float(f"{factor * np.sqrt(squares / max(count, 1.0)):.4g}"),
            "noise": float(f"{factor * white:.4g}"),
            "unit": unit,
            "whitened": _finite(float(np.sqrt(np.mean(whitened**2)))) if whitened.size else None,
            "by_phase": phases,
        }
    return found
