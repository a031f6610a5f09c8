"""Where a model fails: one channel in one motion and direction, in degrees, N·mm and noise units."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needle_rig.numerics import Array
from needle_rig.units import deg, nmm
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.observations.binning import direction_of
from needle_rig.workbench.observations.noise import variance
from needle_rig.workbench.selection.documents import PlaceError

WORST, WORST_OF_A_CHANNEL = 8, 2
"""Places that are reported, and those of one channel."""
NOISE_LIMIT = 3.0
"""Error in units of the noise above which a place is reported."""
FEWEST_DEPTHS = 3
"""Sensors from which a trend along the needle is reported."""
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
            "model": self.model,
            "measured": self.measured,
            "error": self.error,
            "noise": self.noise,
            "sigmas": self.sigmas,
            "unit": self.unit,
            "trial": self.trial,
            "words": self.words,
        }


def worst_places(places: Sequence[Place], names: tuple[str, ...]) -> tuple[Place, ...]:
    """Places above the limit, the worst first, in words: few of each channel."""
    worst = sorted((p for p in places if p.sigmas > NOISE_LIMIT), key=lambda p: -p.sigmas)
    shown: list[Place] = []
    for place in worst:
        if sum(p.channel == place.channel for p in shown) < WORST_OF_A_CHANNEL:
            shown.append(_in_words(place, places, names))
        if len(shown) == WORST:
            break
    return tuple(shown)


def scale_of(channel: int) -> tuple[float, str]:
    """Factor from SI to what people read, and its unit."""
    return (nmm(1.0), "N·mm") if channel == 0 else (deg(1.0), "°")


def motion_words(name: str) -> str:
    """A motion's name as people read it."""
    return name.replace("_", " ")


def all_places(
    problem: Problem, residuals: Sequence[Array], spreads: Sequence[Array], names: tuple[str, ...]
) -> list[Place]:
    """Every channel × motion × state × direction.

    `residuals` are data minus model (C, K) a trial; `spreads` (C, K, m) independent deviations of the
    prediction by one standard deviation each, which count as noise.
    """
    groups: dict[tuple[int, str, str, str], list[tuple[float, float, float, float, str]]] = {}
    for binned, whiten, left_over, spread in zip(
        problem.trials, problem.whiteners, residuals, spreads, strict=True
    ):
        variances = [variance(problem.noise, binned, c) for c in range(len(names))]
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
                    left = left_over[c][use]
                    modelled = measured - float(np.average(left, weights=weight))
                    rms = float(np.sqrt(np.average(left**2, weights=weight)))
                    if state == "settled":
                        rms = abs(measured - modelled)
                    moved = spread[c][use]
                    of_prediction = np.average(moved**2, axis=0, weights=weight)
                    if state == "settled":
                        of_prediction = np.average(moved, axis=0, weights=weight) ** 2
                    share = weight / weight.sum()
                    of_noise = float(share @ variances[c][use])
                    if state == "settled":
                        average = np.zeros((1, use.size))
                        average[0, use] = share
                        channel = whiten.channels[c]
                        of_noise = float((channel.of_averages(average[:, channel.use]) ** 2).sum())
                    deviation = float(np.sqrt(of_prediction.sum() + of_noise))
                    groups.setdefault((c, motion, state, way), []).append(
                        (measured, modelled, rms, deviation, binned.file)
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


def _in_words(place: Place, places: Sequence[Place], names: tuple[str, ...]) -> Place:
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
