"""What learn and its peers say of the same hidden laws, and what each predicts on commands left out.

The laws are those of `hidden_laws.py` at their medium size. Peers: SINDy (PySINDy), symbolic regression
(PySR; where its Julia cannot be had, PyOperon in its stead), a Gaussian-process discrepancy on the calibrated
null model. They need: pip install -c requirements.lock -e '.[peers]'
"""

from __future__ import annotations

import sys
import traceback
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from campaigns.run import Campaign, Row, answered, markdown
from campaigns.workbench.hidden_laws import BY_NAME
from campaigns.workbench.peers import Data, Discrepancy, Peer, Sindy, Symbolic, left_out_error
from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.errors import BadInput
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.library import find_effects
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.learn_laws import learn_laws
from needle_rig.workbench.laws.symbolic import regressor, settings
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise

NOTHING = "nothing"
CASES = ("hall_2_third", "slit", NOTHING, "gear", "cell_cube", "kink", "bearing", "stop")
NOISE = Noise(friction_scatter=0.02, rigidity_error=0.02)
SEED = 71_000
LEARN, NULL = "needle-rig learn", "null model, calibrated"


class PySr:
    """PySR with the settings of `learn --pysr`."""

    def __init__(self, make: Callable[..., Any]) -> None:
        self.model = make(**settings())

    def fit(self, X: Array, y: Array) -> None:
        self.model.fit(X, y)

    def predict(self, X: Array) -> Array:
        return np.asarray(self.model.predict(X)).ravel()

    def formula(self, names: list[str]) -> str:
        return _named(str(self.model.get_best()["equation"]), names, "x", 0)


@dataclass
class Operon:
    """Genetic programming that fits its constants, as PySR does; 30 000 evaluations, at most 25 nodes."""

    EVALUATIONS = 30_000

    def __post_init__(self) -> None:
        from pyoperon.sklearn import SymbolicRegressor

        self.model: Any = SymbolicRegressor(
            allowed_symbols="add,sub,mul,div,sin,cos,exp,abs,constant,variable",
            population_size=500,
            max_evaluations=self.EVALUATIONS,
            max_length=25,
            optimizer_iterations=5,
            model_selection_criterion="minimum_description_length",
            n_threads=1,
            random_state=1,
        )

    def fit(self, X: Array, y: Array) -> None:
        self.model.fit(np.asfortranarray(X), y)

    def predict(self, X: Array) -> Array:
        return np.asarray(self.model.predict(np.asfortranarray(X))).ravel()

    def formula(self, names: list[str]) -> str:
        return _named(self.model.get_model_string(self.model.model_, 3), names, "X", 1)


def _named(text: str, names: list[str], letter: str, first: int) -> str:
    for k in reversed(range(len(names))):
        text = text.replace(f"{letter}{k + first}", names[k])
    return text


def symbolic() -> tuple[str, str, Callable[[], Any]]:
    """Name, settings and maker of the symbolic regression that can run here, and what keeps PySR out."""
    try:
        make = regressor()
    except BadInput as absent:
        print(f"{absent}; PyOperon stands in its stead", file=sys.stderr)
        return "PyOperon", Operon.__doc__ or "", Operon
    return "PySR", str(settings()), lambda: PySr(make)


def made(case: str) -> Dataset:
    """The dataset of a case."""
    effects = [] if case == NOTHING else [BY_NAME[case].at(1.0)]
    model = load_parameters("rig_rigid").with_effects(*effects)
    return simulate_dataset(model, load_protocol("standard"), SEED + CASES.index(case), NOISE, name=case)


def peers(data: Data) -> dict[str, Peer]:
    """The peers, ready for a dataset, by their names in the plan."""
    name, told, make = symbolic()
    command = f"{told} Inputs: base angle, rate, direction, base angle where the motion began, times."
    beside = f"{told} Inputs: the same, all other channels and their derivatives: it sees the trial."
    return {
        "sindy": Sindy(data),
        "symbolic": Symbolic(data, make, f"{name}, from the command", command),
        "symbolic beside": Symbolic(data, make, f"{name}, from the other channels", beside, beside=True),
        "discrepancy": Discrepancy(data),
    }


def plan(_: Namespace) -> list[Row]:
    ways = ("null", "sindy", "symbolic", "symbolic beside", "discrepancy", "learn")
    return [{"case": case, "way": way} for case in CASES for way in ways]


@cache
def known(case: str) -> Data:
    """What peers are given of a case."""
    return Data(fit_baseline(made(case), None, find_effects()))


def ask(task: Row, _: Namespace) -> Row:
    """What one way says of one case; what breaks a peer is its answer."""
    case, way = task["case"], task["way"]
    if way == "learn":
        found = learn_laws(made(case), find_effects(), origin=Origin(case, "0" * 64, "-"))
        says = f"{found.verdict}: {found.sentence}"
        says += "".join(f" {each.formula}" for each in found.laws if each.formula)
        return _answer(LEARN, says, found.held_out_after, "as it is")
    data = known(case)
    if way == "null":
        return _answer(NULL, "", data.baseline.validation.error, "")
    peer = peers(data)[way]
    try:
        error = left_out_error(data, peer)
        says = peer.fitted(range(len(data.binned))).says()
    except Exception:  # noqa: BLE001 counted
        error, says = float("nan"), "failed: " + traceback.format_exc(limit=-1).splitlines()[-1]
    return _answer(peer.name, says, error, peer.settings)


def _answer(name: str, says: str, error: float, told: str) -> Row:
    shown = round(float(error), 3) if np.isfinite(error) else None
    return {"peer": name, "says": says, "error": shown, "settings": told}


def table(every: list[Row], _: Namespace) -> str:
    """The figures, in Markdown."""
    rows = answered(every)
    ways = list(dict.fromkeys(row["peer"] for row in rows))
    order = sorted(ways, key=lambda name: (name != LEARN, name != NULL, ways.index(name)))
    cases = [case for case in CASES if any(row["case"] == case for row in rows)]
    by_both = {(row["case"], row["peer"]): row for row in rows}
    lines = [
        "Error on commands left out in units of the noise (1: nothing is missing), root mean square over all"
        " bins; processor seconds for all of it, the fits to all but one command included. A trial's own"
        " friction is unknown to all and is taken out of all alike.",
        "",
    ]
    cells = [[_words(case), *(_cell(by_both.get((case, name))) for name in order)] for case in cases]
    times = [f"{np.median([r['cpu_s'] for r in rows if r['peer'] == name]):.0f}" for name in order]
    lines += [markdown(["hidden", *order], [*cells, ["*processor s, median*", *times]])]
    lines += ["", "## What each says", ""]
    says = []
    for case in cases:
        for name in order:
            row = by_both.get((case, name))
            if row is not None and row["says"]:
                says.append((case, name, _short(row["says"])))
    lines += [markdown(("hidden", "by", "says"), says), "", "## Settings", ""]
    lines += [f"- **{name}**: {told}" for name, told in _settings(rows, order) if told]
    if any(name.startswith("PyOperon") for name in order):
        lines.append("- PySR: its Julia could not be had where this was run; PyOperon stands in its stead")
    lines += [
        "- Hidden laws at size 1 on the standard series (8 trials, 6 commands), 2 % scatter of friction, 2 %"
        " of the stated rigidity. A peer's simulated state is held within 20 rad."
    ]
    return "\n".join(lines)


def _settings(rows: list[Row], order: list[str]) -> list[tuple[str, str]]:
    return [(name, next(r["settings"] for r in rows if r["peer"] == name)) for name in order]


def _words(case: str) -> str:
    if case == NOTHING:
        return case
    law = BY_NAME[case]
    return f"{case}: {law.hook} · {law.place} · {law.variables[0]}"


def _short(text: str, most: int = 220) -> str:
    plain = text.replace("|", "¦")
    return plain if len(plain) <= most else plain[:most] + f" … ({len(plain)} characters)"


def _cell(row: Row | None) -> str:
    if row is None:
        return "—"
    return "fails" if row["error"] is None else f"{row['error']:.2f}"


CAMPAIGN = Campaign(__doc__, plan, ask, table)
