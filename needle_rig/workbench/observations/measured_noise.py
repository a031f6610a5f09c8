"""Noise measured on the data, before any model is held against them.

White noise and drift come from the settled ends of the motions, where nothing moves; where there are too few,
from what a smooth curve leaves of the samples within a stroke. What differs from trial to trial is read from
the rest before the first motion and from replicates of one command, so that a wrong model does not pass for
noise. A floor stands for the accuracy that the solver promises.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls
from scipy.special import chdtri

from needle_rig.dataset import DatasetTrial
from needle_rig.dataset.samples import is_slow
from needle_rig.numerics import Array
from needle_rig.units import nm, rad
from needle_rig.workbench.observations.binning import BinnedTrial, channels, motions_of
from needle_rig.workbench.observations.noise import Noise, replicate_groups
from needle_rig.workbench.observations.noise_terms.drift import Drift
from needle_rig.workbench.observations.noise_terms.encoder import Encoder
from needle_rig.workbench.observations.noise_terms.initial_twist import InitialTwist
from needle_rig.workbench.observations.noise_terms.jitter import Jitter
from needle_rig.workbench.observations.noise_terms.motion_scatter import MotionScatter
from needle_rig.workbench.observations.noise_terms.offset import measured_offset
from needle_rig.workbench.observations.noise_terms.white import White
from needle_rig.workbench.observations.outliers import set_aside
from needle_rig.workbench.policy import POLICY

Places = npt.NDArray[np.int64]

CORRELATION_TIMES_S = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
SETTLED_FROM = 0.4
"""Share of a hold after which it counts as settled."""
WINDOW, SHORTEST_WINDOW = 160, 16
"""Values of a settled stretch whose autocovariance is taken,"""
WINDOW_SPACING_S = 0.02
"""which are means over this long where samples come faster: of noise that is correlated over less only the
mean of a bin is known, and windows of single samples would be too short for what wanders."""
SMOOTH_WINDOW, SMOOTH_DEGREE = 16, 3
"""Values in a window of a stroke, and degree of the curve that is taken out of it: of a sine of 0.3 Hz and
40° at 50 Hz that leaves 0.002°."""
ROUGH_CHANCE = 0.01
"""Of a window that holds noise alone to have so much of it; one that has more holds a corner: where a base
turns or a slip front comes to a sensor, no curve is smooth."""
MOST_LAGS = 25
"""Lags of the autocovariance."""
VALID_SHARE = 0.9
"""Of a window's samples: gaps filled in from neighbours would pass for correlation."""
REST_DEG = 1.0
"""That the bases of replicates may differ by."""


@dataclass(frozen=True)
class _Settled:
    """Settled stretches of one channel: means over `count` samples each, `spacing_s` apart."""

    pieces: list[Array]
    spacing_s: float
    count: int


def _settled(trials: Sequence[DatasetTrial]) -> list[_Settled]:
    """Of every channel, at its own samples: those of a slow one lie between the rows of a fast one."""
    return [_in_windows(own, [_holds(given) for given in trials], WINDOW) for own in _every_channel(trials)]


def _every_channel(trials: Sequence[DatasetTrial]) -> list[tuple[_Samples, ...]]:
    """Its samples in each trial, of every channel."""
    each = [[_own_samples(given, values) for values in channels(given)] for given in trials]
    return list(zip(*each, strict=True))


def _in_windows(
    of_channel: Sequence[_Samples], stretches: Sequence[Sequence[tuple[int, int]]], window: int
) -> _Settled:
    """Windows of stretches of each trial, first and end row, in means over 20 ms where those are enough."""
    gaps = [float(np.median(np.diff(own.time_s))) for own in of_channel if own.time_s.size > 1]
    spacing_s = float(np.median(gaps)) if gaps else 1.0
    fast = max(1, round(WINDOW_SPACING_S / spacing_s))
    pieces: list[Array] = []
    for count in sorted({fast, 1}, reverse=True):
        pieces = [
            piece
            for own, of_trial in zip(of_channel, stretches, strict=True)
            for piece in _windows(own, of_trial, count, window)
        ]
        if pieces:
            break
    return _Settled(pieces, count * spacing_s, count)


@dataclass(frozen=True)
class _Samples:
    """One channel of one trial where it was read: times and values (n,), gaps filled, and which are valid."""

    time_s: Array
    filled: Array
    valid: npt.NDArray[np.bool_]
    row: Places
    """Of the trial, of each sample."""

    def between(self, rows: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """First and end sample of stretches that are given by their rows."""
        return [(int(np.searchsorted(self.row, at)), int(np.searchsorted(self.row, end))) for at, end in rows]


def _own_samples(given: DatasetTrial, values: Array) -> _Samples:
    time_s, read = given.trial.time_s, np.isfinite(values)
    rows = np.flatnonzero(read) if is_slow(read) else np.arange(values.size)
    filled, valid, _ = set_aside(values[rows])
    return _Samples(time_s[rows], filled, valid, rows)


def _holds(given: DatasetTrial) -> list[tuple[int, int]]:
    """First and end row of what is settled of each hold of the base."""
    base_rad, found = given.trial.base_angle_rad, []
    for _, stop, end in motions_of(base_rad, np.asarray(given.phase)):
        begin = stop + int(SETTLED_FROM * (end - stop))
        crept_rad = float(np.ptp(base_rad[begin:end])) if end > begin else 0.0
        if crept_rad <= rad(POLICY.noise.floor_deg):  # a base that turns back slowly does not hold
            found.append((begin, end))
    return found


def _windows(
    own: _Samples, stretches: Sequence[tuple[int, int]], count: int, window: int = WINDOW
) -> list[Array]:
    """Windows of stretches of a trial, first and end row of each, in means over `count` samples."""
    found = []
    for begin, end in own.between(stretches):
        for at in range(begin, end - count * SHORTEST_WINDOW + 1, count * window):
            means = min(end - at, count * window) // count
            until = at + means * count
            if own.valid[at:until].mean() > VALID_SHARE:
                found.append(own.filled[at:until].reshape(means, count).mean(1))
    return found


def _within_strokes(trials: Sequence[DatasetTrial]) -> list[_Settled]:
    """Of every channel, windows at its own samples, none across a turn of the base, but those with corners.

    What a cubic leaves of a window is noise where the readings are smooth, as with differences of a higher
    order (Gasser, Sroka, Jennen-Steinmetz, Biometrika 73, 1986).
    """
    strokes = [
        [
            stretch
            for first, stop, end in motions_of(given.trial.base_angle_rad, np.asarray(given.phase))
            for stretch in ((first, stop), (stop, end))
        ]
        for given in trials
    ]
    every = [_in_windows(own, strokes, SMOOTH_WINDOW) for own in _every_channel(trials)]
    return [dataclasses.replace(each, pieces=_without_corners(each.pieces)) for each in every]


def _without_corners(pieces: list[Array]) -> list[Array]:
    """Windows of which a curve leaves no more than chance does, told by the median over all."""
    if not pieces:
        return []
    left = np.array(pieces) @ _off_curve(SMOOTH_WINDOW, SMOOTH_DEGREE)
    dof = SMOOTH_WINDOW - SMOOTH_DEGREE - 1
    squares = (left**2).sum(1)
    usual = float(np.median(squares)) / float(chdtri(dof, 0.5))
    return [p for p, s in zip(pieces, squares, strict=True) if s <= usual * float(chdtri(dof, ROUGH_CHANCE))]


def _off_curve(n: int, degree: int) -> Array:
    """Projection (n, n) off polynomials of a degree."""
    basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, n), degree + 1, increasing=True))
    return np.asarray(np.eye(n) - basis @ basis.T)


def _split(pieces: list[Array], spacing_s: float, degree: int = 1) -> tuple[float, float, float]:
    """(white, correlated, correlation time): the two parts whose autocovariance the pieces show.

    Expected autocovariances are those of windows off a polynomial of `degree`, so that short windows bias
    nothing.
    """
    if not pieces:
        return 0.0, 0.0, CORRELATION_TIMES_S[0]
    n = int(np.median([p.size for p in pieces]))
    out = _off_curve(n, degree)
    cut = np.array([p[i : i + n] for p in pieces for i in range(0, p.size - n + 1, n)]) @ out
    lags = min(MOST_LAGS, n // 2)
    seen = np.array([(cut[:, : n - k] * cut[:, k:]).sum() / (cut.shape[0] * (n - k)) for k in range(lags)])

    def expected(covariance: Array) -> Array:
        left = out @ covariance @ out
        return np.array([np.trace(left, k) / (n - k) for k in range(lags)])

    distance = np.abs(np.subtract.outer(np.arange(n), np.arange(n))) * spacing_s
    white = expected(np.eye(n))
    scale = max(seen[0], 1e-30)
    alone, misfit_alone = nnls(white[:, None], seen / scale)
    best = (misfit_alone, alone[0] * scale, 0.0, CORRELATION_TIMES_S[0])
    for tau in CORRELATION_TIMES_S:
        if tau > n * spacing_s / 2:
            continue
        columns = np.column_stack([white, expected(np.exp(-distance / tau))])
        parts, misfit = nnls(columns, seen / scale)
        if misfit < best[0]:
            best = (misfit, parts[0] * scale, parts[1] * scale, tau)
    misfit, white_var, slow_var, tau = best
    gain = (misfit_alone**2 - misfit**2) * cut.size
    if gain < POLICY.evidence.clear_sigmas**2:
        white_var, slow_var = alone[0] * scale, 0.0
    return float(np.sqrt(max(white_var, 1e-6 * scale))), float(np.sqrt(slow_var)), tau


def floors(count: int, torque_scale: float = 1.0) -> Array:
    """The solver's accuracy a channel, shape (count,)."""
    policy = POLICY.noise
    return np.concatenate([[torque_scale * nm(policy.floor_nmm)], np.full(count - 1, rad(policy.floor_deg))])


def measure_noise(
    trials: Sequence[DatasetTrial], binned: Sequence[BinnedTrial], torque_scale: float = 1.0
) -> Noise:
    """Noise of a dataset, before any model is held against it."""
    holds_show = _held_share(trials) >= POLICY.noise.held_share
    settled = _settled(trials)
    parts = _parts(settled)
    floor = floors(parts.shape[0], torque_scale)
    silent = parts[:, 0] <= 0
    parts[silent, 0] = 10 * floor[silent]
    groups = replicate_groups([t.command for t in trials])
    if not holds_show:
        for c, of_strokes in enumerate(_parts(_within_strokes(trials), SMOOTH_DEGREE)):
            white = _white_of_replicates(binned, groups, c)
            if of_strokes[0] > 0.0:
                parts[c] = of_strokes
            elif white > 0.0:
                parts[c] = max(white, floor[c]), 0.0, CORRELATION_TIMES_S[0]
    within = White(parts[:, 0]), Drift(parts[:, 1], parts[:, 2])
    return Noise(
        (
            *within,
            measured_offset(binned, within, POLICY.noise.offset_floor_share * floor),
            MotionScatter(floor),
            Jitter(POLICY.noise.clock_jitter_s),
            InitialTwist(),
            Encoder(),
        ),
        scatter=POLICY.noise.scatter,
        scatter_dof=POLICY.noise.scatter_dof,
        replicates=sum(len(g) - 1 for g in groups),
    )


def _parts(every: Sequence[_Settled], degree: int = 1) -> Array:
    """(white part of a sample, correlated part, correlation time) of each channel, (C, 3)."""
    parts = np.array([_split(each.pieces, each.spacing_s, degree) for each in every])
    parts[:, 0] *= np.sqrt([each.count for each in every])
    return parts


def _held_share(trials: Sequence[DatasetTrial]) -> float:
    """Share of the time from the first to the last reading of each trial in which the base had settled."""
    held_s = seen_s = 0.0
    for given in trials:
        time_s = given.trial.time_s
        seen = np.flatnonzero(np.isfinite(channels(given)).any(axis=0))
        if seen.size:
            seen_s += float(time_s[seen[-1]] - time_s[seen[0]])
            holds = [(begin, end) for begin, end in _holds(given) if end > begin >= seen[0]]
            held_s += float(sum(time_s[end - 1] - time_s[begin] for begin, end in holds))
    return held_s / seen_s if seen_s > 0.0 else 0.0


def _white_of_replicates(binned: Sequence[BinnedTrial], groups: list[list[int]], channel: int) -> float:
    """Standard deviation of a sample that the scatter between bin means of replicates has; 0 without them.

    Of angles it is that of the lag behind the base, whose own bins differ by a sample. By medians: where the
    base turns back, an instant of difference makes another reading. Bins in which the bases are farther
    apart than that show no noise.
    """
    found: list[float] = []
    for group in groups:
        shared = min((binned[i].mean.shape[1] for i in group), default=0)
        if len(group) == 1:
            continue
        bases = np.array([binned[i].base_rad[:shared] for i in group])
        lead = bases if channel else np.zeros(bases.shape)
        means = np.array(
            [binned[i].mean[channel, :shared] - base for i, base in zip(group, lead, strict=True)]
        )
        counts = np.array([binned[i].count[channel, :shared] for i in group])
        variance = means.var(axis=0, ddof=1) * counts.mean(axis=0)
        known = variance[np.isfinite(variance) & (np.ptp(bases, axis=0) < rad(REST_DEG))]
        found += (known / float(chdtri(len(group) - 1, 0.5) / (len(group) - 1))).tolist()
    return float(np.sqrt(np.median(found))) if found else 0.0
