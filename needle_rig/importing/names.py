"""What columns are called in laboratories, and what the name says of their role."""

from __future__ import annotations

import re

from needle_rig.importing.unit_text import split_name

TIME = re.compile(
    r"(t|x_?value|.*(time|zeit|stamp|recorded at|elapsed|clock|uhrzeit|datum|date|secs?|seconds|tiempo).*)"
)
TORQUE = re.compile(
    r".*(torque|torsion|moment|effort|load_?cell|futek|drehm|\bmd?z?\b|\btz\b|\btau|m_?z\b|tq|τ|par\b).*"
)
ANGLE = re.compile(
    r".*(angle|angular|theta|phi|rot|enc|hall|position|\bpos\b|winkel|yaw|roll|twist|orient|q\d*\b|deg|θ|φ|ϕ|α).*"
)
BASE = re.compile(
    r".*(base|motor|drive|driven|proximal|\bprox|encoder|enc\b|input|spindle|stage|hub|chuck|collet|"
    r"back.?end|antrieb|\bq_?0\b|actuator|theta_?[0mb]\b).*"
)
SENSOR = re.compile(
    r".*(hall|tip|distal|\bdist|camera|cam\b|marker|needle|sensor|output|front.?end|shaft|imu|spitze|track|probe|"
    r"h_?\d|mag\d).*"
)
TIP = re.compile(r".*(tip|distal|jaw|front.?end|gripper|load.?side|spitze).*")
COMMAND = re.compile(
    r".*(cmd|command|target|set.?p|setpoint|desired|\bref\b|reference|goal|soll|demand|trajectory|wish).*"
)
OTHER = re.compile(
    r".*(vel|speed|omega|\brate|volt|v_?supply|v_?bus|temp|depth|index|counter|count$|sample|"
    r"accel|pwm|status|flag|comment|error|seq|row|\bm[xy]\b|\bt[xy]\b|\bf[xy]\b|\bu_?[qd]\b).*"
)
FORCE = re.compile(r"(.*(force|kraft).*|f_?z)")
CURRENT = re.compile(r".*(current|curr\b|strom|\bi_?q\d?\b|\bamps?\b).*")
RATE = re.compile(r".*(vel|speed|omega|\brate|drehzahl|\bd?q?dot\b|rpm).*")
"""Of what turns or slides."""
TRIAL = re.compile(
    r"(trial|run|cycle|rep|repetition|versuch|segment|block|experiment|test)s?[\s_-]?(id|no|nr|num|number|index)?\.?"
)


def plain(name: str) -> str:
    """The name without its unit and place, in small letters, words apart."""
    stem = split_name(name)[0].replace("\\", "/")
    stem = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", stem)
    return re.sub(r"[_/.:\-\s]+", " ", stem).strip().lower()


def says(name: str, pattern: re.Pattern[str]) -> bool:
    """Whether the name is one of the pattern's; a group or topic that it stands in counts as a part of it."""
    text = plain(name)
    return bool(pattern.fullmatch(text) or pattern.fullmatch(text.replace(" ", "_")))


def is_base(name: str) -> bool:
    """Whether the name is that of the base; its last part counts before the group that it stands in."""
    for text in (re.split(r"[/.]", split_name(name)[0])[-1], name):
        base, sensor = says(text, BASE), says(text, SENSOR)
        if base or sensor:
            return base and not sensor
    return False


def numbers_in(name: str) -> tuple[int, ...]:
    """Numbers in a name, to put `hall_2` before `hall_10`."""
    return tuple(int(n) for n in re.findall(r"\d+", split_name(name)[0]))
