"""Torque laws as addresses of machine code, so that one compiled solver serves every law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from needle_rig.physics.kernel._compile import compiled
from needle_rig.physics.kernel.layout import FORCE, PLAY_TORQUE, POSITION, SLOPE

LAW_SIGNATURE = types.float64(
    types.CPointer(types.float64),
    *(types.float64,) * 4,
)
"""law(parameters, angle_rad, rate_rad_s, time_s, position_m) -> N·m per metre."""

_compiled: dict[Any, Any] = {}


def law_address(law: Callable[..., float]) -> int:
    """Address of the compiled `law`; compiles a Python or numba function once."""
    if hasattr(law, "address"):
        return int(law.address)
    plain = getattr(law, "py_func", law)
    if plain not in _compiled:
        _compiled[plain] = numba.cfunc(LAW_SIGNATURE)(plain)
    return int(_compiled[plain].address)


def _call_law(typing_context, address, parameters, angle_rad, rate_rad_s, time_s, position_m):
    """Call the law at `address` with the pointer `parameters` (an integer) and four floats."""
    signature = types.float64(
        types.int64, types.int64, types.float64, types.float64, types.float64, types.float64
    )

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        double = ir.DoubleType()
        pointer = cgutils.voidptr_t
        function = ir.FunctionType(double, [pointer, double, double, double, double])
        code = builder.inttoptr(arguments[0], function.as_pointer())
        return builder.call(code, [builder.inttoptr(arguments[1], pointer), *arguments[2:]])

    return signature, generate


call_law: Any = intrinsic(_call_law)


def _borrowed(typing_context, array):
    """The same array without a count of its references, which costs two locked additions a slice or call.

    Something else must keep it alive.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.return_type)(context, builder, value=arguments[0])
        view.meminfo = cgutils.get_null_value(view.meminfo.type)
        return view._getvalue()

    return array(array), generate


borrowed: Any = intrinsic(_borrowed)


@compiled
def tip_torque(drive, time):
    """Torque on the tip at `time`, N·m."""
    times, tip = drive.time_s, drive.tip_nm
    row, after = np.intp(0), np.intp(times.size - 1)
    if time <= times[0] or after == 0:
        return tip[0]
    while after - row > 1:
        middle = (row + after) // 2
        if times[middle] < time:
            row = middle
        else:
            after = middle
    fraction = min(1.0, (time - times[row]) / (times[after] - times[row]))
    return tip[row] + fraction * (tip[after] - tip[row])


@compiled
def linearise_laws(rod, laws, angle, angle_before, dt, time, chord, work):
    """Linearise the torque laws about `angle`: FORCE + SLOPE · θ. Returns the largest change at `angle`.

    With `chord` a law is as steep against the rate as its chord from rate 0, where that is steeper: a drag
    that levels off sends Newton's method from one side to the other, while these steps come near from one.
    FORCE also has what elements with play carry at no twist.
    """
    change = 0.0
    for i in range(angle.size):
        value = 0.0
        gradient = 0.0
        rate = (angle[i] - angle_before[i]) / dt
        for k in range(laws.addresses.size):
            weight = laws.weights_m[k, i]
            if weight == 0.0:
                continue
            a, p, x = laws.addresses[k], laws.parameters[k], rod[POSITION, i]
            here = call_law(a, p, angle[i], rate, time, x)
            by_angle = (call_law(a, p, angle[i] + 1e-7, rate, time, x) - here) / 1e-7
            step = 1e-7 * (1.0 + abs(rate))
            by_rate = (call_law(a, p, angle[i], rate + step, time, x) - here) / step
            if chord and rate != 0.0:
                by_rate = min(by_rate, (here - call_law(a, p, angle[i], 0.0, time, x)) / rate)
            value += weight * here
            gradient += weight * (by_angle + by_rate / dt)
        if i == angle.size - 1 and laws.drive.tip_nm.size > 0:
            value += tip_torque(laws.drive, time)
        of_play = (work[PLAY_TORQUE, i - 1] if i > 0 else 0.0) - work[PLAY_TORQUE, i]
        change = max(change, abs(work[FORCE, i] - of_play + work[SLOPE, i] * angle[i] - value))
        work[FORCE, i] = value - gradient * angle[i] + of_play
        work[SLOPE, i] = gradient
    return change
