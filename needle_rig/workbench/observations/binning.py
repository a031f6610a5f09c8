"""Trials cut into motions and bins, so that a thousand correlated samples become the few means that they are
worth.

A motion is a stretch with one phase name: the base moves, then holds. While it moves, bins are equally wide;
while it holds they widen with the time since it stopped. The model is driven on a grid of block centres, and
the same averages are taken of model and data.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array, diags_array

from needle_rig.dataset import DatasetTrial
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.units import rad
from needle_rig.workbench.observations.outliers import NEIGHBOURS, set_aside
from needle_rig.workbench.policy import POLICY

MOVING_BINS = 14
"""Bins of a motion while the base moves."""
MOVING_BLOCKS = 42
"""Points of the base's path in it that drive the model: three a bin."""
HOLD_EDGES_S = (0.0, 0.12, 0.4, 1.0, 2.5, 6.0, 15.0, 40.0, 120.0, 600.0)
"""Edges of bins after a stop: relaxation is even on the logarithm of time."""
HOLD_SAMPLES = 3
"""Samples that a bin of a hold has at least."""
END_SHARE, END_SAMPLES = 4, 50
"""A motion's goal is the median of its last quarter, or of this many samples if they are fewer."""
SAME_TIME_S = 1e-9
"""Points of the grid closer than this are one."""
LEAST_OF_A_BIN = 0.5
"""Share of a bin's samples below which they do not stand for those that are missing."""
BRIDGED = NEIGHBOURS // 2
"""Missing samples in a row that their neighbours stand for. Across a longer gap the base may begin to turn:
in the bins that it touches data and model are averaged at the samples that are there."""


@dataclass(frozen=True)
class BinnedTrial:
    """One trial in bins. K bins, m grid points, C channels (torque, then each Hall sensor)."""

    trial: Trial
    """The grid: times, base angles and torques on the tip (m,) that drive the model."""
    averages: tuple[csr_array, ...]
    """Weights (K, m), a channel each, that take the model on the grid to bin means: where
    a gap of the channel touches a bin, to the mean at the times of its samples."""
    mean: Array
    """Bin means (C, K) of the data; NaN where a channel has none. N·m and rad."""
    count: Array
    """Samples behind each mean (C, K)."""
    time_s: Array
    duration_s: Array
    motion: npt.NDArray[np.int64]
    moving: npt.NDArray[np.bool_]
    since_stop_s: Array
    base_rad: Array
    base_rate_rad_s: Array
    last_move_rad: Array
    """Signed size of the motion that a bin belongs to, or that came before it at rest."""
    motions: tuple[str, ...]
    command: object
    file: str
    outliers: tuple[int, ...]
    """Samples set aside as outliers, a channel each."""
    missing: tuple[int, ...]
    from_start: Array | None = None
    """What an unknown start changes of the bin means (C, K, D), each a standard deviation."""
    from_encoder: Array | None = None
    """Changes of the model's bin means (C, K, D) for D paths that differ by the encoder's noise, where that
    counts as noise."""

    def averaged(self, values: Array) -> Array:
        """Bin means (C, K) of values on the grid (C, m)."""
        first = self.averages[0]
        if all(average is first for average in self.averages):
            return np.ascontiguousarray((first @ values.T).T)
        return np.array([average @ each for average, each in zip(self.averages, values, strict=True)])

    def averaged_all(self, values: Array) -> Array:
        """The same (C, K, M) of M models on the grid (C, m, M)."""
        return np.array([average @ each for average, each in zip(self.averages, values, strict=True)])


def channels(trial: DatasetTrial) -> Array:
    """Torque and Hall angles as (C, M)."""
    return np.vstack([trial.torque_nm[None, :], trial.hall_rad.T])


def motions_of(base_rad: Array, phase: npt.NDArray[np.str_]) -> list[tuple[int, int, int]]:
    """(first, stop, end) sample of every motion; from `stop` on the base holds still.

    Strokes that follow one another without a hold are motions of their own.
    """
    change = np.flatnonzero(phase[1:] != phase[:-1]) + 1
    found = []
    for first, end in zip(np.r_[0, change], np.r_[change, phase.size], strict=True):
        path = base_rad[first:end]
        goal = np.median(path[-max(1, min(path.size // END_SHARE, END_SAMPLES)) :])
        away = np.flatnonzero(np.abs(path - goal) > rad(POLICY.noise.still_deg))
        stop = int(first + (away[-1] + 1 if away.size else 0))
        begun = int(first)
        for turn in _reversals(base_rad[first:stop]):
            found.append((begun, int(first) + turn, int(first) + turn))
            begun = int(first) + turn
        found.append((begun, stop, int(end)))
    return found


def _reversals(path_rad: Array) -> list[int]:
    """Samples of a path at which it turns back by more than the smallest motion."""
    if not path_rad.size:
        return []
    steps = np.diff(path_rad)
    moves = np.flatnonzero(steps)
    corners = moves[1:][np.diff(np.sign(steps[moves])) != 0]
    found: list[int] = []
    way, farthest = 0.0, 0
    for at in [*corners.tolist(), path_rad.size - 1]:
        on = float(path_rad[at] - path_rad[farthest])
        if way * on > 0.0:
            farthest = at
        elif abs(on) > POLICY.noise.smallest_motion_rad:
            if way:
                found.append(farthest)
            way, farthest = math.copysign(1.0, on), at
    return found


def direction_of(move_rad: Array) -> Array:
    """Sign of motions by this much, 0 for one that is too small to have a direction."""
    return np.asarray(np.sign(move_rad) * (np.abs(move_rad) > POLICY.noise.smallest_motion_rad))


def _blocks(time_s: Array, parts: list[tuple[int, int, int]]) -> tuple[list[int], list[int], list[int]]:
    """(first sample of each block, its bin, bin kinds) for all motions; bin kind -1 holds, else moving."""
    starts: list[int] = []
    bins: list[int] = []
    moving_bins: list[int] = []
    number = 0
    for first, stop, end in parts:
        if stop > first:
            blocks = min(MOVING_BLOCKS, stop - first)
            edges = np.unique(np.linspace(first, stop, blocks + 1).astype(int))[:-1]
            groups = min(MOVING_BINS, edges.size)
            group = (np.arange(edges.size) * groups) // edges.size
            starts += edges.tolist()
            bins += (number + group).tolist()
            moving_bins += [1] * groups
            number += groups
        if end > stop:
            since = time_s[stop:end] - time_s[stop]
            cut = stop + np.searchsorted(since, HOLD_EDGES_S)
            cut = np.unique(np.r_[cut[cut < end], end])
            widths = np.diff(cut)
            keep = [int(cut[0])]
            for edge, width in zip(cut[1:-1], widths[1:], strict=True):
                if width >= HOLD_SAMPLES and edge - keep[-1] >= HOLD_SAMPLES:
                    keep.append(int(edge))
            for a, b in zip(keep, [*keep[1:], int(end)], strict=True):
                middle = (a + b) // 2
                starts += [a, middle] if middle > a else [a]
                bins += [number] * (2 if middle > a else 1)
                moving_bins.append(0)
                number += 1
    return starts, bins, moving_bins


def bins_of_samples(given: DatasetTrial) -> npt.NDArray[np.int64]:
    """Bin of each sample of a trial, (M,)."""
    time_s = given.trial.time_s
    starts, bins, _ = _blocks(time_s, motions_of(given.trial.base_angle_rad, np.asarray(given.phase)))
    return np.repeat(bins, np.diff([*starts, time_s.size]))


def sample_weights(given: DatasetTrial) -> tuple[csr_array, ...]:
    """Weights (K, M), a channel each, that take values at a trial's samples to means in its bins."""
    of_sample = bins_of_samples(given)
    found: list[csr_array] = []
    known: list[npt.NDArray[np.bool_]] = []
    for values in channels(given):
        valid = set_aside(values)[1]
        same = next((k for k, other in enumerate(known) if np.array_equal(valid, other)), None)
        found.append(_weights(of_sample, valid) if same is None else found[same])
        known.append(valid)
    return tuple(found)


def _weights(of_sample: npt.NDArray[np.int64], valid: npt.NDArray[np.bool_]) -> csr_array:
    """Weights (K, M) of equal shares: of a bin's samples, or of the valid ones where a gap touches it."""
    used = np.flatnonzero(valid | ~_with_gap(of_sample, valid)[of_sample])
    bins = int(of_sample[-1]) + 1
    share = 1.0 / np.maximum(np.bincount(of_sample[used], minlength=bins), 1)
    return csr_array((share[of_sample[used]], (of_sample[used], used)), shape=(bins, of_sample.size))


def _with_gap(of_sample: npt.NDArray[np.int64], valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Which bins (K,) hold samples of a gap, or lack most of theirs."""
    edges = np.flatnonzero(np.diff(np.r_[True, valid, True]))
    begins, ends = edges[::2], edges[1::2]
    long = ends - begins > BRIDGED
    depth = np.zeros(valid.size + 1, int)
    np.add.at(depth, begins[long], 1)
    np.add.at(depth, ends[long], -1)
    gone = np.cumsum(depth[:-1]) > 0
    bins = int(of_sample[-1]) + 1
    most = np.bincount(of_sample, valid, bins) < LEAST_OF_A_BIN * np.bincount(of_sample, minlength=bins)
    return np.asarray(most | (np.bincount(of_sample, gone, bins) > 0))


def driven_by_samples(binned: BinnedTrial, given: DatasetTrial) -> BinnedTrial:
    """The same bins of a trial, with the model driven by every sample."""
    return dataclasses.replace(binned, trial=given.trial, averages=sample_weights(given))


def interpolation(grid: Array, at: Array) -> csr_array:
    """Weights (M, m) of linear interpolation from a rising grid (m,) to points (M,) within it."""
    after = np.clip(np.searchsorted(grid, at), 1, grid.size - 1)
    share = (at - grid[after - 1]) / (grid[after] - grid[after - 1])
    rows = np.arange(at.size)
    places = (np.r_[rows, rows], np.r_[after - 1, after])
    return csr_array((np.r_[1.0 - share, share], places), shape=(at.size, grid.size))


def bin_trial(given: DatasetTrial) -> BinnedTrial:
    """Bins of one trial."""
    base_rad = given.trial.base_angle_rad
    time_s = given.trial.time_s
    phase = np.asarray(given.phase)
    parts = motions_of(base_rad, phase)
    starts, bins, moving_bins = _blocks(time_s, parts)
    first = np.asarray(starts)
    of_bin = np.asarray(bins)
    size = np.diff(np.r_[first, time_s.size])
    number = len(moving_bins)

    def block_mean(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, first) / size, dtype=np.float64)

    def bin_sum(values: Array) -> Array:
        return np.asarray(np.bincount(of_bin, values, number), dtype=np.float64)

    block_time, block_base = block_mean(time_s), block_mean(base_rad)
    samples = bin_sum(size.astype(float))
    guards = np.unique([0, *[end - 1 for _, _, end in parts]])
    grid_time = np.r_[block_time, time_s[guards]]
    grid_base = np.r_[block_base, base_rad[guards]]
    tip_nm = given.trial.tip_torque_nm
    grid_tip = None if tip_nm is None else np.r_[block_mean(tip_nm), tip_nm[guards]]
    order = np.argsort(grid_time, kind="stable")
    distinct = np.r_[True, np.diff(grid_time[order]) > SAME_TIME_S]
    place = np.empty(order.size, int)
    place[order] = np.cumsum(distinct) - 1
    grid_time, grid_base = grid_time[order][distinct], grid_base[order][distinct]
    if grid_tip is not None:
        grid_tip = grid_tip[order][distinct]
    from_start = None
    if given.start_change is not None:
        from_start = np.array(
            [
                [bin_sum(block_mean(values) * size) / samples for values in change]
                for change in given.start_change
            ]
        ).transpose(1, 2, 0)
    of_sample = np.repeat(of_bin, size)
    places = (of_bin, place[: first.size])
    whole = csr_array((size / samples[of_bin], places), shape=(number, grid_time.size))
    outliers, missing, mean, count, averages = [], [], [], [], []
    for values in channels(given):
        filled, valid, outlier = set_aside(values)
        count.append(bin_sum(np.add.reduceat(valid.astype(float), first)))
        average = bin_sum(block_mean(filled) * size) / samples
        at_samples = whole
        if (with_gap := _with_gap(of_sample, valid)).any():
            own = _weights(of_sample, valid)
            average = np.where(count[-1] > 0, np.where(with_gap, own @ filled, average), np.nan)
            at_times = own @ interpolation(grid_time, time_s)
            rows = with_gap.astype(float)
            at_samples = csr_array(diags_array(rows) @ at_times + diags_array(1.0 - rows) @ whole)
        mean.append(average)
        averages.append(at_samples)
        outliers.append(int(outlier.sum()))
        missing.append(int((~np.isfinite(values)).sum()))

    motion = np.repeat(np.arange(len(parts)), [end - begin for begin, _, end in parts])[first]
    stop_time = np.array([time_s[min(stop, time_s.size - 1)] for _, stop, _ in parts])
    bin_motion = np.zeros(number, int)
    bin_motion[of_bin] = motion
    bin_time = bin_sum(block_time * size) / samples
    moves = np.array([base_rad[end - 1] - base_rad[begin] for begin, _, end in parts])
    base = bin_sum(block_base * size) / samples
    moving = np.asarray(moving_bins, bool)
    rate = np.zeros(number)
    edge_time, edge_base = time_s[first], base_rad[first]
    end_sample = np.r_[first[1:], time_s.size - 1]
    low = np.full(number, -1)
    for block, which in enumerate(of_bin):
        if low[which] < 0:
            low[which] = block
        high = end_sample[block]
        span = time_s[high] - edge_time[low[which]]
        rate[which] = (base_rad[high] - edge_base[low[which]]) / span if span > 0 else 0.0
    return BinnedTrial(
        trial=dataclasses.replace(
            given.trial, time_s=grid_time, base_angle_rad=grid_base, tip_torque_nm=grid_tip
        ),
        averages=tuple(averages),
        mean=np.asarray(mean),
        count=np.asarray(count),
        time_s=bin_time,
        duration_s=samples * np.median(np.diff(time_s)),
        motion=bin_motion,
        moving=moving,
        since_stop_s=np.where(moving, 0.0, bin_time - stop_time[bin_motion]),
        base_rad=base,
        base_rate_rad_s=np.where(moving, rate, 0.0),
        last_move_rad=moves[bin_motion],
        motions=tuple(str(phase[begin]) for begin, _, _ in parts),
        command=given.command,
        file=given.file,
        outliers=tuple(outliers),
        missing=tuple(missing),
        from_start=from_start,
    )
