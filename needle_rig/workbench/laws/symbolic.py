"""PySR (Cranmer, arXiv:2305.01582), optional: short formulas of a learnt curve, beside our own forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import install_command
from needle_rig.workbench.laws.curve import BAND_SIGMAS
from needle_rig.workbench.laws.learnt import LearntLaw

BINARY = ("+", "-", "*", "/")
UNARY = ("sin", "cos", "exp", "abs")
LONGEST = 20
"""Operators, constants and variables of a formula."""
ITERATIONS = 40
SMALLEST = 1e-6
"""Standard deviation that a curve has at least, as a share of its size."""


@dataclass(frozen=True)
class SymbolicFormula:
    """A formula that PySR found, in the unit of the curve."""

    text: str
    error: float
    """Root mean square difference from the curve, in units of its standard deviation."""
    radians: bool
    """Whether v is in radians: an angle is, as sines want it."""

    def sentence(self) -> str:
        """For a person."""
        unit = ", v in radians" if self.radians else ""
        return f"PySR: {self.text}{unit}; {self.error:.1f} × the curve's uncertainty off"


def regressor() -> Callable[..., Any]:
    """PySR's regressor. Raises BadInput where it or the Julia that it runs on is not to be had."""
    try:
        from pysr import PySRRegressor
    except ImportError as error:
        raise BadInput(f"PySR cannot be used ({error}); {install_command('pysr')}") from error
    except Exception as error:
        # at its first import it looks for Julia, and fetches it where there is none
        raise BadInput(
            f"PySR cannot be used, for Julia cannot be had ({error}): install Julia, and try again"
        ) from error
    return PySRRegressor  # type: ignore[no-any-return]


def settings(seed: int = 0) -> dict[str, Any]:
    """What PySR is asked for: four operations, four functions, and the same answer each time."""
    return {
        "binary_operators": list(BINARY),
        "unary_operators": list(UNARY),
        "maxsize": LONGEST,
        "niterations": ITERATIONS,
        "model_selection": "best",
        "parallelism": "serial",
        "deterministic": True,
        "random_state": seed,
        "progress": False,
        "verbosity": 0,
        "temp_equation_file": True,
    }


def formula_of(make: Callable[..., Any], law: LearntLaw) -> SymbolicFormula:
    """The formula that PySR finds best for a law's curve where data are; `make` is what `regressor` gives."""
    curve = law.curve
    there = curve.data > 0
    angle = law.law.variable_unit == "°"
    v = (np.radians(curve.at) if angle else curve.at)[there]
    sigma = (curve.high - curve.low)[there] / (2.0 * BAND_SIGMAS)
    sigma = np.maximum(sigma, SMALLEST * (float(np.abs(curve.value).max()) or 1.0))
    model = make(**settings())
    model.fit(v[:, None], curve.value[there], weights=sigma**-2, variable_names=["v"])
    best = model.get_best()
    left = (np.asarray(model.predict(v[:, None])).ravel() - curve.value[there]) / sigma
    return SymbolicFormula(str(best["equation"]), float(np.sqrt(np.mean(left**2))), angle)
