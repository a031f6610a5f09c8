r"""Datasets of a needle whose friction is not ours: Dahl's, LuGre's and Maxwell-slip (Iwan's) bristles.

It shares no code with the solver. The rod has one node in each cell of a mesh that is graded towards the
ends of every tissue section. Without inertia each sample is a balance of the springs between nodes and of the
torque T of the tissue on each, found by Newton's method. With x the turn of a node since the sample before, z
the deflection of its bristles, d the deflection at which they break away and υℓ the friction of the cell:

    Dahl     T = υℓ z/d,  dz/dx = 1 − sign(x) z/d       (Dahl, AIAA J. 14, 1976, with exponent 1)
    LuGre    T = υℓ (z/d + ż/ω_d) + b′ℓ ω,  ż = ω − |ω| z/g(ω),  g = d (1 + e exp(−(ω/ω_s)²))
             (Canudas de Wit, Olsson, Åström, Lischinsky, IEEE Trans. Automatic Control 40, 1995)
    Iwan     T = Σ_j (υℓ/N) clip(z_j/d_j, ±1),  d_j = d j/N    (Iwan, J. Applied Mechanics 33, 1966)

A bristle is followed exactly over a turn at one rate: z → s g + (z − s g) exp(−|x|/g), s = sign(x). Dahl's
and Iwan's torques depend on no rate, so that the step has no error while the base goes one way within it;
that of LuGre's falls with the step.
"""

from __future__ import annotations

import dataclasses
import enum
import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from needle_rig.dataset import Dataset, DatasetTrial, Needle, TrialCommand, denoised_base
from needle_rig.physics.effect import Trial
from needle_rig.physics.rod import Layout
from needle_rig.units import nm, rad

Array = npt.NDArray[np.float64]
Random = np.random.Generator

LAYOUT = Layout(
    0.397, ((0.175, 0.2), (0.24, 0.265), (0.305, 0.33), (0.37, 0.395)), (0.22, 0.285, 0.35, 0.397)
)
"""The experiment's: sections of tissue and sensors."""
RIGIDITY_NM2 = 62.56e-6
FRICTION_N = 0.0996e-2
DIAMETER_M, DENSITY_KG_M3 = 0.39e-3, 6450.0
CELLS = 16
"""Cells of a section."""
ELEMENTS = 8
"""Elasto-slide elements of a node of Iwan's."""
LUGRE_STEPS = 8
"""Steps of a sample, as its torque depends on the rate."""
SOLVED = 1e-9
"""Torque out of balance at which a sample is solved, as a share of all friction."""
RATE_HZ = 50.0
REST_S = 0.5
"""Rest before the first motion."""
PAUSE_S = 30.0


class Law(enum.StrEnum):
    """Whose friction it is."""

    DAHL = "Dahl"
    LUGRE = "LuGre"
    IWAN = "Iwan"


@dataclass(frozen=True)
class Bristles:
    """Friction of the tissue per length; only LuGre's has the last four."""

    law: Law
    deflection_rad: float
    """d: of the last element at which it breaks away."""
    friction_n: float = FRICTION_N
    damping_rate_rad_s: float = 4.0
    """ω_d: at which the damping of bristles is as large as their friction."""
    static_excess: float = 0.0
    """e: static over kinetic friction, minus 1. Where the torque falls with the rate, the needle snaps:
    without inertia that has no answer but that of cells and steps."""
    stribeck_rate_rad_s: float = 0.2
    viscous_ns: float = 0.0


@dataclass(frozen=True, eq=False)
class Response:
    """What the needle did, SI: torque of the base (samples,), angles of the sensors (samples, sensors)."""

    torque_nm: Array
    hall_rad: Array
    stored_j: Array
    """Energy in the wire and in the bristles (samples,)."""


def mesh(layout: Layout, cells: int) -> tuple[Array, Array]:
    """Places (nodes,) and lengths of tissue (nodes,), m: `cells` a section, short at its ends."""
    share = (1.0 - np.cos(np.pi * np.arange(cells + 1) / cells)) / 2.0
    places, lengths = [], []
    for start, end in layout.tissue_sections_m:
        edges = start + (end - start) * share
        places.append((edges[1:] + edges[:-1]) / 2.0)
        lengths.append(np.diff(edges))
    return np.concatenate(places), np.concatenate(lengths)


def respond(
    bristles: Bristles,
    time_s: Array,
    base_rad: Array,
    *,
    layout: Layout = LAYOUT,
    rigidity_nm2: float = RIGIDITY_NM2,
    tip_nm: float = 0.0,
    cells: int = CELLS,
    steps: int | None = None,
) -> Response:
    """The needle, relaxed at first, whose base goes along straight lines through the samples.

    `tip_nm` is friction at the tip alone, by the same law. Each sample is divided into `steps`; as it is,
    into one, with LuGre's friction into `LUGRE_STEPS`.
    Raises AssertionError where a sample cannot be solved.
    """
    if steps is None:
        steps = LUGRE_STEPS if bristles.law is Law.LUGRE else 1
    places, lengths = mesh(layout, cells)
    limits_nm = bristles.friction_n * lengths
    viscous = bristles.viscous_ns * lengths
    if tip_nm > 0.0:
        places = np.append(places, layout.needle_length_m)
        limits_nm, viscous = np.append(limits_nm, tip_nm), np.append(viscous, 0.0)
    parts = ELEMENTS if bristles.law is Law.IWAN else 1
    at = np.arange((time_s.size - 1) * steps + 1) / steps
    fine_s, fine_rad = (np.interp(at, np.arange(time_s.size), values) for values in (time_s, base_rad))
    angles, stored_j, left = _follow(
        rigidity_nm2 / np.diff(np.append(0.0, places)),
        np.outer(limits_nm / parts, np.ones(parts)),
        bristles.deflection_rad * np.arange(1, parts + 1) / parts,
        bristles.law is Law.IWAN,
        (
            1.0 / bristles.damping_rate_rad_s if bristles.law is Law.LUGRE else 0.0,
            bristles.static_excess if bristles.law is Law.LUGRE else 0.0,
            bristles.stribeck_rate_rad_s,
        ),
        viscous if bristles.law is Law.LUGRE else np.zeros_like(viscous),
        fine_s,
        fine_rad,
        SOLVED * float(limits_nm.sum()),
    )
    assert left.max() <= SOLVED * limits_nm.sum(), f"out of balance by {left.max():.1e} N·m"
    angles, stored_j = angles[::steps], stored_j[::steps]
    torque_nm = rigidity_nm2 / places[0] * (base_rad - angles[:, 0])
    known, whole = np.append(0.0, places), np.column_stack([base_rad, angles])
    hall = np.array([np.interp(layout.sensor_positions_m, known, row) for row in whole])
    return Response(torque_nm, hall, stored_j)


@njit(cache=True, nogil=True, error_model="numpy")
def _bristle(x, dt, z, limit, d, slides, law):  # type: ignore[no-untyped-def]
    """(torque, its slope by x, deflection after) of one element that was turned by x."""
    damping, excess, rate = law
    if slides:  # Iwan's: elastic up to d, then it slides
        after = min(max(z + x, -d), d)
        return limit / d * after, limit / d * (abs(z + x) < d), after
    level = d * (1.0 + excess * np.exp(-((x / (dt * rate)) ** 2)))
    side = 1.0 if x >= 0.0 else -1.0
    left = np.exp(-abs(x) / level)
    after = side * level + (z - side * level) * left
    slope = (1.0 - side * z / level) * left
    if excess > 0.0:  # the level, too, moves with the rate
        level_by_x = -2.0 * x / (dt * rate) ** 2 * (level - d)
        slope += level_by_x * (side - side * left + (z - side * level) * left * abs(x) / level**2)
    torque = limit * (after / d + damping * (after - z) / dt)
    return torque, limit * slope * (1.0 / d + damping / dt), after


@njit(cache=True, nogil=True, error_model="numpy")
def _follow(  # type: ignore[no-untyped-def]
    springs, limits, deflections, slides, law, viscous, times, base, solved
):
    """Angles (samples, nodes), stored energy (samples,), torque out of balance (samples,)."""
    n, parts = limits.shape
    angles = np.zeros((times.size, n))
    stored, unsolved = np.zeros(times.size), np.zeros(times.size)
    z, after = np.zeros((n, parts)), np.zeros((n, parts))
    now, tried, step = np.zeros(n), np.zeros(n), np.zeros(n)
    out, slope, upper, right = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    for row in range(1, times.size):
        before = angles[row - 1]
        dt = times[row] - times[row - 1]
        now[:] = before
        share, missed, along = 1.0, np.inf, 0.0
        step[:] = 0.0
        for _ in range(1000):
            tried[:] = now + share * step
            # what is out of balance on each node
            for i in range(n):
                toward = base[row] if i == 0 else tried[i - 1]
                out[i] = springs[i] * (toward - tried[i])
                slope[i] = springs[i]
                if i < n - 1:
                    out[i] -= springs[i + 1] * (tried[i] - tried[i + 1])
                    slope[i] += springs[i + 1]
                x = tried[i] - before[i]
                for j in range(parts):
                    torque, steep, end = _bristle(x, dt, z[i, j], limits[i, j], deflections[j], slides, law)
                    out[i] -= torque
                    slope[i] += max(steep, 0.0)
                    after[i, j] = end
                out[i] -= viscous[i] * x / dt
                slope[i] += viscous[i] / dt
            worst = np.abs(out).max()
            # balance is the minimum of a convex energy (but where friction falls): a step that goes far
            # beyond the minimum along it is halved
            if worst > solved and (out * step).sum() < -0.5 * along and share > 1e-6:
                share *= 0.5
                continue
            now[:] = tried
            missed, share = worst, 1.0
            if worst <= solved:
                break
            for i in range(n):
                pivot = slope[i] - (springs[i] * upper[i - 1] if i > 0 else 0.0)
                upper[i] = springs[i + 1] / pivot if i < n - 1 else 0.0
                right[i] = (out[i] + (springs[i] * right[i - 1] if i > 0 else 0.0)) / pivot
            step[n - 1] = right[n - 1]
            for i in range(n - 2, -1, -1):
                step[i] = right[i] + upper[i] * step[i + 1]
            along = (out * step).sum()
        angles[row] = now
        unsolved[row] = missed
        z[:] = after
        for i in range(n):
            toward = base[row] if i == 0 else now[i - 1]
            stored[row] += 0.5 * springs[i] * (toward - now[i]) ** 2
            for j in range(parts):
                stored[row] += 0.5 * limits[i, j] / deflections[j] * z[i, j] ** 2
    return angles, stored, unsolved


@dataclass(frozen=True, eq=False)
class Path:
    """What the base is told: times, angles and the names of motions (samples,), and the command."""

    time_s: Array
    base_rad: Array
    phase: npt.NDArray[np.str_]
    command: TrialCommand


def chirp(random: Random) -> Path:
    """A sine whose frequency rises, without a hold."""
    size_deg, low_hz, high_hz = random.uniform(30.0, 60.0), random.uniform(0.04, 0.08), 0.3
    time_s = np.arange(round(24.0 * RATE_HZ)) / RATE_HZ
    since = np.maximum(time_s - REST_S, 0.0)
    sweep = low_hz * since + (high_hz - low_hz) * since**2 / (2.0 * time_s[-1])
    told = (("size_deg", f"{size_deg:.3f}"), ("from_hz", f"{low_hz:.4f}"))
    phase = np.where(time_s < REST_S, "rest", "sweep")
    return Path(time_s, rad(size_deg) * np.sin(2.0 * np.pi * sweep), phase, TrialCommand("chirp", other=told))


def random_steps(random: Random) -> Path:
    """Steps to anywhere, each held for half a second to two."""
    goals_deg = np.round(random.uniform(-70.0, 70.0, 9), 1)
    return _corners(
        "random steps", goals_deg, random.uniform(30.0, 60.0), random.uniform(0.5, 2.0, goals_deg.size)
    )


def slow_ramps(random: Random) -> Path:
    """There and back and beyond at 5 to 8 degrees a second, without a hold."""
    far_deg = round(float(random.uniform(35.0, 60.0)), 1)
    return _corners("slow ramps", np.array([far_deg, -0.6 * far_deg, 0.0]), random.uniform(5.0, 8.0))


def to_and_fro(random: Random) -> Path:
    """Strokes that turn back before they come to rest, each shorter than the one before."""
    far_deg, shrink = random.uniform(50.0, 70.0), random.uniform(0.8, 0.9)
    strokes = far_deg * (-shrink) ** np.arange(12)
    return _corners("to and fro", np.round(np.append(strokes, 0.0), 1), random.uniform(30.0, 60.0))


MOTIONS: dict[str, Callable[[Random], Path]] = {
    "chirp": chirp,
    "random steps": random_steps,
    "slow ramps": slow_ramps,
    "to and fro": to_and_fro,
}


def _corners(kind: str, goals_deg: Array, speed_deg_s: float, holds_s: Array | None = None) -> Path:
    """Straight strokes to each goal; without `holds_s` all are one motion."""
    times, angles, begins = [0.0, REST_S], [0.0, 0.0], [REST_S]
    for goal, hold_s in zip(
        goals_deg.tolist(), (0.0 * goals_deg if holds_s is None else holds_s), strict=True
    ):
        times.append(times[-1] + abs(goal - angles[-1]) / speed_deg_s)
        angles.append(goal)
        if hold_s > 0.0:
            times.append(times[-1] + float(hold_s))
            angles.append(goal)
            begins.append(times[-1])
    time_s = np.arange(int(times[-1] * RATE_HZ) + 1) / RATE_HZ
    base_rad = rad(np.interp(time_s, times, angles))
    number = np.searchsorted(
        begins[: len(goals_deg)] if holds_s is not None else begins, time_s, side="right"
    )
    phase = np.where(number == 0, "rest", np.char.add("move_", number.astype(str)))
    command = TrialCommand(kind, None, round(float(speed_deg_s), 2), None, tuple(goals_deg.tolist()))
    return Path(time_s, base_rad, phase, command)


@dataclass(frozen=True)
class Measured:
    """How a series is measured: standard deviations of white noise, and of friction from trial to trial."""

    hall_deg: float = 0.25
    torque_nmm: float = 0.0008
    encoder_deg: float = 0.02
    friction_scatter: float = 0.02
    commands: int = 4
    replicates: int = 3
    """Trials of the first command, which come first, in the middle and last."""


@dataclass(frozen=True)
class Hidden:
    """What else the rig has; as it is here, nothing."""

    torque_gain: float = 1.0
    hall_offset_deg: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    chuck_backlash_deg: float = 0.0
    tip_friction_nmm: float = 0.0


NOTHING = Hidden()

Needle_ = Callable[[Array, Array, float, float], tuple[Array, Array]]
"""(torque, Hall angles) of times, held angles, friction over the usual one, friction of the tip: SI, rad."""


def of(bristles: Bristles) -> Needle_:
    """A needle with such friction."""

    def needle(time_s: Array, held_rad: Array, factor: float, tip_nm: float) -> tuple[Array, Array]:
        own = dataclasses.replace(bristles, friction_n=factor * bristles.friction_n)
        found = respond(own, time_s, held_rad, tip_nm=tip_nm)
        return found.torque_nm, found.hall_rad

    return needle


def dataset(
    needle: Needle_, motion: str, seed: int, hidden: Hidden = NOTHING, measured: Measured = Measured()
) -> Dataset:
    """A series of trials of one kind of motion; equal seeds give equal numbers."""
    random = np.random.default_rng([seed, 5])
    paths = [MOTIONS[motion](random) for _ in range(measured.commands)]
    order = [0, *range(1, len(paths))]
    for k in range(1, measured.replicates):
        order.insert(len(order) if k % 2 else len(order) // 2, 0)
    trials, start_s, travel_rad = [], 0.0, 0.0
    for index, which in enumerate(order):
        path = paths[which]
        own = np.random.default_rng([seed, 6, index])
        factor = max(0.05, 1.0 + measured.friction_scatter * float(own.standard_normal()))
        held_rad = _within_play(path.base_rad, rad(hidden.chuck_backlash_deg))
        torque_nm, hall_rad = needle(path.time_s, held_rad, factor, nm(hidden.tip_friction_nmm))
        encoder = path.base_rad + rad(measured.encoder_deg) * own.standard_normal(path.base_rad.size)
        known = denoised_base(path.time_s, encoder)
        trials.append(
            DatasetTrial(
                trial=Trial(path.time_s, known.angle_rad, start_s, index, travel_rad),
                base_measured_rad=encoder,
                base_residual_rad=known.residual_rad,
                torque_nm=hidden.torque_gain * torque_nm
                + nm(measured.torque_nmm) * own.standard_normal(torque_nm.shape),
                hall_rad=hall_rad
                + rad(np.array(hidden.hall_offset_deg))
                + rad(measured.hall_deg) * own.standard_normal(hall_rad.shape),
                phase=path.phase,
                command=path.command,
                file=f"trials/{index + 1:02d}.csv",
            )
        )
        travel_rad += float(np.abs(np.diff(known.angle_rad)).sum())
        start_s = round(start_s + float(path.time_s[-1]) + PAUSE_S, 1)
    wire = Needle(DIAMETER_M, RIGIDITY_NM2 * 32.0 / (np.pi * DIAMETER_M**4), DENSITY_KG_M3)
    names = tuple(f"hall_{k}" for k in range(1, len(LAYOUT.sensor_positions_m) + 1))
    return Dataset(f"foreign {motion}", LAYOUT, names, wire, tuple(trials))


def _within_play(base_rad: Array, play_rad: float) -> Array:
    """What a base turns that meets the needle at either end of its play."""
    held = itertools.accumulate(
        base_rad.tolist(),
        lambda at, base: min(max(at, base - play_rad / 2.0), base + play_rad / 2.0),
        initial=float(base_rad[0]),
    )
    return np.fromiter(itertools.islice(held, 1, None), np.float64)
