"""The same fit of the same traces by needle-rig, lmfit and Sherpa: typed, shown, and wrong by default.

Friction, torsional rigidity and the stiffness of an elastic tissue, from simulated traces whose values are
known. It needs: pip install lmfit sherpa, into an environment of their own. Sherpa may have to be compiled:
then also a compiler, bison, flex and FFTW.
"""

from __future__ import annotations

import dataclasses
import inspect
import logging
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np

import needle_rig as nr
from campaigns.run import Campaign, Row, answered, markdown
from campaigns.workbench.fit_ways import HALL_DEG, MODEL, NAMES, TORQUE_NMM, WAYS, samples
from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.numerics import Array
from needle_rig.units import nm, rad

TRUTH = np.array([MODEL.values()[name] for name in NAMES])
SEED = 9_000
SIGMA = np.array([nm(TORQUE_NMM), *4 * [rad(HALL_DEG)]])
"""Of a sample of torque (N·m) and of each Hall angle (rad)."""
WANDER_S = 0.4
"""Time over which what wanders forgets itself, as amplifiers of strain gauges do."""
SPIKES, SPIKE_SIGMAS = 0.005, 20.0
"""Share of the samples that are spikes, and their size: a bad contact."""

Disturbance = Callable[[DatasetTrial, np.random.Generator], Array]


def _none(trial: DatasetTrial, random: np.random.Generator) -> Array:
    return np.zeros((len(trial.trial.time_s), SIGMA.size))


def _wander(trial: DatasetTrial, random: np.random.Generator) -> Array:
    """As large as the white noise."""
    steps = random.standard_normal((len(trial.trial.time_s), SIGMA.size))
    kept = np.exp(-float(np.median(np.diff(trial.trial.time_s))) / WANDER_S)
    walk = np.empty_like(steps)
    walk[0] = steps[0]
    for k in range(1, len(steps)):
        walk[k] = kept * walk[k - 1] + np.sqrt(1.0 - kept**2) * steps[k]
    return np.asarray(walk * SIGMA)


def _spikes(trial: DatasetTrial, random: np.random.Generator) -> Array:
    where = random.random((len(trial.trial.time_s), SIGMA.size)) < SPIKES
    return np.asarray(np.where(where, random.choice([-1.0, 1.0], where.shape) * SPIKE_SIGMAS, 0.0) * SIGMA)


CASES: dict[str, Disturbance] = {
    "white noise": _none,
    "noise that wanders": _wander,
    "spikes": _spikes,
}


def made(case: str, seed: int) -> Dataset:
    """The practice series of eight trials, with the disturbance of the case."""
    given = nr.simulate({"tissue_elasticity": TRUTH[-1]}, seed=SEED + seed, name=case).given
    assert isinstance(given, Dataset)
    random = np.random.default_rng([SEED, seed])
    trials = []
    for trial in given.trials:
        added = CASES[case](trial, random)
        trials.append(
            dataclasses.replace(
                trial, torque_nm=trial.torque_nm + added[:, 0], hall_rad=trial.hall_rad + added[:, 1:]
            )
        )
    return dataclasses.replace(given, trials=tuple(trials))


def coverage(rows: list[Row]) -> str:
    """Whether what is said holds, by case and way."""
    values_of = ("friction", "rigidity", "stiffness")
    heads = ["data", "by", *(f"rms pull: {name}" for name in values_of), "95 % intervals that hold the truth"]
    heads += [*(f"rms error of {name} %" for name in values_of), "processor s"]
    lines: list[list[object]] = []
    for case in CASES:
        for way in WAYS:
            said = [row["said"][way.name] for row in rows if row["case"] == case]
            if not said:
                continue
            values, sigmas, ends = (
                np.array([each[name] for each in said]) for name in ("values", "sigmas", "intervals")
            )
            pulls = np.sqrt(np.mean(((values - TRUTH) / sigmas) ** 2, axis=0))
            wrong = 100 * np.sqrt(np.mean((values / TRUTH - 1.0) ** 2, axis=0))
            inside = np.mean((ends[..., 0] <= TRUTH) & (ends[..., 1] >= TRUTH))
            cells = [
                *(f"{pull:.1f}" for pull in pulls),
                f"{100 * inside:.0f} %",
                *(f"{each:.3f}" for each in wrong),
            ]
            lines.append([case, way.name, *cells, f"{np.median([each['processor_s'] for each in said]):.1f}"])
    return markdown(heads, lines)


def wrong_structure(row: Row) -> str:
    """What each says where the model lacks the stiffness."""
    lines = []
    for way, said in row["said"].items():
        off = np.abs(said["values"] / TRUTH - 1.0)
        cells = (
            f"{said['values'][k]:.4g}, {_plus_minus(said['sigmas'][k])}; {off[k]:.0%} off" for k in range(2)
        )
        lines.append([way, *cells, f"{said['redchi']:.0f}"])
    return markdown(("by", "friction", "rigidity", "reduced χ²"), lines)


def _plus_minus(sigma: float) -> str:
    return f"± {sigma:.1g}" if np.isfinite(sigma) else "no ±"


def defaults() -> list[str]:
    """What the packages do unasked, as they say it themselves."""
    import lmfit
    from sherpa.data import Data1D
    from sherpa.fit import Fit
    from sherpa.models.basic import Const1D

    scaled = inspect.signature(lmfit.Minimizer).parameters["scale_covar"].default
    weights = inspect.signature(lmfit.Model.fit).parameters["weights"].default
    readings, _ = samples(made("white noise", 0).trials)
    fit = Fit(Data1D("readings", np.arange(readings.size), readings), Const1D())
    with np.errstate(invalid="ignore"):
        assumed = fit.data.get_staterror(staterrfunc=fit.stat.calc_staterror)
    return [
        f"- lmfit: `scale_covar={scaled}`. Each ± is multiplied by √(reduced χ²): a wrong model gets a"
        " larger ± and no warning. A ± that the noise gives needs `scale_covar=False`.",
        f"- lmfit: `weights={weights}` in `Model.fit`. N·mm and degrees then count alike: the torque, whose"
        f" noise is {HALL_DEG / TORQUE_NMM:.0f} times smaller as a number, hardly counts.",
        f"- Sherpa: `{type(fit.stat).__name__}`, `{type(fit.method).__name__}` and"
        f" `{type(fit.estmethod).__name__}`. Without `staterror` the statistic takes the readings for counts:"
        f" it assumes ± {np.nanmin(assumed):.2g} to {np.nanmax(assumed):.2g}, where the noise is"
        f" {TORQUE_NMM:g} N·mm and {HALL_DEG:g}°, and says nothing.",
        "- Sherpa: `covar` gives a ± at any reduced statistic; `conf` and `proj` refuse above"
        f" {_max_rstat():g}.",
        "- lmfit and Sherpa: residuals count as independent. Noise that wanders and friction that differs"
        " between trials make every ± too small, and no line of a report says so.",
        "- needle-rig: noise, its correlation and the scatter of friction are measured on the data. With a"
        " wrong structure its ± is too small as well: the reduced χ² and the error on commands left out"
        " say so.",
    ]


def _max_rstat() -> float:
    from sherpa.estmethods import Confidence

    return float(Confidence().config["max_rstat"])


def size_mb(*packages: str) -> float:
    """What packages take as installed."""
    files = [Path(str(file.locate())) for name in packages for file in metadata.files(name) or ()]
    return sum(file.stat().st_size for file in files if file.exists()) / 1e6


BETTER = """\
- lmfit fits any Python function. It has bounds on everything, parameters tied by expressions (`expr`), some
  twenty minimisers, `emcee`, `conf_interval2d` and `eval_uncertainty`. needle-rig fits needle models alone.
- Sherpa has links between parameters, statistics for counts, `conf`, which walks each parameter, and
  simultaneous fits of different models. needle-rig has `fixed` values and no links.
- Both take less time and less room. needle-rig also bins the data, measures the noise and leaves each command
  out in turn: the column of processor time holds all of it.
- lmfit with a friction for each trial is more exact in rigidity on white noise. needle-rig allows for
  offsets and for motions that differ, which these data do not have.
- With an effect missing, needle-rig's rigidity is farther off than that of its peers, and its ± does not
  say so."""


def installed() -> str:
    """What the peers take, and their versions."""
    return (
        f"lmfit with its own packages {size_mb('lmfit', 'asteval', 'uncertainties', 'dill'):.0f} MB, Sherpa"
        f" {size_mb('sherpa'):.0f} MB, beside NumPy and SciPy, which all three need. lmfit"
        f" {metadata.version('lmfit')}, Sherpa {metadata.version('sherpa')}. The package index has Sherpa as"
        " source alone: pip compiles it, with bison, flex and FFTW."
    )


def plan(given: Namespace) -> list[Row]:
    """The fits that lack an effect, with what the packages say of themselves; then every dataset."""
    if not (find_spec("lmfit") and find_spec("sherpa")):
        print("lmfit and Sherpa are needed: pip install lmfit sherpa", file=sys.stderr)
        raise SystemExit(2)
    seeds = range(given.first_seed, given.first_seed + given.size)
    cases = [{"case": case, "seed": seed} for seed in seeds for case in CASES]
    return [{"case": "white noise", "seed": given.first_seed, "missing": True}, *cases]


def ask(task: Row, _: Namespace) -> Row:
    """What each way says of one dataset."""
    import sherpa.fit  # noqa: F401 its logger exists from here on

    logging.getLogger("sherpa").setLevel(logging.ERROR)
    data, missing = made(task["case"], task["seed"]), task.get("missing", False)
    found = {}
    for way in WAYS:
        begun_s = time.process_time()
        said = dataclasses.asdict(way.read(way.ask(data, missing)))
        arrays = {name: said[name].tolist() for name in ("values", "sigmas", "intervals")}
        found[way.name] = {**said, **arrays, "processor_s": time.process_time() - begun_s}
    return {"said": found} | ({"defaults": defaults(), "installed": installed()} if missing else {})


def table(rows: list[Row], _: Namespace) -> str:
    """The page."""
    found = [row for row in answered(rows) if "missing" not in row]
    parts = [
        "Friction, torsional rigidity and tissue stiffness from the same eight trials, of many datasets a"
        " case, each with its own noise and 2 % scatter of friction between trials. lmfit and Sherpa get the"
        " predictor of needle-rig as a plain function, every sample, and the true noise of the sensors. A"
        " pull is (value − truth) / ±: its root mean square is 1 where the ± is right, and above 1 where the"
        " ± is too small. The truth of friction is the mean over all trials that could be made.",
        coverage(found),
        f"Wandering noise is as large as the white noise, and forgets itself in {WANDER_S:g} s. Spikes are"
        f" {100 * SPIKES:g} % of the samples, {SPIKE_SIGMAS:g} σ high.",
    ]
    for row in answered(rows):
        if "missing" in row:
            parts += [
                "## The model lacks an effect",
                "The same white-noise data, fitted without the stiffness that they have.",
                wrong_structure(row),
                "Where Sherpa gives no ±, its log says that the search ran into the parameters' limits.",
                "## Wrong by default",
                "\n".join(row["defaults"]),
                "## Where a peer is better",
                BETTER,
                "## Installed",
                row["installed"],
            ]
    for way in WAYS if found else ():
        parts += [
            f"## {way.name}: typed and shown",
            f"{way.lines()} lines:",
            f"```python\n{way.source()}\n```",
            f"```text\n{found[0]['said'][way.name]['report']}\n```",
        ]
    return "\n\n".join(parts)


CAMPAIGN = Campaign(__doc__, plan, ask, table, 20, "datasets a case (20)")
