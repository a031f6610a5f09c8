"""From an effect's `torque` method in plain Python to a compiled law of the rod.

The method sees its effect as a bare record of its fields, filled from the law's parameters at every call:
changing a value compiles nothing anew.
"""

from __future__ import annotations

import dis
import inspect
import re
from collections import namedtuple
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect
from needle_rig.physics.rod import Rod, TorqueLaw

NO_NUMBER = "it does not return a number in every case"
ARGUMENTS = ("angle_rad", "rate_rad_s", "time_s", "position_m")


def torque_law(effect: Effect, rod: Rod) -> TorqueLaw:
    """The law of `effect`, acting along the tissue of `rod`. Raises BadInput as `compiled_torque`."""
    values = np.array([getattr(effect, field) for field in effect.parameters()], dtype=np.float64)
    kind = type(effect)
    return TorqueLaw(compiled_torque(kind), values, rod.tissue_length_m, _is_steady(kind))  # type: ignore[arg-type]


@cache
def _is_steady(effect: type[Effect]) -> bool:
    """Whether the `torque` method reads neither its rate nor its time."""
    code = effect.torque.__code__
    _, _, rate, time, _ = code.co_varnames[: 1 + len(ARGUMENTS)]
    read = [i.argval if isinstance(i.argval, tuple) else (i.argval,) for i in dis.get_instructions(code)]
    return not any(rate in names or time in names for names in read)


def compiled_torque(effect: type[Effect]) -> Callable[..., float]:
    """The `torque` method of an effect class as machine code, compiled once.

    Raises BadInput with file and line when numba cannot compile it, or a field has one value per sensor or
    section (a law acts everywhere along the tissue with the same numbers).
    """
    if effect not in _laws:
        _laws[effect] = _compile(effect)
    return _laws[effect]


_laws: dict[type[Effect], Callable[..., float]] = {}


def _compile(effect: type[Effect]) -> Callable[..., float]:
    # numba takes longer to import than most models need that have no such effect
    import numba

    from needle_rig.physics.kernel.laws import LAW_SIGNATURE

    source = inspect.getsourcefile(effect.torque) or "?"
    first_line = inspect.getsourcelines(effect.torque)[1]
    for field, info in effect.parameters().items():
        if info.per != "one":
            raise BadInput(
                f"{source}:{first_line}: {field} has one value per {info.per}; the torque hook takes"
                " single numbers only"
            )
    fields = list(effect.parameters())
    record = namedtuple(effect.__name__, fields)  # type: ignore[misc]
    values = ", ".join(f"parameters[{i}]" for i in range(len(fields)))
    arguments = ", ".join(ARGUMENTS)
    namespace: dict[str, Any] = {
        "method": numba.njit(effect.torque, error_model="numpy"),
        "Record": record,
    }
    exec(  # numba needs one function with the solver's signature
        f"def law(parameters, {arguments}):\n    return method(Record({values}), {arguments})", namespace
    )
    try:
        law: Callable[..., float] = numba.cfunc(LAW_SIGNATURE, error_model="numpy")(namespace["law"])
    except Exception as error:  # noqa: BLE001 numba lets errors of many kinds through
        line, reason = _place(str(error), effect)
    else:
        # a missing return would become an exception inside the solver
        returned = namespace["method"].nopython_signatures[0].return_type
        if isinstance(returned, numba.types.Number | numba.types.Boolean):
            return law
        line, reason = first_line, NO_NUMBER
    raise BadInput(
        f"{source}:{line}: torque of {effect.name()} cannot be compiled: {reason};"
        " use its fields, numbers and functions of math"
    )


def _place(message: str, effect: type[Effect]) -> tuple[int, str]:
    """Line and reason in numba's long message: the last place in the file, or the name complained of."""
    plain = re.sub(r"\x1b\[[0-9;]*m", "", message)
    lines, first_line = inspect.getsourcelines(effect.torque)
    file = (inspect.getsourcefile(effect.torque) or "?").rpartition("/")[2]
    reason = next((text.strip() for text in plain.splitlines() if _REASON.search(text)), plain.split("\n")[0])
    if "No conversion" in reason and "return_value" in reason:
        return first_line, NO_NUMBER
    named = [int(n) for path, n in re.findall(r'File "([^"]*)", line (\d+)', plain) if path.endswith(file)]
    for name in re.findall(r"'(\w+)'", reason):
        named += [first_line + i for i, text in enumerate(lines) if i and re.search(rf"\b{name}\b", text)]
    return max(named, default=first_line), reason.rstrip(".:")


_REASON = re.compile(
    "Unknown attribute|Untyped global|NameError|No implementation|Cannot unify|Invalid use|Undecided type"
    "|[Uu]nsupported|No conversion|has no attribute|Cannot resolve"
)
