"""A strategy behind its checks: what it says is held against the rig before anything moves by it.

A strategy is anybody's code. Whatever it answers or raises, what comes out here is a record of plain values
that the rig can carry out, or one sentence.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from needle_rig.control.ranges import (
    MOST_MOTIONS,
    SETTLE_S,
    SLOWEST_RAD_S,
    is_number,
    settle_fault,
    speed_fault,
)
from needle_rig.control.strategy import Dither, History, Reason, Strategy, Task, Waypoint
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.units import deg

Answer = TypeVar("Answer")

NAME_LETTERS = 64
"""Run files, logs and displays give a name one column."""
NOTE_LETTERS = 500
SHOWN_LETTERS = 60
TICKS_A_PERIOD = 4
"""A dither that is sampled less often than at its zeros and peaks looks like a slower one of another size."""
CORRECT = "correct the strategy, or choose another"


@dataclass(frozen=True)
class Checked(Strategy):
    """Any strategy, asked with care; each method raises BadInput or RigFault and nothing else."""

    inner: Strategy
    name: str  # type: ignore[misc]  # the classes of others have it from their files

    @classmethod
    def of(cls, strategy: Strategy) -> Checked:
        """The strategy behind checks; once is enough."""
        return strategy if isinstance(strategy, Checked) else cls(strategy, _name(strategy))

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The next motion in plain values, or None."""

        def judged() -> Waypoint | None:
            answer = self.inner.next(task, history)
            return None if answer is None else self._waypoint(answer, task, history)

        return self._asked(judged)

    def check(self, task: Task) -> None:
        """Ask whether the task can be done, and all else that is asked before anything moves."""
        self._asked(lambda: self.inner.check(task))
        self.expected_motions()
        self.extra_used_deg(task)

    def extra_used_deg(self, task: Task) -> float:
        """The extra turn in degrees, a finite number."""
        return self._asked(lambda: self._number(self.inner.extra_used_deg(task), "extra_used_deg"))

    def expected_motions(self) -> int:
        """How many motions are expected, a finite number that is not negative."""

        def judged() -> int:
            expected = self._number(self.inner.expected_motions(), "expected_motions")
            if expected < 0.0:
                raise self._refusal(f"expected_motions is {expected:g}, limit 0")
            return int(expected)

        return self._asked(judged)

    def _asked(self, ask: Callable[[], Answer]) -> Answer:
        try:
            return ask()
        except NeedleRigError as refusal:
            raise BadInput(_words(refusal)) from refusal
        except BaseException as error:
            # also what asks a process to end: nobody but the daemon's own signals may do that
            told = f"{type(error).__name__}: {_words(error)}".rstrip(": ")
            raise RigFault(f"strategy {self.name} failed with {told}; choose another") from error

    def _waypoint(self, answer: object, task: Task, history: History) -> Waypoint:
        number = len(history)
        if not isinstance(answer, Waypoint):
            raise self._refusal(f"motion {number} is {_shown(answer)}, not a Waypoint or None")
        if number > MOST_MOTIONS:
            raise self._refusal(f"it goes on after {MOST_MOTIONS} motions, the most of one sequence")
        name = self._text(answer.name, f"the name of motion {number}", NAME_LETTERS)
        if not name.strip():
            raise self._refusal(f"motion {number} has no name; give it one of letters")
        where = f"of motion {name}"
        if not isinstance(answer.reason, Reason):
            raise self._refusal(f"the reason {where} is {_shown(answer.reason)}, not a Reason")
        dither = self._dither(answer.dither, task, where)
        waypoint = Waypoint(
            angle_rad=self._angle_rad(answer.angle_rad, dither, task, name),
            name=name,
            speed_rad_s=self._maybe(answer.speed_rad_s, f"the speed {where}"),
            settle_s=self._maybe(answer.settle_s, f"the settling time {where}"),
            dither=dither,
            reason=answer.reason,
            note=self._text(answer.note, f"the note {where}", NOTE_LETTERS),
        )
        for fault in (
            waypoint.speed_rad_s is not None and speed_fault(waypoint.speed_rad_s, task.velocity_limit_rad_s),
            waypoint.settle_s is not None and settle_fault(waypoint.settle_s),
        ):
            if fault:
                raise self._refusal(f"in motion {name} {fault}")
        self._ends(waypoint, task, history)
        return waypoint

    def _angle_rad(self, value: object, dither: Dither | None, task: Task, name: str) -> float:
        angle_rad = self._number(value, f"the base angle of motion {name}")
        swing_rad = dither.amplitude_rad if dither else 0.0
        if abs(angle_rad) + swing_rad > task.angle_limit_rad:
            swing = f" ± {deg(swing_rad):g}°" if dither else ""
            raise BadInput(
                f"strategy {self.name} asks for a base angle of {deg(angle_rad):.1f}°{swing} in"
                f" motion {name}, outside ±{deg(task.angle_limit_rad):g}° (drive.angle_limit_deg);"
                " choose a target nearer to 0"
            )
        return angle_rad

    def _dither(self, value: object, task: Task, where: str) -> Dither | None:
        if value is None:
            return None
        if not isinstance(value, Dither):
            raise self._refusal(f"the dither {where} is {_shown(value)}, not a Dither or None")
        amplitude_rad = self._number(value.amplitude_rad, f"the amplitude of the dither {where}")
        frequency_hz = self._number(value.frequency_hz, f"the frequency of the dither {where}")
        if amplitude_rad < 0.0:
            raise self._refusal(f"the amplitude of the dither {where} is {deg(amplitude_rad):g}°, limit 0°")
        fastest_hz = task.tick_hz / TICKS_A_PERIOD
        if not 0.0 < frequency_hz <= fastest_hz:
            raise self._refusal(
                f"the frequency of the dither {where} is {frequency_hz:g} Hz, outside 0 to {fastest_hz:g} Hz"
                f" (tick_hz/{TICKS_A_PERIOD})"
            )
        peak_rad_s = amplitude_rad * math.tau * frequency_hz
        if peak_rad_s > task.velocity_limit_rad_s:
            raise self._refusal(
                f"the dither {where} turns at up to {deg(peak_rad_s):.0f}°/s, limit"
                f" {deg(task.velocity_limit_rad_s):g}°/s (drive.velocity_limit_deg_s)"
            )
        return Dither(amplitude_rad, frequency_hz)

    def _ends(self, waypoint: Waypoint, task: Task, history: History) -> None:
        """Refuse a motion that makes the sequence longer than the longest that an order can list.

        That is the most steps with the longest rests, and one way through the range at the slowest speed.
        """
        speed_rad_s, settle_s = task.pace(waypoint)
        travel_s = abs(waypoint.angle_rad - history[-1].base_angle_rad) / speed_rad_s
        lasts_s = history[-1].time_s - history[0].time_s + travel_s + settle_s
        longest_s = MOST_MOTIONS * SETTLE_S[1] + 2.0 * task.angle_limit_rad / SLOWEST_RAD_S
        if lasts_s > longest_s:
            raise self._refusal(
                f"with motion {waypoint.name} the sequence lasts {lasts_s / 3600.0:.1f} h, limit"
                f" {longest_s / 3600.0:.1f} h"
            )

    def _maybe(self, value: object, what: str) -> float | None:
        return None if value is None else self._number(value, what)

    def _number(self, value: Any, what: str) -> float:
        """A finite number, as a plain float."""
        if is_number(value):
            try:
                number = float(value)
            except OverflowError:
                number = math.inf
            if math.isfinite(number):
                return number
        raise self._refusal(f"{what} is {_shown(value)}, not a finite number")

    def _text(self, value: object, what: str, most_letters: int) -> str:
        if not isinstance(value, str) or not str.isprintable(value) or len(value) > most_letters:
            raise self._refusal(
                f"{what} is {_shown(value)}, not a printable text of up to {most_letters} letters"
            )
        return str(value)

    def _refusal(self, sentence: str) -> BadInput:
        return BadInput(f"strategy {self.name}: {sentence}; {CORRECT}")


def _name(strategy: Strategy) -> str:
    """What the strategy is called, or its class where that is no name."""
    try:
        name: Any = strategy.name
        if isinstance(name, str) and name.isprintable() and 0 < len(name) <= NAME_LETTERS:
            return str(name)
    except BaseException:  # noqa: BLE001 see Checked
        pass
    return type(strategy).__name__


def _shown(value: object) -> str:
    return _words(value, repr, SHOWN_LETTERS)


def _words(value: object, told: Callable[[object], str] = str, most_letters: int = NOTE_LETTERS) -> str:
    """Any object in one printable line, cut where it is long."""
    try:
        text = told(value)
    except BaseException:  # noqa: BLE001 see Checked
        text = f"a {type(value).__name__}"
    text = "".join(letter if letter.isprintable() else " " for letter in text[: most_letters + 1])
    return text if len(text) <= most_letters else f"{text[:most_letters]}…"
