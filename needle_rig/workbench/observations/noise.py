"""Noise measured on the data: white and correlated sensor noise, offsets and scatter from trial to trial.

Sensor noise comes from the settled ends of the motions, where nothing moves; where there are too few, from
what a smooth curve leaves of the samples within a stroke. What differs from trial to trial is read from the
rest before the first motion and from replicates of one command, so that a wrong model
does not pass for noise. A floor stands for the accuracy that the solver promises.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.optimize import nnls
from scipy.special import chdtri

from needle_rig.dataset import DatasetTrial
from needle_rig.dataset.samples import is_slow
from needle_rig.numerics import Array, lower_root
from needle_rig.units import nm, rad
from needle_rig.workbench.observations.binning import BinnedTrial, channels, motions_of
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
FEWEST_RESTS = 4
"""Rests from which a trend and a scatter about it can be told; with fewer offsets are the floor."""
REST_DEG = 1.0
"""Motion before a rest that leaves it one, and what the bases of replicates may differ by."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations, an entry a channel (torque N·m, then Hall rad) unless said."""

    white: Array
    correlated: Array
    correlation_s: Array
    offset: Array
    """From trial to trial, constant within a trial."""
    motion: Array
    """From motion to motion, constant within a motion: the floor or what replicates show beyond it."""
    jitter_s: float
    """Of the time between base and sensors, from trial to trial."""
    scatter: float
    """Prior relative scatter of friction from trial to trial."""
    scatter_dof: float
    replicates: int
    """Degrees of freedom among replicates; 0 when no command was repeated."""
    hum: Array
    """Of what oscillates at `hum_hz`, with a phase of its own in each trial."""
    hum_hz: float
    """As it is seen at the samples: of the mains, the beat with the sampling."""


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
    if gain < POLICY.noise.correlation_gain:
        white_var, slow_var = alone[0] * scale, 0.0
    return float(np.sqrt(max(white_var, 1e-6 * scale))), float(np.sqrt(slow_var)), tau


def replicate_groups(commands: Sequence[object]) -> list[list[int]]:
    """Trials of equal command, in order of first appearance."""
    groups: dict[object, list[int]] = {}
    for i, command in enumerate(commands):
        groups.setdefault(command, []).append(i)
    return list(groups.values())


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
    return Noise(
        white=parts[:, 0],
        correlated=parts[:, 1],
        correlation_s=parts[:, 2],
        offset=_rest_offsets(binned, parts, floor),
        motion=floor,
        jitter_s=POLICY.noise.clock_jitter_s,
        scatter=POLICY.noise.scatter,
        scatter_dof=POLICY.noise.scatter_dof,
        replicates=sum(len(g) - 1 for g in groups),
        hum=np.zeros(len(parts)),
        hum_hz=0.0,
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


def _rest_offsets(binned: Sequence[BinnedTrial], parts: Array, floor: Array) -> Array:
    """Scatter of the readings at rest before the first motion, a trend over the series taken out."""
    rests, variances, starts = [], [], []
    for b in binned:
        rest = (b.motion == 0) & ~b.moving & (np.abs(b.last_move_rad) < rad(REST_DEG))
        if rest.any() and np.all(np.isfinite(b.mean[:, rest])):
            weight = b.count[:, rest]
            total = weight.sum(1)
            rests.append((b.mean[:, rest] * weight).sum(1) / total)
            span = b.duration_s[rest].sum()
            slow = parts[:, 1] ** 2 / np.maximum(1.0, span / (2 * parts[:, 2]))
            variances.append(parts[:, 0] ** 2 / total + slow)
            starts.append(b.trial.start_s)
    least = POLICY.noise.offset_floor_share * floor
    if len(rests) < FEWEST_RESTS:
        return least
    t = np.asarray(starts)
    t = (t - t.mean()) / (np.ptp(t) or 1.0)
    columns = np.column_stack([np.ones(t.size), t]) if np.ptp(t) > 0 else np.ones((t.size, 1))
    values = np.asarray(rests)
    left = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
    dof = t.size - columns.shape[1]
    excess = (left**2).sum(0) / dof - np.mean(variances, 0)
    significant = excess > POLICY.noise.offset_sigmas * np.mean(variances, 0) * np.sqrt(2.0 / dof)
    return np.maximum(least, np.where(significant, np.sqrt(np.maximum(excess, 0)), 0.0))


def correlation(binned: BinnedTrial, use: Places, tau_s: float) -> Array:
    """Correlation (k, k) of means over the bins `use` of noise that is correlated as e^(-|t| / tau)."""
    time, width = binned.time_s[use], binned.duration_s[use]
    ratio = np.maximum(width / tau_s, 1e-6)
    gap = np.maximum(np.abs(np.subtract.outer(time, time)) - 0.5 * np.add.outer(width, width), 0.0)
    edge = (1 - np.exp(-ratio)) / ratio
    matrix = np.exp(-gap / tau_s) * np.outer(edge, edge)
    matrix[np.diag_indices(use.size)] = 2 * (ratio - 1 + np.exp(-ratio)) / ratio**2
    return matrix


def oscillation(binned: BinnedTrial, use: Places, hz: Array) -> Array:
    """(k, 2, F): means over the bins `use` of the cosine and the sine at the frequencies `hz` (F,)."""
    phase = 2 * np.pi * np.multiply.outer(binned.time_s[use], hz)
    averaged = np.sinc(np.multiply.outer(binned.duration_s[use], hz))
    return np.stack([averaged * np.cos(phase), averaged * np.sin(phase)], axis=1)


def covariance(noise: Noise, binned: BinnedTrial, channel: int) -> tuple[Places, Array]:
    """(bins in use (k,), covariance (k, k)) of one channel's bin means."""
    use = np.flatnonzero(np.isfinite(binned.mean[channel]))
    time = binned.time_s[use]
    matrix = noise.correlated[channel] ** 2 * correlation(binned, use, noise.correlation_s[channel])
    matrix[np.diag_indices(use.size)] += noise.white[channel] ** 2 / binned.count[channel, use]
    matrix += noise.offset[channel] ** 2
    if noise.hum[channel]:
        wave = oscillation(binned, use, np.array([noise.hum_hz]))[:, :, 0]
        matrix += noise.hum[channel] ** 2 * wave @ wave.T
    motion = binned.motion[use]
    matrix += noise.motion[channel] ** 2 * (motion[:, None] == motion[None, :])
    rate = np.zeros(use.size)
    for m in np.unique(motion):
        inside = np.flatnonzero((motion == m) & binned.moving[use])
        if inside.size > 1:
            rate[inside] = np.gradient(binned.mean[channel, use][inside], time[inside])
    late = noise.jitter_s * rate
    matrix += np.outer(late, late) + np.diag((0.5 * late) ** 2)
    if binned.from_start is not None:
        moved = binned.from_start[channel, use]
        matrix += moved @ moved.T
    if binned.from_encoder is not None:
        moved = binned.from_encoder[channel, use]
        matrix += moved @ moved.T / moved.shape[1]
    return use, matrix


@dataclass(frozen=True)
class Whitener:
    """Turns the bin means of one trial into independent values of unit variance."""

    use: tuple[Places, ...]
    inverse: tuple[Array, ...]
    log_det: float

    def __call__(self, means: Array) -> Array:
        """(C, K, …) bin means to (n, …) whitened values, channel after channel."""
        return np.concatenate(
            [w @ means[c][u] for c, (u, w) in enumerate(zip(self.use, self.inverse, strict=True))]
        )

    def raw(self, values: Array) -> Array:
        """Bin means (C, K, …) that whiten to `values` (n, …); NaN where a channel has none."""
        bins = 1 + max((int(u.max()) for u in self.use if u.size), default=-1)
        means = np.full((len(self.use), bins, *values.shape[1:]), np.nan)
        for c, (use, inverse) in enumerate(zip(self.use, self.inverse, strict=True)):
            means[c, use] = solve_triangular(inverse, values[self.channel == c], lower=True)
        return means

    @property
    def channel(self) -> npt.NDArray[np.int64]:
        """Channel of each whitened value (n,)."""
        return np.concatenate([np.full(u.size, c) for c, u in enumerate(self.use)])


def whitener(noise: Noise, binned: BinnedTrial) -> Whitener:
    """The whitener of one trial under `noise`."""
    use: list[Places] = []
    inverse: list[Array] = []
    log_det = 0.0
    for c in range(binned.mean.shape[0]):
        bins, matrix = covariance(noise, binned, c)
        use.append(bins)
        lower = lower_root(matrix) if bins.size else np.zeros((0, 0))
        inverted = solve_triangular(lower, np.eye(bins.size), lower=True) if bins.size else lower
        inverse.append(np.asarray(inverted, dtype=np.float64))
        log_det += 2 * float(np.log(np.diag(lower)).sum())
    return Whitener(tuple(use), tuple(inverse), log_det)
