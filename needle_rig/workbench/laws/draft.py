"""The effect file of a law: ordinary contract, readable, a person's to rename and edit."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from needle_rig.numerics import Array
from needle_rig.workbench.laws.formulas import Formula, scaled_size, spelled
from needle_rig.workbench.laws.law import UNIT, Law
from needle_rig.workbench.laws.spline_effect import LEAST_FACTOR

MOST = 100.0
"""Times the fitted size that a coefficient may have."""
WIDTH = 96


@dataclass(frozen=True)
class Table:
    """A curve at points, in the units of its axes; straight between them, constant beyond."""

    at: Array
    values: Array


@dataclass(frozen=True)
class Field:
    """A parameter of the drafted effect."""

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    shapes: bool
    smallest: float


@dataclass(frozen=True)
class Origin:
    """Where a law was learnt."""

    dataset: str
    sha256: str
    date: str

    def sentence(self) -> str:
        """As it stands in the file."""
        return f"learnt from {self.dataset}, sha256 {self.sha256[:16]}, {self.date}"


def field_name(name: str, unit: str) -> str:
    """A field's name with its unit."""
    return name + UNIT[unit][1]


def written(
    path: Path,
    law: Law,
    curve: Formula | Table,
    origin: Origin,
    sections_m: Sequence[tuple[float, float]],
    visible: float = 0.1,
) -> Path:
    """The file at `path`, made. `visible` is the share of the curve's size from which it matters."""
    path.write_text(source(path.stem, law, curve, origin, sections_m, visible), encoding="utf-8")
    return path


def source(
    name: str,
    law: Law,
    curve: Formula | Table,
    origin: Origin,
    sections_m: Sequence[tuple[float, float]],
    visible: float = 0.1,
) -> str:
    """The text of the effect file."""
    fields = _fields(law, curve, visible) + _play(law)
    body = _hook(law, curve, sections_m)
    constants = _constants(law, curve)
    words = law.words()
    title = words[0].upper() + words[1:]
    head = _paragraph(f"{title}.") + "\n\n" + _paragraph(f"Law: {_law_text(law, curve)}")
    told = (
        "of Hall sensors, torque and base" if law.hook != "observe" else "of the reading against the others"
    )
    best = f"Shows best: trials that cover the range of {_axis(law)} in both directions, {told}."
    text = f'"""{head}\n\n{_paragraph(f"Source: {origin.sentence()}.")}\n\n{_paragraph(best)}\n"""\n\n'
    declared = "\n".join(_declared(f) for f in fields)
    klass = "".join(part.capitalize() for part in name.split("_")) or "Learnt"
    if not klass.isidentifier():
        klass = f"Law{klass}"
    blocks = [text + _imports(law, curve, body)]
    if constants:
        blocks[0] += "\n" + constants
    blocks.append(
        f'@dataclass(frozen=True)\nclass {klass}(Effect):\n    """{title}."""\n\n{declared}\n\n{body}'
    )
    return "\n\n\n".join(block.rstrip("\n") for block in blocks) + "\n"


def _axis(law: Law) -> str:
    return law.words().rpartition(" depends on ")[2]


def _law_text(law: Law, curve: Formula | Table) -> str:
    what = {
        "torque": "τ = f(v) per length of tissue",
        "drive": "θ_needle = θ_base + f(v) − f(v at the start)",
        "observe": "reading = truth + f(v)",
        "shape": "value = value without it · (1 + f(v))",
    }[law.hook]
    if law.kind == "gain":
        what = "reading = truth · (1 + f(v))"
    if law.place == "stiffness":
        what = "angle from balance to slip = f(v)"
    if isinstance(curve, Table):
        f = f"f = strength · a table over {curve.at[0]:g} to {curve.at[-1]:g} {law.variable_unit}"
    else:
        f = f"f(v) = {formula_text(curve)}"
    unit = "" if law.variable_unit == "1" else f" in {law.variable_unit}"
    return f"{what}, {f}; v is {_axis(law)}{unit}."


def formula_text(formula: Formula) -> str:
    """A formula with its numbers, in words of mathematics."""
    text = formula.form.text.replace("RAD * ", "").replace(" ** ", "**")
    known = {**formula.parameters, "reach": formula.reach, "low": formula.low}
    for name, value in sorted(known.items(), key=lambda item: -len(item[0])):
        text = _replaced(text, name, f"{value:.4g}")
    return text.replace("*", "·").replace("··", "^").replace("+ -", "− ").replace("- -", "+ ")


def _replaced(text: str, name: str, value: str) -> str:
    return re.sub(rf"(?<![.\w]){name}(?!\w|\()", value, text)


def _fields(law: Law, curve: Formula | Table, visible: float) -> list[Field]:
    if isinstance(curve, Table):
        return [Field("strength", 1.0, -MOST, MOST, "1", False, visible)]
    found = []
    form = curve.form
    largest = max(abs(scaled_size(curve, c)) for c in form.coefficients)
    for c in form.coefficients:
        size = scaled_size(curve, c)
        most = MOST * largest
        found.append(
            Field(field_name(c, law.unit), size, -most, most, law.unit, False, min(visible * largest, most))
        )
    for shape, kind in form.shapes:
        value = curve.parameters[shape]
        if kind == "times":
            found.append(Field(shape, value, 0.1, 20.0, "1", True, 0.0))
        elif kind == "width":
            unit = law.variable_unit
            found.append(Field(field_name(shape, unit), value, value / MOST, value * MOST, unit, True, 0.0))
        else:
            unit = law.variable_unit
            found.append(
                Field(
                    field_name(shape, unit),
                    value,
                    curve.low - curve.reach,
                    curve.reach * 2.0,
                    unit,
                    True,
                    0.0,
                )
            )
    return found


def _play(law: Law) -> list[Field]:
    if law.kind != "play":
        return []
    return [Field("play_deg", law.play_deg, law.play_deg / MOST, law.play_deg * MOST, "°", True, 0.0)]


def _declared(field: Field) -> str:
    lower, upper = _number(field.lower), _number(field.upper)
    off = _number(field.value) if field.shapes else "0.0"
    lines = [
        f"    {field.name}: float = parameter(",
        f"        off={off},",
        f"        lower={lower},",
        f"        upper={upper},",
        f"        typical={_number(field.value)},",
        f"        smallest={_number(field.smallest)},",
        f"        literature=({lower}, {upper}),",
        f'        unit="{field.unit}",',
    ]
    if field.shapes:
        lines.append("        shapes=True,")
    return "\n".join([*lines, "    )"])


def _assigned(before: str, terms: str) -> list[str]:
    """A statement, its sum on several lines where it is long."""
    if len(before) + len(terms) < WIDTH:
        return [f"{before}{terms}"]
    first, *others = terms.split(" + ")
    return [f"{before}(", f"    {first}", *(f"    + {term}" for term in others), ")"]


def _number(value: float) -> str:
    return repr(float(f"{value:.7g}"))


def _constants(law: Law, curve: Formula | Table) -> str:
    if not isinstance(curve, Table):
        return ""
    at = _wrapped("AT", curve.at)
    words = f'"""Points of the table, in {law.variable_unit}."""'
    values = _wrapped("VALUES", curve.values)
    return f'\n{at}\n{words}\n{values}\n"""The curve at strength 1, in {law.unit}."""\n'


def _wrapped(name: str, values: Array) -> str:
    numbers = ", ".join(
        f"{v:.6g}" if "." in f"{v:.6g}" or "e" in f"{v:.6g}" else f"{v:.6g}.0" for v in values
    )
    body = textwrap.fill(numbers + ",", WIDTH, initial_indent="    ", subsequent_indent="    ")
    return f"{name} = (\n{body}\n)"


def _paragraph(text: str) -> str:
    return textwrap.fill(text, WIDTH, break_long_words=False, break_on_hyphens=False)


def _fielded(law: Law, curve: Formula, functions: str) -> str:
    """The formula with the effect's fields and its constants, of v."""
    text = spelled(curve.form, functions)
    for c in curve.form.coefficients:
        text = _replaced_field(text, c, field_name(c, law.unit))
    for shape, kind in curve.form.shapes:
        if kind != "times":
            text = _replaced_field(text, shape, field_name(shape, law.variable_unit))
    for name, value in (("reach", curve.reach), ("low", curve.low)):
        text = _replaced(text, name, _number(value))
    return text.replace("RAD * ", "RAD_PER_DEG * ")


def _replaced_field(text: str, name: str, field: str) -> str:
    return re.sub(rf"self\.{name}(?!\w)", f"self.{field}", text)


_TO_SI = {
    "°": "RAD_PER_DEG",
    "°/s": "RAD_PER_DEG",
    "N·mm": "NM_PER_NMM",
    "N·mm per 100 mm": "N_PER_NMM_PER_100MM",
    "mm": "M_PER_MM",
}


def _shown(expression: str, unit: str) -> str:
    """An SI expression in the unit of the curve's axis."""
    return f"{expression} / {_TO_SI[unit]}" if unit in _TO_SI else expression


def _in_si(expression: str, unit: str) -> str:
    return f"{expression} * {_TO_SI[unit]}" if unit in _TO_SI else expression


_OF_TRIAL = {
    "base_angle": "{}.base_angle_rad",
    "rate": "rate_rad_s({})",
    "travel": "travel_rad({})",
    "forward": "forward_travel_rad({})",
    "backward": "backward_travel_rad({})",
    "stop_time": "stop_time_s({})",
    "clock": "clock_s({})",
    "direction": "direction({})",
}


def _hook(law: Law, curve: Formula | Table, sections_m: Sequence[tuple[float, float]]) -> str:
    hook = {"torque": _torque, "observe": _observe, "drive": _drive, "shape": _shape}[law.hook]
    return textwrap.indent(hook(law, curve, sections_m), "    ")


def _method(law: Law, curve: Formula | Table) -> str:
    """The curve as a method of arrays."""
    if isinstance(curve, Table):
        lines = ["return self.strength * np.interp(v, AT, VALUES)"]
    else:
        lines = _assigned("return ", f"{_fielded(law, curve, 'np')} + 0.0 * v")
    body = textwrap.indent("\n".join(lines), "    ")
    unit = "" if law.variable_unit == "1" else f" in {law.variable_unit}"
    given = "1" if law.unit == "1" else law.unit
    return f'def _curve(self, v: Array) -> Array:\n    """In {given}, of {_axis(law)}{unit}."""\n{body}'


def _observe(law: Law, curve: Formula | Table, sections_m: Sequence[tuple[float, float]]) -> str:
    del sections_m
    own = "reading.torque_nm" if law.place == "torque" else "hall_rad[:, k]"
    v = {
        "torque": "reading.torque_nm",
        "angle": own,
        "twist": "(hall_rad[:, k] - reading.trial.base_angle_rad)",
    }.get(law.variable) or _of_trial(law, "reading.trial")
    state = ""
    before = []
    if law.kind == "play":
        before = [f"ahead_rad, held_rad = left_behind_rad({own}, self.play_deg * RAD_PER_DEG, reading.state)"]
        v, state = "ahead_rad", ", state=held_rad"
    added = f"self._curve({_shown(v, law.variable_unit)})"
    added = f"{own} * {added}" if law.kind == "gain" else _in_si(added, law.unit)
    if law.place == "torque":
        told = "Add the error to the torque reading."
        lines = [f"added_nm = {added}", "return replace(reading, torque_nm=reading.torque_nm + added_nm)"]
    else:
        which = "range(hall_rad.shape[1])" if law.number is None else f"({law.number},)"
        told = f"Add the error to the reading of {'every sensor' if law.number is None else law.place}."
        lines = [
            "hall_rad = reading.hall_rad.copy()",
            f"for k in {which}:",
            *(f"    {line}" for line in before),
            f"    hall_rad[:, k] += {added}",
            f"return replace(reading, hall_rad=hall_rad{state})",
        ]
    body = textwrap.indent("\n".join(lines), "    ")
    observe = f'def observe(self, reading: Reading) -> Reading:\n    """{told}"""\n{body}'
    return f"{observe}\n\n{_method(law, curve)}\n"


def _of_trial(law: Law, trial: str) -> str:
    return _OF_TRIAL[law.variable if law.kind in ("plain", "gain") else law.kind].format(trial)


def _drive(law: Law, curve: Formula | Table, sections_m: Sequence[tuple[float, float]]) -> str:
    del sections_m
    v = _shown(_of_trial(law, "trial"), law.variable_unit)
    start = "trial.start_s" if law.variable == "clock" else "0.0"
    lines = [
        "def drive(self, trial: Trial) -> Array:",
        '    """Add what lies between encoder and needle; a trial begins relaxed."""',
        f"    added = self._curve({v}) - self._curve(np.array([{start}]))",
        f"    return trial.base_angle_rad + {_in_si('added', law.unit)}",
    ]
    return "\n".join(lines) + f"\n\n{_method(law, curve)}\n"


def _shape(law: Law, curve: Formula | Table, sections_m: Sequence[tuple[float, float]]) -> str:
    del sections_m
    if law.place == "rigidity":
        lines = [
            "middle_m = 0.5 * (rod.position_m[1:] + rod.position_m[:-1])",
            f"factor = np.maximum(1.0 + self._curve({_shown('middle_m', 'mm')}), {LEAST_FACTOR})",
            "return replace(rod, stiffness_nm_per_rad=rod.stiffness_nm_per_rad * factor)",
        ]
        told = "Scale the rigidity of each piece."
    else:
        places = {
            "x": "rod.position_m / M_PER_MM",
            "clock": "np.full(rod.position_m.shape, trial.start_s)",
            "trial": "np.full(rod.position_m.shape, float(trial.index))",
            "travel": "np.full(rod.position_m.shape, trial.travel_before_rad / RAD_PER_DEG)",
        }
        lines = [f"v = {places[law.variable]}", "tissue = rod.tissue_length_m > 0"]
        if law.place == "stiffness":
            lines += [
                "given_rad = np.maximum(self._curve(v), 0.0) * RAD_PER_DEG",
                "limit_nm = np.where(tissue & (rod.slip_plus_nm > 0), rod.slip_plus_nm, np.inf)",
                "return replace(rod, compliance_rad_per_nm=rod.compliance_rad_per_nm + given_rad / limit_nm)",
            ]
            told = "Add a compliance that gives so far at the slip limit."
        else:
            lines += [
                f"factor = np.where(tissue, np.maximum(1.0 + self._curve(v), {LEAST_FACTOR}), 1.0)",
                "plus_nm, minus_nm = rod.slip_plus_nm * factor, rod.slip_minus_nm * factor",
                "return replace(rod, slip_plus_nm=plus_nm, slip_minus_nm=minus_nm)",
            ]
            told = "Scale both slip limits in tissue."
    body = textwrap.indent("\n".join(lines), "    ")
    shape = f'def shape(self, rod: Rod, trial: Trial) -> Rod:\n    """{told}"""\n{body}'
    return f"{shape}\n\n{_method(law, curve)}\n"


def _torque(law: Law, curve: Formula | Table, sections_m: Sequence[tuple[float, float]]) -> str:
    argument = {"angle": "angle_rad", "rate": "rate_rad_s", "x": "position_m"}[law.variable]
    lines = []
    if law.number is not None:
        start_m, end_m = sections_m[law.number]
        lines += [f"if not {start_m:.7g} <= position_m <= {end_m:.7g}:", "    return 0.0"]
    lines.append(f"v = {_shown(argument, law.variable_unit)}")
    if isinstance(curve, Table):
        step = (curve.at[-1] - curve.at[0]) / (curve.at.size - 1)
        lines += [
            f"place = min(max((v - AT[0]) / {_number(float(step))}, 0.0), {curve.at.size - 1}.0)",
            f"k = min(int(place), {curve.at.size - 2})",
            "value = self.strength * (VALUES[k] + (place - k) * (VALUES[k + 1] - VALUES[k]))",
        ]
    else:
        lines += _assigned("value = ", _fielded(law, curve, "math"))
    lines.append(f"return {_in_si('value', law.unit)}")
    body = textwrap.indent("\n".join(lines), "    ")
    arguments = "self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float"
    return f'def torque({arguments}) -> float:\n    """Torque on the needle."""\n{body}\n'


_TOLD = (
    "backward_travel_rad",
    "clock_s",
    "direction",
    "forward_travel_rad",
    "left_behind_rad",
    "rate_rad_s",
    "stop_time_s",
    "travel_rad",
)


def _imports(law: Law, curve: Formula | Table, body: str) -> str:
    lines = []
    if "math." in body:
        lines.append("import math")
    names = "dataclass, replace" if "replace(" in body else "dataclass"
    lines.append(f"from dataclasses import {names}")
    lines.append("")
    if "np." in body:
        lines += ["import numpy as np", ""]
    arrays = "Array" in body
    wanted = [n for n in ("Reading", "Trial") if n in body]
    if arrays:
        lines.append("from needle_rig.numerics import Array")
    lines.append(f"from needle_rig.physics.effect import {', '.join(['Effect', *wanted, 'parameter'])}")
    if "Rod" in body:
        lines.append("from needle_rig.physics.rod import Rod")
    told = [name for name in _TOLD if re.search(rf"(?<!\w){name}\(", body)]
    if told:
        lines.append(f"from needle_rig.physics.trial_variables import {', '.join(told)}")
    units = [n for n in ("M_PER_MM", "NM_PER_NMM", "N_PER_NMM_PER_100MM", "RAD_PER_DEG") if _word(n, body)]
    if units:
        lines.append(f"from needle_rig.units import {', '.join(units)}")
    del law, curve
    return "\n".join(lines) + "\n"


def _word(name: str, text: str) -> bool:
    return re.search(rf"(?<!\w){name}(?!\w)", text) is not None
