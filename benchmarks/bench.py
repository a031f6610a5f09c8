"""Measures solver, diagnosis and control on this machine.

bench solver [--json FILE] [--quick]   beside its peers
bench kernel --against REF [--quick]   beside itself at another commit, over kinds of rods
bench diagnose --against REF [--quick] beside itself at another commit, over the practice sets
bench tick --against REF [--quick]     beside itself at another commit: one tick of the brain at 1 kHz
bench gradient [--quick]               derivatives by the tangent, beside those of SciPy and of CasADi
bench engine --against REF [--quick]   questions of the standard series beside itself at REF

`solver`: the trial is the paper's 45° compensation (five motions at 45°/s, 3 s settles, samples at 50 Hz, 200
elements in tissue). Peers run the same rigid rod with damping 0.06 N·mm·s per 100 mm, the least at which
explicit steps of 1e-6 s are stable: the explicit scheme and SciPy over the whole trial, MuJoCo over its first
2 s, scaled by simulated time. SciPy is LSODA with a banded Jacobian, its fastest stiff integrator here (BDF
takes 7 times as long). Times are medians of interleaved runs, in processor time, so that a busy machine
spoils them less; a trial of a batch counts that time over the number of cores. `standard_trial_ms` and
`batch_trial_ms` are the worst over dampings and tissues.

`kernel`: a process for each tree, asked in turn; medians of the ratios of processor times, this tree over
REF, and whether both found the same to the bit, else the largest difference relative to the largest number.
Each begins with an empty cache, so that its first solve takes the time to compile.

`diagnose`: whole commands with `--jobs 1`, this tree and REF in turn, each with its compiled solver; medians
of the processor times and of the ratios of pairs.

`gradient`: a practice series in elastic tissue, in bins and on elements of 4 mm, as a fit solves it.
Derivatives of torque and sensors by p parameters: friction, rigidity, then the friction of each section.
Times are medians of interleaved runs, in processor time, over that of one solution; SciPy's are those that
`least_squares` takes. CasADi's are forward sensitivities by IDAS of the same rod with smooth friction
(benchmarks/gradient_peer.py), medians of fewer runs. It needs: pip install -c requirements.lock -e '.[peers]'

`engine`: whole commands with one job on eight simulated trials, this tree and REF in turn, medians of
processor times and of the ratios of pairs, as a page of docs/evidence.

`tick`: a process for each tree, asked in turn; each judges the readings of four seconds, at rest, in motion
and in a hold. Medians of the processor times and of the ratios of pairs, and whether both told the drive the
same.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, TypeVar

import numpy as np

from benchmarks.gradient_peer import RELATIVE_TOLERANCE, ROUNDING, SLIP_TIME_S, UNIT_NM, smooth
from campaigns import ROOT
from needle_rig.physics.reference import KarnoppRod, simulate
from needle_rig.physics.rod import Layout, Rod, build_rod
from needle_rig.physics.solution import Path as BasePath
from needle_rig.physics.solution import Sampled
from needle_rig.physics.solver import solve, solve_batch, solve_series

JG = 62.56e-6
LAYOUT = Layout(
    0.397, ((0.175, 0.2), (0.24, 0.265), (0.305, 0.33), (0.37, 0.395)), (0.22, 0.285, 0.35, 0.397)
)
Case = TypeVar("Case")


class ByDamping(TypedDict):
    """A rod at one damping beside one solved far more finely."""

    damping_nmms_per_100mm: float
    tissue: str
    trial_ms: float
    batch_trial_ms: float
    error_deg: float
    error_nmm: float
    steps: int
    solves: int


class Scaling(TypedDict):
    """A trial of so many motions on so many elements."""

    elements: int
    motions: int
    trial_ms: float


class Peer(TypedDict):
    """What one solver takes for the trial, and how far it is off."""

    s: float
    error_deg: float


class FirstCall(TypedDict):
    """In a new process with a warm cache."""

    import_numba_s: float
    first_call_s: float


class SolverResult(FirstCall):
    """What `solver` writes."""

    standard_trial_ms: float
    standard_trial_elastic_undamped_ms: float
    batch_trial_elastic_undamped_ms: float
    batch_trial_ms: float
    error_deg: float
    error_nmm: float
    ratio_explicit: float
    ratio_scipy: float
    ratio_mujoco: float | None
    by_damping: list[ByDamping]
    scaling: list[Scaling]
    peers: dict[str, Peer]
    cores: int | None


class OfKind(TypedDict):
    """A kind of rod in two trees."""

    ms: float
    ratio: float
    equal: bool
    difference: float


class KernelResult(TypedDict):
    """What `kernel` writes."""

    kinds: dict[str, OfKind]
    ratio: float
    first_start_s: list[float]


class OfTick(TypedDict):
    """One tick of the brain in two trees."""

    us: float
    against_us: float
    ratio: float
    equal: bool


class TickResult(TypedDict):
    """What `tick` writes."""

    kinds: dict[str, OfTick]
    ratio: float


class OfGradient(TypedDict):
    """A gradient of p parameters, in solutions of the trial."""

    parameters: int
    tangent: float
    scipy: float
    difference: float
    """Of the two gradients, relative to their size."""
    casadi: float | None
    casadi_difference: float | None


class GradientResult(TypedDict):
    """What `gradient` writes."""

    solution_ms: float
    casadi_solution: float | None
    """In solutions of ours."""
    casadi_error_deg: float | None
    casadi_error_nmm: float | None
    gradients: list[OfGradient]


class OfSet(TypedDict):
    """A diagnosis in two trees."""

    s: float
    against_s: float
    ratio: float


class DiagnoseResult(TypedDict):
    """What `diagnose` writes."""

    sets: dict[str, OfSet]
    ratio: float


DAMPINGS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 2.8)
PEER_DAMPING = 0.06
FRICTION = 0.0996


def needle(damping: float, elastic: bool, element_length_m: float = 0.5e-3) -> Rod:
    """The rig's rod; damping N·mm·s per 100 mm, elastic tissue 0.278 N·mm/rad per 100 mm."""
    plain = build_rod(LAYOUT, JG, FRICTION * 1e-2, element_length_m)
    length = plain.tissue_length_m
    stiffness = np.where(length > 0, 0.278e-2 * length, 1.0)
    return replace(
        plain,
        viscous_nms_per_rad=damping * 1e-2 * length,
        compliance_rad_per_nm=np.where((length > 0) & elastic, 1 / stiffness, 0.0),
    )


def trial(motions: int = 5, sample_hz: float = 50.0) -> tuple[np.ndarray, np.ndarray]:
    lag = FRICTION * 1e-3 * 0.285 / JG
    steps = [0.0, lag, -0.75 * lag, 0.25 * lag, 0.0]
    times, angles = [0.0], [0.0]
    for motion in range(motions):
        target = np.pi / 4 + steps[motion % 5]
        times += [times[-1] + max(abs(target - angles[-1]) / (np.pi / 4), 0.02)]
        times += [times[-1] + 3.0]
        angles += [target, target]
    grid = np.union1d(np.arange(0.0, times[-1], 1 / sample_hz), times)
    grid = grid[np.append(True, np.diff(grid) > 1e-6)]
    return grid, np.interp(grid, times, angles)


def interleaved(
    calls: Mapping[Case, Callable[[], object]], rounds: int, clock: Callable[[], float] = time.process_time
) -> dict[Case, float]:
    """Median seconds of each call, measured in turn; of the processor unless another clock is given."""
    for call in calls.values():
        call()
    spent: dict[Case, list[float]] = {key: [] for key in calls}
    for _ in range(rounds):
        for key, call in calls.items():
            start = clock()
            call()
            spent[key].append(clock() - start)
    return {key: statistics.median(values) for key, values in spent.items()}


def once(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.process_time()
    result = call()
    return time.process_time() - start, result


def worst_deg(angles: np.ndarray, exact: np.ndarray) -> float:
    return float(np.degrees(np.abs(angles - exact).max()))


def by_damping(quick: bool) -> list[ByDamping]:
    times, base = trial()
    finer = 4 if quick else 8
    fine_t = np.interp(np.arange((len(times) - 1) * finer + 1) / finer, np.arange(len(times)), times)
    fine_b = np.interp(fine_t, times, base)
    cases = [(b, e) for e in (False, True) for b in DAMPINGS]
    rods = {case: needle(*case) for case in cases}
    alone = interleaved(
        {c: functools.partial(solve, r, times, base) for c, r in rods.items()}, 5 if quick else 15
    )
    batch = 32
    varied = {
        c: [replace(r, slip_plus_nm=r.slip_plus_nm * (1 + 1e-3 * i)) for i in range(batch)]
        for c, r in rods.items()
    }
    many = interleaved(
        {c: functools.partial(solve_batch, r, [(times, base)]) for c, r in varied.items()}, 1 if quick else 5
    )
    cores = os.cpu_count() or 1
    rows: list[ByDamping] = []
    for case, rod in rods.items():
        ours = solve(rod, times, base)
        exact = solve(needle(*case, 0.5e-3 / finer), fine_t, fine_b, tolerance_rad=1e-5)
        rows.append(
            {
                "damping_nmms_per_100mm": case[0],
                "tissue": "elastic" if case[1] else "rigid",
                "trial_ms": 1e3 * alone[case],
                "batch_trial_ms": 1e3 * many[case] / batch / cores,
                "error_deg": worst_deg(ours.sensor_rad, exact.sensor_rad[::finer]),
                "error_nmm": float(np.abs(ours.torque_nm - exact.torque_nm[::finer]).max() * 1e3),
                "steps": ours.steps,
                "solves": ours.solves,
            }
        )
    return rows


def scaling(quick: bool) -> list[Scaling]:
    times, base = trial()
    rows: list[Scaling] = []
    for elements in (200, 2000, 20_000):
        rod = needle(0.0, True, 0.1 / elements)
        spent = interleaved({0: functools.partial(solve, rod, times, base)}, 2 if quick else 5)[0]
        rows.append({"elements": elements, "motions": 5, "trial_ms": 1e3 * spent})
    for motions in (5, 50, 500):
        path = trial(motions)
        rod = needle(0.0, True)
        spent = interleaved({0: functools.partial(solve, rod, *path)}, 2 if quick else 5)[0]
        rows.append({"elements": 200, "motions": motions, "trial_ms": 1e3 * spent})
    return rows


def explicit(times: np.ndarray, base: np.ndarray) -> tuple[float, np.ndarray]:
    disks = KarnoppRod(LAYOUT, JG, FRICTION * 1e-2, FRICTION * 1e-2, PEER_DAMPING * 1e-2, 1e-9)
    simulate(disks, times[:2], base[:2], 1e-6)
    spent, found = once(lambda: simulate(disks, times, base, 1e-6))
    return spent, found.sensor_rad


def disks_of(rod: Rod) -> tuple[np.ndarray, ...]:
    """Cells, springs to the left and right and lengths for peers: only tissue moves, spans are springs."""
    inside = rod.tissue_length_m > 0
    place = rod.position_m[inside]
    left = JG / np.diff(place, prepend=0.0)
    return place, left, np.append(left[1:], 0.0), rod.tissue_length_m[inside]


def scipy_stiff(times: np.ndarray, base: np.ndarray) -> tuple[float, np.ndarray]:
    """Angles of dry-friction cells as a stiff ODE: rate = (torque beyond the limit) / damping."""
    from scipy.integrate import solve_ivp

    place, left, right, length = disks_of(needle(PEER_DAMPING, False))
    limit, damping = FRICTION * 1e-2 * length, PEER_DAMPING * 1e-2 * length
    n = len(place)

    def rate(t: float, angle: np.ndarray) -> np.ndarray:
        padded = np.concatenate([[np.interp(t, times, base)], angle, angle[-1:]])
        load = left * (padded[:-2] - angle) + right * (padded[2:] - angle)
        slipping: np.ndarray = np.sign(load) * np.maximum(np.abs(load) - limit, 0.0) / damping
        return slipping

    def jacobian(t: float, angle: np.ndarray) -> np.ndarray:
        moving = rate(t, angle) != 0.0
        scale = moving / damping
        rows = [scale * -(left + right), (scale * right)[:-1], (scale * left)[1:]]
        banded = np.zeros((3, n))
        banded[1], banded[0, 1:], banded[2, :-1] = rows
        return banded

    bends = np.abs(np.diff(np.diff(base) / np.diff(times))) > 1e-6
    kinks = [0, *(np.flatnonzero(bends) + 1), len(times) - 1]
    start = time.process_time()
    angle = np.zeros(n)
    found = [angle]
    for a, b in itertools.pairwise(kinks):
        piece = solve_ivp(
            rate, (times[a], times[b]), angle, "LSODA", times[a + 1 : b + 1], jac=jacobian,
            rtol=1e-6, atol=1e-7, max_step=0.05, lband=1, uband=1,
        )  # fmt: skip
        found += list(piece.y.T)
        angle = piece.y[:, -1]
    spent = time.process_time() - start
    known = np.column_stack([base, np.array(found)])
    sensors = np.array(LAYOUT.sensor_positions_m)
    return spent, np.array([np.interp(sensors, np.append(0.0, place), row) for row in known])


def mujoco_chain(times: np.ndarray, base: np.ndarray) -> tuple[float, np.ndarray] | None:
    """Hinges with friction loss and damping, coupled by springs; inertia as small as its steps allow."""
    try:
        import mujoco
    except ImportError:
        return None
    place, left, _, length = disks_of(needle(PEER_DAMPING, False))
    unit, dt = 1e6, 1e-4
    bodies, springs = [], []
    for i, (k, h) in enumerate(zip(left * unit, length, strict=True)):
        friction, damping = FRICTION * 1e-2 * h * unit, PEER_DAMPING * 1e-2 * h * unit
        own = f'stiffness="{k}"' if i == 0 else ""
        inertia = 2 * left[1] * unit * dt**2
        bodies.append(
            f'<body><joint name="j{i}" type="hinge" axis="0 0 1" damping="{damping}" armature="{inertia}"'
            f' frictionloss="{friction}" solreffriction="{2 * dt} 1" {own}/>'
            '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-9 1e-9 1e-9"/></body>'
        )
        if i:
            springs.append(
                f'<fixed stiffness="{k}" springlength="0"><joint joint="j{i - 1}" coef="-1"/>'
                f'<joint joint="j{i}" coef="1"/></fixed>'
            )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt}" gravity="0 0 0" integrator="implicitfast" '
        'solver="PGS" iterations="20"><flag contact="disable"/></option><size memory="200M"/>'
        f"<worldbody>{''.join(bodies)}</worldbody><tendon>{''.join(springs)}</tendon></mujoco>"
    )
    data = mujoco.MjData(model)
    found = [np.zeros(len(place))]
    start = time.process_time()
    for a, b, t0, t1 in zip(base, base[1:], times, times[1:], strict=False):
        steps = round((t1 - t0) / dt)
        for k in range(steps):
            model.qpos_spring[0] = a + (b - a) * (k + 1) / steps
            mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    spent = time.process_time() - start
    known = np.column_stack([base, np.array(found)])
    sensors = np.array(LAYOUT.sensor_positions_m)
    return spent, np.array([np.interp(sensors, np.append(0.0, place), row) for row in known])


FIRST_CALL = """
import sys, time
import numpy as np
from needle_rig.physics.rod import Layout, build_rod
from needle_rig.physics.solver import solve
rod = build_rod(Layout(0.3, ((0.2, 0.3),), (0.3,)), 6e-5, 1e-3)
a = time.process_time()
import numba
b = time.process_time()
solve(rod, np.arange(2.0), np.array([0.0, 1.0]))
print(b - a, time.process_time() - b)
"""


def first_call_s() -> FirstCall:
    """In a new process with a warm cache: importing numba, and the first solve after it."""
    runs = []
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", FIRST_CALL, str(ROOT)], capture_output=True, check=True)
        runs.append([float(x) for x in done.stdout.split()])
    numba_s, call_s = (statistics.median(column) for column in zip(*runs, strict=True))
    return {"import_numba_s": numba_s, "first_call_s": call_s}


def solver(quick: bool) -> SolverResult:
    times, base = trial()
    rows = by_damping(quick)
    rod = needle(PEER_DAMPING, False)
    exact = solve(rod, times, base, tolerance_rad=1e-6).sensor_rad
    ours = interleaved({0: lambda: solve(rod, times, base)}, 15)[0]
    peers: dict[str, Peer] = {
        "ours": {"s": ours, "error_deg": worst_deg(solve(rod, times, base).sensor_rad, exact)}
    }
    spent, angles = explicit(times, base)
    peers["explicit"] = {"s": spent, "error_deg": worst_deg(angles, exact)}
    spent, angles = scipy_stiff(times, base)
    peers["scipy LSODA"] = {"s": spent, "error_deg": worst_deg(angles, exact)}
    part = times <= 2.0
    chain = mujoco_chain(times[part], base[part])
    if chain:
        peers["mujoco"] = {
            "s": chain[0] * times[-1] / times[part][-1],
            "error_deg": worst_deg(chain[1], exact[part]),
        }
    ours_again = interleaved({0: lambda: solve(rod, times, base)}, 15)[0]
    ours = statistics.median([ours, ours_again])
    plain = next(r for r in rows if r["tissue"] == "elastic" and r["damping_nmms_per_100mm"] == 0)
    return {
        "standard_trial_ms": max(r["trial_ms"] for r in rows),
        "standard_trial_elastic_undamped_ms": plain["trial_ms"],
        "batch_trial_elastic_undamped_ms": plain["batch_trial_ms"],
        "batch_trial_ms": max(r["batch_trial_ms"] for r in rows),
        "error_deg": max(r["error_deg"] for r in rows),
        "error_nmm": max(r["error_nmm"] for r in rows),
        "ratio_explicit": peers["explicit"]["s"] / ours,
        "ratio_scipy": peers["scipy LSODA"]["s"] / ours,
        "ratio_mujoco": peers["mujoco"]["s"] / ours if chain else None,
        **first_call_s(),
        "by_damping": rows,
        "scaling": scaling(quick),
        "peers": peers,
        "cores": os.cpu_count(),
    }


class Asked:
    """A process that runs a script of this tree by the code of another one."""

    def __init__(self, script: str, tree: Path, cache: Path) -> None:
        command = [sys.executable, str(ROOT / "benchmarks" / script)]
        environment = {**os.environ, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(cache)}
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)

    def ask(self, name: str, times: int) -> Any:
        """What it answers to a line: of a solve with 0 its numbers, else seconds and a digest."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{name} {times}\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())


def both_trees(script: str, against: str, folder: Path) -> tuple[Asked, Asked]:
    """`script` by the code of this tree, and by that of commit `against`, which is put into `folder`."""
    kept = subprocess.run(["git", "-C", ROOT, "archive", against], check=True, capture_output=True)
    subprocess.run(["tar", "-x", "-C", folder], input=kept.stdout, check=True)
    return Asked(script, ROOT, folder / "ours"), Asked(script, folder, folder / "theirs")


def tick(against: str, quick: bool) -> TickResult:
    """This tree's brain beside the one of commit `against`, by what the rig does."""
    from benchmarks.tick_kinds import KINDS

    rows: dict[str, OfTick] = {}
    with tempfile.TemporaryDirectory() as name:
        ours, theirs = both_trees("tick_kinds.py", against, Path(name))
        for kind in KINDS:
            pairs = [(ours.ask(kind, 1), theirs.ask(kind, 1)) for _ in range(7 if quick else 31)]
            row = rows[kind] = {
                "us": 1e6 * statistics.median(a[0] for a, _ in pairs),
                "against_us": 1e6 * statistics.median(b[0] for _, b in pairs),
                "ratio": statistics.median(a[0] / b[0] for a, b in pairs),
                "equal": pairs[0][0][1] == pairs[0][1][1],
            }
            same = "tells the drive the same" if row["equal"] else "tells the drive something else"
            print(
                f"{kind:9s} {row['us']:6.1f} µs   {row['against_us']:6.1f} µs   × {row['ratio']:.3f}   {same}"
            )
    return {"kinds": rows, "ratio": statistics.median(row["ratio"] for row in rows.values())}


def kernel(against: str, quick: bool) -> KernelResult:
    """This tree over the one of commit `against`: ratio of processor times and equality, by kind of rod."""
    from benchmarks.kernel_kinds import KINDS

    rows: dict[str, OfKind] = {}
    with tempfile.TemporaryDirectory() as name:
        ours, theirs = both_trees("kernel_kinds.py", against, Path(name))
        first_start_s = [side.ask("rigid", 1)[0] for side in (ours, theirs)]
        for kind in KINDS:
            found, before = (np.array(side.ask(kind, 0)) for side in (ours, theirs))
            times = max(1, math.ceil(0.03 / ours.ask(kind, 1)[0]))
            pairs = [(ours.ask(kind, times), theirs.ask(kind, times)) for _ in range(9 if quick else 31)]
            rows[kind] = {
                "ms": 1e3 * statistics.median(a[0] for a, _ in pairs),
                "ratio": statistics.median(a[0] / b[0] for a, b in pairs),
                "equal": pairs[0][0][1] == pairs[0][1][1],
                "difference": float(np.abs(found - before).max() / np.abs(before[:-2]).max()),
            }
    ratio = statistics.median(row["ratio"] for row in rows.values())
    return {"kinds": rows, "ratio": ratio, "first_start_s": first_start_s}


def show_kernel(result: KernelResult) -> None:
    for kind, row in result["kinds"].items():
        same = "equal to the bit" if row["equal"] else f"differs by {row['difference']:.1e}"
        print(f"{kind:18s} {row['ms']:8.2f} ms   × {row['ratio']:.3f}   {same}")
    ours_s, theirs_s = result["first_start_s"]
    print(f"median × {result['ratio']:.3f}")
    print(f"first solve with an empty cache: {ours_s:.1f} s, before {theirs_s:.1f} s")


def processor_s(tree: Path, asked: list[str]) -> float:
    """What a command of a tree takes."""
    # without bytecode each start compiles the whole package, and the larger one would look slower
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "needle_rig", *asked],
        cwd=tree,
        env={**environment, "PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(tree / ".numba_cache")},
        check=True,
        capture_output=True,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def both_archives(against: str, folder: Path) -> list[Path]:
    """The files of this commit and of `against`, each with its compiled solver."""
    trees = [folder / name for name in ("ours", "theirs")]
    for tree, commit in zip(trees, ("HEAD", against), strict=True):
        tree.mkdir()
        kept = subprocess.run(["git", "-C", ROOT, "archive", commit], check=True, capture_output=True)
        subprocess.run(["tar", "-x", "-C", tree], input=kept.stdout, check=True)
        processor_s(tree, ["compare", str(ROOT / "tests/data/practice/none")])
    return trees


def side_by_side(trees: list[Path], asked: list[str], rounds: int) -> OfSet:
    """A command in both trees, in turn."""
    pairs = [[processor_s(tree, asked) for tree in trees] for _ in range(rounds)]
    return {
        "s": statistics.median(a for a, _ in pairs),
        "against_s": statistics.median(b for _, b in pairs),
        "ratio": statistics.median(a / b for a, b in pairs),
    }


def diagnose(against: str, quick: bool) -> DiagnoseResult:
    """This tree over the one of commit `against`: processor time of `diagnose`, by practice set."""
    rows: dict[str, OfSet] = {}
    with tempfile.TemporaryDirectory() as folder:
        trees = both_archives(against, Path(folder))
        for name in sorted(p.name for p in (ROOT / "tests/data/practice").iterdir() if p.is_dir()):
            asked = ["diagnose", str(ROOT / "tests/data/practice" / name), "--json", "--jobs", "1"]
            row = rows[name] = side_by_side(trees, asked, 1 if quick else 5)
            print(
                f"{name:18s} {row['s']:6.1f} s   {row['against_s']:6.1f} s   × {row['ratio']:.3f}", flush=True
            )
    return {"sets": rows, "ratio": statistics.median(row["ratio"] for row in rows.values())}


HIDDEN = {
    "nothing": (),
    "tissue_elasticity": ("tissue_elasticity=0.35",),
    "tissue_elasticity, hall_gain": ("tissue_elasticity=0.35", "hall_gain"),
    "stribeck": ("stribeck",),
    "stiction_ageing": ("stiction_ageing",),
}
SERIES = 6
"""Of the long question: 48 trials, some 20 minutes of recording."""


def engine(against: str, quick: bool, only: str) -> DiagnoseResult:
    """Questions of the standard series in both trees, as a page; those whose row holds `only`."""
    rows: dict[str, OfSet] = {}
    rounds = 1 if quick else 5
    print(f"Processor time, s; before: {against}. `--jobs 1`, medians of pairs: {rounds}.")
    print("Eight trials where no other number is given.\n")
    print("| question | hidden | before | now | now / before |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        trees = both_archives(against, Path(folder))

        def series(hidden: str, seed: int = 1) -> str:
            data = Path(folder) / "data" / f"{hidden.replace(', ', '_')}_{seed}"
            if not data.exists():
                made = ["simulate", "--parameters", "rig_rigid", "--seed", str(seed), "--out", str(data)]
                added = (part for each in HIDDEN[hidden] for part in ("--effect", each))
                processor_s(trees[0], [*made, *added])
            return str(data)

        asked = [("compare", "nothing", 1)]
        asked += [("diagnose", hidden, 1) for hidden in HIDDEN]
        asked += [("learn", "tissue_elasticity", 1), ("diagnose, 48 trials", "nothing", SERIES)]
        for question, hidden, count in asked:
            name = f"{question} | {hidden}"
            if only not in name:
                continue
            data = [series(hidden, seed) for seed in range(1, count + 1)]
            jobs = [] if question == "compare" else ["--json", "--jobs", "1"]
            row = rows[name] = side_by_side(trees, [question.split(",")[0], *data, *jobs], rounds)
            print(f"| {name} | {row['against_s']:.1f} | {row['s']:.1f} | {row['ratio']:.2f} |", flush=True)
    return {"sets": rows, "ratio": statistics.median(row["ratio"] for row in rows.values())}


def gradient(quick: bool) -> GradientResult:
    """Derivatives by the tangent, beside those by finite differences."""
    from scipy.optimize._numdiff import approx_derivative

    from needle_rig.dataset import read_dataset
    from needle_rig.physics.library import built_in_effects
    from needle_rig.workbench.estimation.baseline import COARSE_M, null_model
    from needle_rig.workbench.observations.binning import bin_trial

    data = read_dataset(ROOT / "tests/data/practice/elastic")
    trials = [bin_trial(given).trial for given in data.trials]
    model = replace(null_model(data), element_length_m=COARSE_M)
    rod = model.with_effects(built_in_effects()["tissue_elasticity"].at_strength(1.0)).rod(trials[0])
    paths = [BasePath.of(each.time_s, each.base_angle_rad) for each in trials]
    factors = np.linspace(0.95, 1.05, len(paths))

    def at(x: np.ndarray) -> Rod:
        shares = np.append(x[2:], np.zeros(4 - x[2:].size))[np.maximum(rod.section, 0)]
        slip = rod.slip_plus_nm * np.exp(x[0] + shares)
        stiffness = rod.stiffness_nm_per_rad * math.exp(x[1])
        return replace(rod, stiffness_nm_per_rad=stiffness, slip_plus_nm=slip, slip_minus_nm=slip)

    def values(series: list[Sampled]) -> np.ndarray:
        return np.concatenate([v for s in series for v in (s.torque_nm / UNIT_NM, s.sensor_rad.ravel())])

    def solved(x: np.ndarray) -> np.ndarray:
        return values(solve_series(at(x), paths, factors)[0])

    step = 1e-4

    def tangent(x: np.ndarray) -> np.ndarray:
        near = [(at(x + step * way), factors) for way in np.eye(x.size)]
        here, *would = solve_series(at(x), paths, factors, near=near)
        return np.column_stack([(values(each) - values(here)) / step for each in would])

    def by_trial(columns: np.ndarray) -> list[np.ndarray]:
        """(samples, 1 + sensors, …) of each trial, as the peer gives them: without the first sample."""
        ends = np.cumsum([each.time_s.size * (1 + rod.sensors.size) for each in paths])[:-1]
        parts = []
        for part in np.split(columns, ends):
            torque, sensors = np.split(part, [len(part) // (1 + rod.sensors.size)])
            sensors = sensors.reshape(len(torque), -1, *part.shape[1:])
            parts.append(np.concatenate([torque[:, None], sensors], axis=1)[1:])
        return parts

    rows: list[OfGradient] = []
    print(
        "| parameters | tangent | SciPy | CasADi | tangent / SciPy | tangent / CasADi"
        " | tangent and SciPy differ by | CasADi by |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for count in (2, 4, 6):
        x = np.zeros(count)
        spent = interleaved(
            {
                "solution": functools.partial(solved, x),
                "tangent": functools.partial(tangent, x),
                "scipy": functools.partial(approx_derivative, solved, x, method="2-point", f0=solved(x)),
            },
            20 if quick else 100,
        )
        solution_s = spent["solution"]
        exact = approx_derivative(solved, x, method="3-point", rel_step=step, abs_step=step)
        row: OfGradient = {
            "parameters": count,
            "tangent": spent["tangent"] / solution_s,
            "scipy": spent["scipy"] / solution_s,
            "difference": float(np.linalg.norm(tangent(x) - exact) / np.linalg.norm(exact)),
            "casadi": None,
            "casadi_difference": None,
        }
        series = [smooth(at(np.zeros(2)), path, f, count) for path, f in zip(paths, factors, strict=True)]
        peers = [peer for peer in series if peer]
        if peers:
            calls = {
                "casadi": functools.partial(lambda each, x: [peer.derived(x) for peer in each], peers, x),
                "once": functools.partial(lambda each, x: [peer.solved(x) for peer in each], peers, x),
            }
            theirs = interleaved(calls, 1 if quick else 5)
            off = [p.derived(x) - e for p, e in zip(peers, by_trial(exact), strict=True)]
            row["casadi"] = theirs["casadi"] / solution_s
            row["casadi_difference"] = float(
                math.sqrt(sum((part**2).sum() for part in off)) / np.linalg.norm(exact)
            )
        rows.append(row)
        cells = ["–"] * 3
        if row["casadi"] and row["casadi_difference"]:
            share = row["tangent"] / row["casadi"]
            cells = [f"{row['casadi']:.0f}", f"{share:.1e}", f"{row['casadi_difference']:.1e}"]
        print(
            f"| {count} | {row['tangent']:.2f} | {row['scipy']:.2f} | {cells[0]}"
            f" | {row['tangent'] / row['scipy']:.2f} | {cells[1]} | {row['difference']:.1e} | {cells[2]} |",
            flush=True,
        )
    result: GradientResult = {
        "solution_ms": solution_s * 1e3,
        "casadi_solution": None,
        "casadi_error_deg": None,
        "casadi_error_nmm": None,
        "gradients": rows,
    }
    print(f"\nColumns 2 to 4: solutions of ours, {result['solution_ms']:.2f} ms for {len(paths)} trials.")
    if not peers:
        print("CasADi is not installed here: pip install -c requirements.lock -e '.[peers]'", file=sys.stderr)
        return result
    error = np.concatenate([p.solved(x) - o for p, o in zip(peers, by_trial(solved(x)), strict=True)])
    result["casadi_solution"] = theirs["once"] / solution_s
    result["casadi_error_deg"] = float(np.degrees(np.abs(error[:, 1:]).max()))
    result["casadi_error_nmm"] = float(np.abs(error[:, 0]).max() * UNIT_NM * 1e3)
    print(
        f"\nCasADi: IDAS, relative tolerance {RELATIVE_TOLERANCE:g}; friction made smooth, slip time"
        f" {SLIP_TIME_S * 1e3:g} ms, rounding {ROUNDING:g} of the slip limit;"
        f" evaluated by CasADi itself, not compiled.\nIts solution costs"
        f" {result['casadi_solution']:.0f} of ours and differs by at most"
        f" {result['casadi_error_deg']:.3f}° and {result['casadi_error_nmm']:.1e} N·mm."
    )
    return result


def show(result: SolverResult) -> None:
    print("damping  tissue    trial ms  batch ms  error °    N·mm     steps solves")
    for r in result["by_damping"]:
        print(
            f"{r['damping_nmms_per_100mm']:7.2f}  {r['tissue']:8s} {r['trial_ms']:8.2f}"
            f"  {r['batch_trial_ms']:8.2f}  {r['error_deg']:.4f}  {r['error_nmm']:.1e}"
            f"  {r['steps']:5d} {r['solves']:6d}"
        )
    for s in result["scaling"]:
        print(f"{s['elements']:6d} elements, {s['motions']:4d} motions: {s['trial_ms']:9.2f} ms")
    for name, p in result["peers"].items():
        print(f"{name:12s} {p['s']:10.4f} s   error {p['error_deg']:.4f}°")
    for key, value in result.items():
        if isinstance(value, int | float):
            print(f"{key}: {value:.4g}")
        elif value is None:
            print(f"{key}: not installed")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=["solver", "kernel", "diagnose", "tick", "gradient", "engine"])
    parser.add_argument("--against", metavar="REF", default="HEAD")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions")
    parser.add_argument("--only", default="", metavar="WORD", help="rows of `engine` that hold it")
    given = parser.parse_args()
    result: SolverResult | KernelResult | DiagnoseResult | TickResult | GradientResult
    if given.part == "kernel":
        result = of_kernel = kernel(given.against, given.quick)
        show_kernel(of_kernel)
    elif given.part == "diagnose":
        result = of_sets = diagnose(given.against, given.quick)
        print(f"median × {of_sets['ratio']:.3f}")
    elif given.part == "engine":
        result = engine(given.against, given.quick, given.only)
    elif given.part == "gradient":
        result = gradient(given.quick)
    elif given.part == "tick":
        result = of_ticks = tick(given.against, given.quick)
        print(f"median × {of_ticks['ratio']:.3f}")
    else:
        result = of_solver = solver(given.quick)
        show(of_solver)
    if given.json:
        given.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
