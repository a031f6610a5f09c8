import io
import json
import math
import re
import sys
import time
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from needle_rig.cli._live import PhaseLines, moving_bar, phase_line, picture, screen
from needle_rig.cli._output import number, settled_table, tell_result
from needle_rig.config.loader import load_rig_config
from needle_rig.control.reports import BrainState
from needle_rig.control.strategy import SettledMotion
from needle_rig.records import DriveFault, DriveState, Measurement, Phase
from needle_rig.service.api.documents import State, Told
from needle_rig.service.tick import report
from needle_rig.units import rad

CONFIG = load_rig_config()
HALLS = (rad(25.4), rad(21.8), rad(19.7), rad(19.0))
MOTION = SettledMotion(1, "rotate", 0.5, 5.3, rad(45.0), rad(45.0), 1.007e-4, HALLS, rad(26.3), rad(26.0))
angle = st.floats(-1e4, 1e4)


def document(measurement: Measurement | None, phase: Phase = Phase.SETTLING, settled: int = 2) -> State:
    state = BrainState(
        time_s=1.0,
        phase=phase,
        motion="overshoot",
        motion_index=2,
        motions_expected=5,
        waiting_for="the needle to settle",
        remaining_s=1.23,
        progress=0.31,
        target_rad=rad(45.0),
        model=None,
        strategy="reed2008",
        waypoint_rad=rad(71.3),
        velocity_rad_s=0.0,
        limited=False,
        measurement=measurement,
        settled=(MOTION,) * settled,
        outcome=None,
        fault=None,
        fault_name=None,
        latched=False,
        released=False,
    )
    rig = report.rig_document(CONFIG, simulated=True)
    shown = {"type": "phase", "rig": rig, "run": None, "last": None, **report.state_document(state)}
    return cast(State, shown)


MEASURED = Measurement(
    1.0, rad(71.3), 1.0e-4, HALLS, DriveState.RUNNING, DriveFault.NONE, 0.001, 0.002, 0.003
)


def drawn(state: State, width: int, height: int) -> str:
    out = io.StringIO()
    Console(file=out, width=width, height=height, force_terminal=False).print(screen(state, width, height))
    return out.getvalue()


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 40), (60, 15), (200, 60)])
def test_the_display_fits_the_terminal(width: int, height: int) -> None:
    text = drawn(document(MEASURED), width, height)
    assert len(text.splitlines()) <= height
    assert max(map(len, text.splitlines())) <= width


def test_the_display_tells_everything_that_is_promised() -> None:
    text = drawn(document(MEASURED), 120, 40)
    for wanted in (
        "overshoot · settling",
        "waits for the needle to settle, 1.2 s",
        "31%",
        "motion 2 of 5",
        "71.30°",
        "0.1000 N·mm",
        "25.4°",
        "19.0°",
        "●",
        "▒",
        "tip lag",
    ):
        assert wanted in text


def test_no_reading_is_drawn_as_none() -> None:
    assert "no reading yet" in drawn(document(None, settled=0), 80, 24)
    dead = Measurement(1.0, math.nan, math.nan, (math.nan,) * 4)
    assert "–" in drawn(document(dead, settled=0), 80, 24)


@given(
    angles=st.lists(angle, min_size=2, max_size=9),
    target=angle,
    columns=st.integers(1, 200),
    rows=st.integers(1, 40),
)
def test_a_picture_has_its_size_and_all_its_points(
    angles: list[float], target: float, columns: int, rows: int
) -> None:
    places = [n * 40.0 for n in range(len(angles))]
    low, high = min(*angles, target), max(*angles, target) + 1.0
    lines = picture(places, angles, target, (low, high), 400.0, columns, rows)
    assert len(lines) == rows
    assert {len(line) for line in lines} == {columns}
    assert "●" in "".join(lines)
    if columns >= 20:
        assert "".join(lines).count("●") == len(angles)


def test_a_straight_needle_is_a_straight_line() -> None:
    lines = picture([0.0, 200.0, 400.0], [30.0, 30.0, 30.0], 30.0, (0.0, 60.0), 400.0, 40, 9)
    assert [bool(line.strip()) for line in lines] == [False] * 4 + [True] + [False] * 4


def test_a_phase_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with PhaseLines() as lines:
        lines.show(document(MEASURED))
        lines.show({**document(MEASURED), "type": "state"})
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(r" 31%  overshoot  settling   waits for the needle to settle, 1.2 s .*\n", err)
    assert phase_line(document(MEASURED, Phase.DONE)).split() == ["31%", "done"]


def test_numbers_are_never_minus_zero() -> None:
    assert number(-0.0001, 2) == "0.00"
    assert number(-0.01, 2) == "-0.01"
    assert number(None, 2) == "–"


@given(value=st.floats())
def test_what_the_daemon_tells_is_always_json(value: float) -> None:
    measurement = Measurement(1.0, value, value, (value,) * 4, torque_age_s=value)
    text = json.dumps(document(measurement), allow_nan=False)
    told = json.loads(text)["sensors"]["hall_deg"][0]
    assert (told is None) == (not math.isfinite(math.degrees(value)))
    assert told is None or told == pytest.approx(math.degrees(value), rel=1e-12, abs=1e-4)


def test_a_result_is_told_with_table_conditions_verdict_and_files() -> None:
    out = io.StringIO()
    shown = {
        "result": {"status": "not_aligned", "simulated": True, "run": "runs/1.h5"},
        "text": "not aligned: the tip lags 12°",
        "conditions": [
            {"name": "8b", "text": "no torque", "value": 0.044, "limit": 0.02, "unit": "N·mm", "met": False}
        ],
        "settled": [report.settled_document(MOTION)],
    }
    tell_result(Console(file=out, width=80), cast(Told, shown), "runs/1.png")
    text = out.getvalue()
    for wanted in (
        "rotate",
        "26.3",
        "✗ 8b  no torque: 0.044 N·mm, limit 0.02 N·mm",
        "Simulated: not aligned: the tip lags 12°.",
        "run:     runs/1.h5",
        "picture: runs/1.png",
    ):
        assert wanted in text
    assert max(map(len, text.splitlines())) <= 80
    assert len(settled_table([]).rows) == 0


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_wait_is_told_by_a_bar_that_moves_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    out = Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", out)
    drawn = set[str]()
    with moving_bar("the first start compiles"):
        until_s = time.monotonic() + 20.0
        while len(drawn) < 3 and time.monotonic() < until_s:
            time.sleep(0.05)
            drawn.add(out.getvalue())
    assert "the first start compiles" in max(drawn, key=len)
    assert len(drawn) == 3


def test_a_wait_is_not_told_where_nobody_looks(capsys: pytest.CaptureFixture[str]) -> None:
    with moving_bar("the first start compiles"):
        time.sleep(0.2)
    assert capsys.readouterr() == ("", "")
