"""Short formulas for a curve: named forms, ranked by description length against the spline.

A form is an expression in the variable v, in the unit of the curve's axis; `reach`, the largest |v| in the
data, and `low`, the smallest v, are numbers in it. Coefficients stand before a term and vanish with it;
shapes (where a step is, how wide) do not. Against the likelihood of a spline's coefficients c,
−2 log L(c) = cᵀGc − 2bᵀc, a formula's coefficients follow by least squares, its shapes from a grid and a
simplex; each parameter has its price (minimum description length: Rissanen, Automatica 14 (1978)).
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy.optimize import Bounds, minimize

from needle_rig.numerics import Array
from needle_rig.units import RAD_PER_DEG
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.spline import Quadratic, Spline
from needle_rig.workbench.laws.spline_effect import LEAST_FACTOR, SplineLaw

ShapeKind = Literal["place", "width", "times"]

GRID = 240
"""Points at which a formula and a spline are compared."""
PLACES = 41
WIDTHS = np.geomspace(0.02, 1.0, 10)
"""Shares of half the range."""
TIMES = tuple(range(1, 9))
ONE_SIDED = 0.05
"""Share of the largest value by which a variable of one sign may seem to be below 0."""
POLISHED = 0.1
"""Fall by which shapes may miss the best."""
FACTOR_STEPS = 4
"""Gauss–Newton steps of a factor's coefficients."""
SMALL = 0.02
"""Share of the largest coefficient that a coefficient is taken to be at least, when its size sets a scale."""


@dataclass(frozen=True)
class Form:
    """A named family of formulas."""

    name: str
    expression: str
    coefficients: tuple[str, ...]
    shapes: tuple[tuple[str, ShapeKind], ...] = ()
    periodic: bool = False
    """For angles alone."""
    even_or_odd: bool = False
    """A simpler form, mirrored: the same where the variable has one sign."""
    short: str = ""
    """The expression as a person writes it, where that is shorter."""

    @property
    def has_constant(self) -> bool:
        """Whether it has a constant beside or alone."""
        return "constant" in self.coefficients

    @property
    def text(self) -> str:
        """To be read."""
        return self.short or self.expression

    def with_constant(self) -> Form:
        """The same beside a constant."""
        return Form(
            f"constant and {self.name}",
            f"constant + {self.expression}",
            ("constant", *self.coefficients),
            self.shapes,
            self.periodic,
            self.even_or_odd,
            f"constant + {self.text}",
        )


_BEYOND = "0.5 * ({0} + abs({0})) / reach"
_SIMPLE = (
    Form("line", "line * v / reach", ("line",)),
    Form("square", "square * (v / reach) ** 2", ("square",)),
    Form("cube", "cube * (v / reach) ** 3", ("cube",)),
    Form("signed square", "square * v * abs(v) / reach**2", ("square",), even_or_odd=True),
    Form("absolute value", "size * abs(v) / reach", ("size",), even_or_odd=True),
    Form(
        "sine",
        "sine * sin(times * RAD * v) + cosine * cos(times * RAD * v)",
        ("sine", "cosine"),
        (("times", "times"),),
        periodic=True,
    ),
    Form("exponential", "size * exp(-(v - low) / scale)", ("size",), (("scale", "width"),)),
    Form("logarithm", "size * log(1.0 + abs(v) / scale)", ("size",), (("scale", "width"),)),
    Form("saturation", "size * v / (abs(v) + scale)", ("size",), (("scale", "width"),)),
    Form("step", "step * tanh((v - at) / (0.01 * reach))", ("step",), (("at", "place"),)),
    Form(
        "dead zone",
        "line * (v - 0.5 * (abs(v + dead) - abs(v - dead))) / reach",
        ("line",),
        (("dead", "width"),),
        short="line * (v - clip(v, -dead, dead)) / reach",
    ),
    Form(
        "limited line",
        "line * 0.5 * (abs(v + limit) - abs(v - limit)) / reach",
        ("line",),
        (("limit", "width"),),
        short="line * clip(v, -limit, limit) / reach",
    ),
    Form(
        "line beyond",
        f"line * {_BEYOND.format('(v - at)')}",
        ("line",),
        (("at", "place"),),
        short="line * max(v - at, 0) / reach",
    ),
    Form(
        "line below",
        f"line * {_BEYOND.format('(at - v)')}",
        ("line",),
        (("at", "place"),),
        short="line * max(at - v, 0) / reach",
    ),
    Form(
        "bump",
        "height * exp(-(((v - at) / width) ** 2))",
        ("height",),
        (("at", "place"), ("width", "width")),
    ),
)
FORMS = (Form("constant", "constant", ("constant",)), *_SIMPLE, *(form.with_constant() for form in _SIMPLE))


@dataclass(frozen=True)
class Formula:
    """A form with its numbers."""

    form: Form
    reach: float
    low: float
    values: tuple[float, ...]
    """Of the coefficients, then of the shapes."""

    @property
    def parameters(self) -> dict[str, float]:
        """By name."""
        names = (*self.form.coefficients, *(name for name, _ in self.form.shapes))
        return dict(zip(names, self.values, strict=True))

    def at(self, v: Array) -> Array:
        """The curve (n,) at (n,), in the units of its axes."""
        return np.broadcast_to(_evaluated(self.form, v, self.reach, self.low, self.parameters), v.shape)


@dataclass(frozen=True)
class RankedFormula:
    """A formula and what it costs, relative to no law at all; lower is better."""

    formula: Formula
    cost: float


def ranked(made: SplineLaw, quadratic: Quadratic, coefficients: Array, price: float) -> list[RankedFormula]:
    """The best formula of each form by cost: −2 log likelihood and `price` a parameter; best first.

    Forms of which the data see nothing are left out.

    The spline of a factor is of its logarithm: coefficients follow from it by Gauss–Newton steps, the first
    about the spline's own `coefficients`.
    """
    law, spline = made.law, made.spline
    v = np.linspace(spline.low, spline.high, GRID)
    basis = spline.basis(v)
    to_coefficients = np.asarray(np.linalg.pinv(basis), dtype=np.float64)
    factor = 1.0 + made.linked(basis @ coefficients)
    reach, low = _rounded(float(np.abs(v).max())), _rounded(spline.low)

    def best_of(form: Form, shapes: tuple[float, ...]) -> tuple[float, Array]:
        columns = _columns(form, v, reach, low, shapes)
        if not np.isfinite(columns).all():
            return -math.inf, np.zeros(columns.shape[1])
        if law.scales:
            return _fall_of_factor(quadratic, to_coefficients, columns, factor)
        return quadratic.fall(to_coefficients @ columns)

    found = []
    for form in FORMS:
        if not _fits(form, law) or (form.even_or_odd and spline.low > -ONE_SIDED * spline.high):
            continue
        best = partial(best_of, form)
        shapes = _polished(form, spline, best)
        fall, at = best(shapes)
        if math.isfinite(fall) and at.any():
            cost = price * (len(form.coefficients) + len(form.shapes)) - fall
            found.append(RankedFormula(Formula(form, reach, low, (*(float(a) for a in at), *shapes)), cost))
    return sorted(found, key=lambda each: each.cost)


def _polished(
    form: Form, spline: Spline, best: Callable[[tuple[float, ...]], tuple[float, Array]]
) -> tuple[float, ...]:
    """The shapes of the largest fall on the grid; places and widths go on from there."""

    def fall(shapes: tuple[float, ...]) -> float:
        return best(shapes)[0]

    start = max(_grid(form, spline), key=fall)
    kinds = [kind for _, kind in form.shapes]
    if not kinds or "times" in kinds:
        return start
    half = 0.5 * (spline.high - spline.low)
    widths = np.array([kind == "width" for kind in kinds])
    low = np.where(widths, math.log(half * WIDTHS[0]), spline.low)
    high = np.where(widths, math.log(half * WIDTHS[-1]), spline.high)

    def shapes(x: Array) -> tuple[float, ...]:
        return tuple(np.where(widths, np.exp(np.where(widths, x, 0.0)), x).tolist())

    x: Array = np.where(widths, np.log(np.where(widths, start, 1.0)), start)
    steps = np.where(widths, math.log(WIDTHS[1] / WIDTHS[0]), 2.0 * half / (PLACES - 1))
    simplex = np.clip(x + np.vstack([np.zeros(x.size), 0.5 * np.diag(steps)]), low, high)

    def cost(x: Array) -> float:
        return -fall(shapes(x))

    after = minimize(
        cost,
        x,
        method="Nelder-Mead",
        bounds=Bounds(low, high),
        options={"initial_simplex": simplex, "fatol": POLISHED},
    )
    return max(start, shapes(after.x), key=fall)


def _fall_of_factor(
    quadratic: Quadratic, to_coefficients: Array, columns: Array, factor: Array
) -> tuple[float, Array]:
    """How far a quadratic of the logarithm's coefficients (K,) falls for factors 1 + `columns` (n, m) times
    numbers, and these (m,); `factor` (n,) is where it begins."""
    best = -math.inf, np.zeros(columns.shape[1])
    for _ in range(FACTOR_STEPS):
        origin = to_coefficients @ (np.log(factor) - (factor - 1.0) / factor)
        _, at = quadratic.about(origin)[0].fall((to_coefficients / factor) @ columns)
        factor = np.maximum(1.0 + columns @ at, LEAST_FACTOR)
        _, fall = quadratic.about(to_coefficients @ np.log(factor))
        best = max(best, (fall, at), key=lambda each: each[0])
    return best


def _fits(form: Form, law: Law) -> bool:
    """Whether the form makes sense of the law."""
    if form.periodic and (law.variable not in ("angle", "base_angle") or law.kind == "play"):
        return False
    if law.kind == "gain":
        return form.name != "constant"  # the library has that
    # a drive counts from the start of the trial, a play from its middle; a constant factor is friction or
    # rigidity
    counted = law.hook == "drive" or law.place in ("slip_limit", "rigidity") or law.kind == "play"
    return not (form.has_constant and counted)


def scaled_size(formula: Formula, name: str) -> float:
    """A coefficient, or a size for it where it is next to none."""
    value = formula.parameters[name]
    largest = max(abs(formula.parameters[c]) for c in formula.form.coefficients)
    least = SMALL * largest
    return value if abs(value) >= least else math.copysign(least, value)


def spelled(form: Form, functions: str, fields: str = "self.") -> str:
    """The expression in Python, with the module that has its functions and what stands before a field."""
    text = re.sub(r"\b(sin|cos|exp|log|tanh)\(", rf"{functions}.\1(", form.expression)
    for name in (*form.coefficients, *(shape for shape, _ in form.shapes)):
        text = re.sub(rf"(?<![.\w]){name}(?!\w|\()", f"{fields}{name}", text)
    return text


def _columns(form: Form, v: Array, reach: float, low: float, shapes: tuple[float, ...]) -> Array:
    """What each coefficient stands before (n, m)."""
    count = len(form.coefficients)
    names = (*form.coefficients, *(name for name, _ in form.shapes))
    columns = []
    for row in np.eye(count):
        told = dict(zip(names, (*row.tolist(), *shapes), strict=True))
        columns.append(np.broadcast_to(_evaluated(form, v, reach, low, told), v.shape))
    return np.column_stack(columns)


def _evaluated(form: Form, v: Array, reach: float, low: float, values: dict[str, float]) -> Any:
    functions = {name: getattr(np, name) for name in ("sin", "cos", "exp", "log", "tanh", "abs")}
    known = {**functions, "RAD": RAD_PER_DEG, "v": v, "reach": reach, "low": low, **values}
    # one text for the ranking and for the effect's file
    return eval(_compiled(form.expression), {"__builtins__": {}}, known)


def _compiled(expression: str) -> Any:
    if expression not in _CODE:
        _CODE[expression] = compile(expression, "formula", "eval")
    return _CODE[expression]


_CODE: dict[str, Any] = {}


def _grid(form: Form, spline: Spline) -> Iterator[tuple[float, ...]]:
    half = 0.5 * (spline.high - spline.low)
    choices: dict[ShapeKind, list[float]] = {
        "place": np.linspace(spline.low, spline.high, PLACES)[1:-1].tolist(),
        "width": (half * WIDTHS).tolist(),
        "times": [float(n) for n in TIMES],
    }
    return itertools.product(*(choices[kind] for _, kind in form.shapes))


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
