"""What a strategy is: settled measurements in, next waypoint or done out.

One file each in `strategies`, or one of one's own in `config/strategies`.

A strategy is a frozen dataclass whose fields are its options, in the units that people give them (degrees,
the unit in the name). It keeps no memory: `next` is a function of the task and of the settled motions so far,
so a run can be replayed from its record.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import importlib
import inspect
import math
import pkgutil
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar

from needle_rig.config.own_things import Library, folders_of, library
from needle_rig.config.python_file import the_subclass
from needle_rig.control.ranges import check_option
from needle_rig.errors import BadInput
from needle_rig.physics.rod import Layout

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel

METHODS: Mapping[str, tuple[str, ...]] = {
    "next": ("self", "task", "history"),
    "expected_motions": ("self",),
}
"""What a strategy must define."""
NAME = re.compile(r"[a-z0-9_]{1,64}")
"""What an order may call a strategy."""


@dataclass(frozen=True)
class Dither:
    """A sine on top of a motion: amplitude of the base angle, frequency."""

    amplitude_rad: float
    frequency_hz: float


class Reason(enum.StrEnum):
    """Why a motion is made."""

    STRATEGY = "strategy"
    """It is the strategy's own way."""
    MODEL_DOUBTED = "model_doubted"
    """What was measured is too far from what any likely needle of the model gives."""
    EFFORT_SPENT = "effort_spent"
    """The model takes more solves than a plan may spend."""


@dataclass(frozen=True)
class Waypoint:
    """One motion: where the base goes, how fast, and what the motion is called.

    None stands for the speed and the settling time of the task.
    """

    angle_rad: float
    name: str
    speed_rad_s: float | None = None
    settle_s: float | None = None
    dither: Dither | None = None
    reason: Reason = Reason.STRATEGY
    note: str = ""
    """What the strategy expects of this motion, for a person."""


@dataclass(frozen=True)
class SettledMotion:
    """The rig after one motion came to rest: means over the torque window.

    `index` 0 is the rest before the first motion. `predicted_lag_rad` is the lag of the tip behind the base
    that the torque stands for by (5)–(7), (9); `tip_lag_rad` is base minus last Hall angle, as measured;
    `moved_s` is when the motion began and `time_s` the end of the window, on the clock of the measurements.
    """

    index: int
    name: str
    moved_s: float
    time_s: float
    waypoint_rad: float
    base_angle_rad: float
    torque_nm: float
    hall_rad: tuple[float, ...]
    predicted_lag_rad: float
    tip_lag_rad: float
    reason: Reason = Reason.STRATEGY
    """Why it was made."""


History = tuple[SettledMotion, ...]


@dataclass(frozen=True)
class Trust:
    """What a model file says of its own model: uncertainties by parameter, and how well it predicted.

    `error_over_floor` is the largest error on runs that were held out of its fit, over the floor that
    noise sets; None where the file tells of none.
    """

    uncertainties: Mapping[str, float] = field(default_factory=dict)
    error_over_floor: float | None = None


@dataclass(frozen=True)
class Task:
    """What a strategy may know: the target, the rig, and what the last run left."""

    target_rad: float
    layout: Layout
    torsional_rigidity_nm2: float
    speed_rad_s: float
    settle_s: float
    angle_limit_rad: float = math.inf
    velocity_limit_rad_s: float = math.inf
    acceleration_limit_rad_s2: float = math.inf
    tick_hz: float = math.inf
    """How often the base's setpoint is renewed."""
    model: NeedleModel | None = None
    trust: Trust = field(default_factory=Trust)
    lag_left_rad: float | None = None
    """Tip lag left by the run before."""
    extra_before_deg: float = 0.0
    """Extra turn that the run before used."""

    def pace(self, waypoint: Waypoint | None) -> tuple[float, float]:
        """Speed (rad/s) and settling time (s) of a motion: its own where it says so, else the task's."""
        speed = None if waypoint is None else waypoint.speed_rad_s
        settle = None if waypoint is None else waypoint.settle_s
        return self.speed_rad_s if speed is None else speed, self.settle_s if settle is None else settle


class Strategy:
    """Base of all strategies; subclasses are frozen dataclasses."""

    name: ClassVar[str] = ""
    """The file's name; set when the file is found."""

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The next motion, or None when the sequence is over.

        `history[0]` is the rest before the first motion, `history[-1]` what just settled.
        """
        raise NotImplementedError

    def check(self, task: Task) -> None:
        """Raise BadInput when the task cannot be done with these options; asked before anything moves."""

    def extra_used_deg(self, task: Task) -> float:  # noqa: ARG002 some strategies look at it
        """Extra turn that this strategy adds to the first correction, for runs that learn from it."""
        return 0.0

    def expected_motions(self) -> int:
        """How many motions the sequence will take, for progress; an estimate."""
        raise NotImplementedError


def sentence(kind: type[Strategy]) -> str:
    """What a strategy does, for a person who sees none of its options: the first line of its docstring."""
    return (inspect.getdoc(kind) or kind.name).splitlines()[0]


def find_strategies() -> Library[type[Strategy]]:
    """Every strategy by the name of its file: the shipped ones, then one's own; broken ones are named."""
    return library("strategies", shipped_strategies(), folders_of("strategies"), strategy_in)


@functools.cache
def shipped_strategies() -> Mapping[str, type[Strategy]]:
    """The strategies that come with the package, by name."""
    from needle_rig.control import strategies

    folder = Path(strategies.__path__[0])
    names = sorted(module.name for module in pkgutil.iter_modules(strategies.__path__))
    return {
        name: strategy_in(importlib.import_module(f"{strategies.__name__}.{name}"), folder / f"{name}.py")
        for name in names
    }


def strategy_in(module: ModuleType, path: Path) -> type[Strategy]:
    """The one strategy that `module` defines, checked and named. Raises BadInput with file and line."""
    found: type[Strategy] = the_subclass(module, Strategy, "a strategy", path)
    place = f"{path}:{inspect.getsourcelines(found)[1]}: {found.__name__}"
    options = getattr(found, "__dataclass_params__", None)
    if options is None or "__dataclass_fields__" not in vars(found) or not options.frozen:
        raise BadInput(f"{place} is not a frozen dataclass; put @dataclass(frozen=True) above it")
    for option in dataclasses.fields(found):  # type: ignore[arg-type]
        if option.default is dataclasses.MISSING and option.default_factory is dataclasses.MISSING:
            raise BadInput(f"{place}: the option {option.name} has no default; give it one")
    for method, wanted in METHODS.items():
        own = getattr(found, method)
        if own is getattr(Strategy, method):
            raise BadInput(f"{place} has no {method}; define {method}({', '.join(wanted)})")
        if len(inspect.signature(own).parameters) != len(wanted):
            line = inspect.getsourcelines(own)[1]
            raise BadInput(f"{path}:{line}: {method} must be def {method}({', '.join(wanted)})")
    if not NAME.fullmatch(path.stem):
        raise BadInput(f"{path}:1: {path.stem} is no name for orders; use a to z, 0 to 9 and _, up to 64")
    found.name = path.stem
    return found


def make_strategy(name: str, options: Mapping[str, Any]) -> Strategy:
    """The strategy called `name` with `options` as its fields; BadInput names what is unknown."""
    found = find_strategies()
    try:
        kind = found[name]
    except KeyError:
        raise BadInput(
            f"strategy {name!r} is unknown; there are {', '.join(found)};"
            f" one of your own is a file config/strategies/{name}.py"
        ) from None
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    for option in options:
        if option not in fields:
            known = ", ".join(sorted(fields)) or "none"
            raise BadInput(f"strategy {name} has no option {option!r}; its options: {known}")
        if isinstance(options[option], bool) and fields[option].type not in ("bool", bool):
            raise BadInput(f"strategy {name}: {option} is {str(options[option]).lower()}; give a number")
        if not isinstance(options[option], str) or fields[option].type not in ("str", str):
            check_option(option, options[option])
    try:
        return kind(**options)
    except TypeError:
        given = ", ".join(f"{option}={value!r}" for option, value in options.items())
        raise BadInput(f"strategy {name}: {given} has a value of the wrong kind; give numbers") from None
