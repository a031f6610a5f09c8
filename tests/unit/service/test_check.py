"""Every finding of `needle-rig check` on both sides of its limit."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from needle_rig.cli.main import run
from needle_rig.config.files import shipped_file
from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.devices.bus_watch import frame_bits
from needle_rig.recording import mark_read, retain
from needle_rig.service.setup import check
from needle_rig.service.setup.interface import Interface, parse
from needle_rig.service.tick.rates import Rates
from needle_rig.version import VERSION

RIG = load_rig_config(shipped_file("rig.hardware.yaml"))
UP = Interface("can", up=True, state="ERROR-ACTIVE", bitrate_bit_s=1_000_000, restart_ms=100)


def changed(**sections: dict[str, Any]) -> RigConfig:
    parts = {name: getattr(RIG, name).model_copy(update=values) for name, values in sections.items()}
    return RIG.model_copy(update=parts)


def verdicts(findings: list[check.Finding]) -> list[str]:
    return [finding.verdict for finding in findings]


def test_the_shipped_needle_and_layout_are_plausible() -> None:
    assert verdicts(check.check_needle(RIG)) == ["ok", "ok"]


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        # 5 % of the diameter make 22 % of the rigidity
        (changed(needle={"torsional_rigidity_nmm2": 61.8 * 1.22}), "off what diameter and modulus give"),
        (changed(drive={"torque_limit_nmm": 2.0}), "far beyond drive.windup_limit_deg"),
        (changed(needle={"length_mm": 450.0}), "mm from the tip"),
    ],
    ids=["rigidity", "torque limit", "last sensor"],
)
def test_a_needle_or_layout_that_cannot_be_meant_is_warned_of(rig: RigConfig, words: str) -> None:
    (warned,) = [finding for finding in check.check_needle(rig) if finding.verdict == "warn"]
    assert words in warned.text
    assert warned.todo


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (UP, "ok"),
        (None, "fail"),
        (Interface("can", up=False, state="STOPPED", bitrate_bit_s=0, restart_ms=0), "fail"),
        (Interface("can", up=True, state="BUS-OFF", bitrate_bit_s=1_000_000, restart_ms=0), "fail"),
        (Interface("can", up=True, state="ERROR-PASSIVE", bitrate_bit_s=1_000_000, restart_ms=100), "warn"),
        (Interface("can", up=True, state="ERROR-ACTIVE", bitrate_bit_s=1_000_000, restart_ms=0), "warn"),
        (Interface("vcan", up=True, state="", bitrate_bit_s=0, restart_ms=0), "ok"),
        (Interface("vcan", up=False, state="", bitrate_bit_s=0, restart_ms=0), "fail"),
        (Interface("ether", up=True, state="", bitrate_bit_s=0, restart_ms=0), "fail"),
    ],
    ids=["well", "none", "down", "bus-off", "passive", "no restart", "virtual", "virtual down", "ethernet"],
)
def test_the_interface_is_judged_by_what_the_kernel_says(found: Interface | None, verdict: str) -> None:
    finding = check.check_interface(RIG, found)
    assert finding.verdict == verdict
    assert "can0" in finding.text


def test_the_kernels_words_are_read() -> None:
    text = (
        '{"ifname":"can0","flags":["NOARP","UP","LOWER_UP","ECHO"],"link_type":"can","linkinfo":{"info_kind":"can",'
        '"info_data":{"state":"ERROR-ACTIVE","restart_ms":100,"bittiming":{"bitrate":1000000}}}}'
    )
    assert parse(json.loads(text)) == UP
    assert parse({"flags": [], "link_type": "loopback"}) == Interface("loopback", False, "", 0, 0)


def test_a_frame_of_eight_bytes_takes_at_most_135_bits() -> None:
    # Davis et al. 2007: 135 bits, 160 with an extended identifier
    assert (frame_bits(8), frame_bits(8, extended=True)) == (135, 160)


@pytest.mark.parametrize(
    ("bits", "verdict"), [(699_000, "ok"), (701_000, "warn"), (951_000, "fail")], ids=str
)
def test_the_load_of_the_bus_is_judged(bits: int, verdict: str) -> None:
    assert check.check_load(bits, 1.0, 3000, UP).verdict == verdict


def test_a_missing_port_fails_and_one_that_is_there_does_not(tmp_path: Any) -> None:
    assert check.check_port("Hall port", str(tmp_path / "none"), mine=True).verdict == "fail"
    (tmp_path / "port").touch()
    assert check.check_port("Hall port", f"{tmp_path}/port@3000000", mine=True).verdict == "ok"


@pytest.mark.parametrize(
    ("source", "synchronized", "expected"),
    [("tsc", True, ["ok", "ok"]), ("hpet", False, ["warn", "warn"]), ("kvm-clock", None, ["ok"])],
    ids=str,
)
def test_slow_or_unset_clocks_are_warned_of(
    source: str, synchronized: bool | None, expected: list[str]
) -> None:
    assert verdicts(check.check_clocks(source, synchronized)) == expected


@pytest.mark.parametrize(("runs", "verdict"), [(101, "ok"), (99, "warn"), (1.5, "fail")], ids=str)
def test_the_disk_is_judged_by_the_runs_that_fit(runs: float, verdict: str) -> None:
    run_bytes = check.bytes_a_second(RIG) * check.RUN_S
    # a run of the bench took 4.6 MB in 23 s
    assert 0.1e6 < check.bytes_a_second(RIG) < 0.4e6
    assert check.check_disk(RIG, int(runs * run_bytes)).verdict == verdict


def test_check_says_which_runs_go_next(tmp_path: Path) -> None:
    limited = changed(recording={"keep_gb": 0.05})
    assert check.check_runs(RIG, tmp_path / "none").text.startswith("every run stays")
    retain(tmp_path, None, 1.0)
    for number in range(3):
        run_file = tmp_path / f"run_{number}.h5"
        with run_file.open("wb") as file:
            file.truncate(40_000_000)
        os.utime(run_file, (number, number))
        mark_read(run_file)
    found = check.check_runs(limited, tmp_path)
    assert found.verdict == "ok"
    assert found.text.endswith("when the next run ends: run_0.h5 to run_1.h5, 2 runs, 0.08 GB")
    assert retain(tmp_path, None, 0.05).removed == (tmp_path / "run_0.h5", tmp_path / "run_1.h5")
    assert "when the next" not in check.check_runs(limited, tmp_path).text


SENSORS: Any = {
    "base_deg": 0.0,
    "torque_nmm": 0.0,
    "hall_deg": [0.0, 0.0, 0.0, 0.0],
    "drive_state": "ready",
    "referenced": True,
    "emergency_stop": False,
    "age_ms": {"torque": 1.0, "hall": 1.0, "drive": 1.0},
}
STATE: Any = {
    "rig": {"tick_hz": 200},
    "sensors": SENSORS,
    "rates_hz": {"torque": 1000.0, "hall": 1000.0, "drive": 1000.0},
    "warnings": [],
    "ticks": {"late_p99_ms": 0.3, "missed": 0, "count": 500},
    "fault": None,
    "latched": False,
}


def test_a_daemon_of_another_version_is_warned_of_with_the_next_step() -> None:
    assert check.check_version(VERSION).verdict == "ok"
    found = check.check_version("0.0.9")
    assert (found.verdict, found.text) == ("warn", f"the daemon runs needle-rig 0.0.9, and this is {VERSION}")
    assert "systemctl restart needle-rig" in found.todo
    assert "an older needle-rig" in check.check_version(None).text


def test_a_rig_that_is_well_has_nothing_but_ok() -> None:
    findings = [*check.check_ticks(STATE), *check.check_links(RIG, STATE), *check.check_drive(STATE)]
    assert set(verdicts(findings)) == {"ok"}
    assert check.worst(findings) == "ok"


@pytest.mark.parametrize(
    ("change", "name", "verdict"),
    [
        ({"rates_hz": {"torque": 179.0, "hall": 1000.0, "drive": 1000.0}}, "torque node", "warn"),
        ({"rates_hz": {"torque": 181.0, "hall": 1000.0, "drive": 1000.0}}, "torque node", "ok"),
        (
            {"sensors": {**SENSORS, "age_ms": {"torque": 1.0, "hall": 51.0, "drive": 1.0}}},
            "hall node",
            "fail",
        ),
        ({"sensors": None}, "drive node", "fail"),
        ({"sensors": {**SENSORS, "emergency_stop": True}}, "drive", "fail"),
        ({"sensors": {**SENSORS, "referenced": False}}, "drive", "warn"),
        ({"latched": True, "fault": "it ran away"}, "drive", "fail"),
        ({"warnings": ["no real-time priority"]}, "real time", "warn"),
        ({"ticks": {"late_p99_ms": 2.6, "missed": 3, "count": 500}}, "ticks", "warn"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_what_is_not_well_is_named(change: dict[str, Any], name: str, verdict: str) -> None:
    state: Any = {**STATE, **change}
    findings = [*check.check_ticks(state), *check.check_links(RIG, state), *check.check_drive(state)]
    assert verdict in [finding.verdict for finding in findings if finding.name == name]


def node(**told: Any) -> Any:
    said = {"text": "what it said", "protocol": 1, "version": VERSION, "refusal": None}
    return {"firmware": {"torque": said | told}}


@pytest.mark.parametrize(
    ("state", "verdict", "text", "todo"),
    [
        (node(), "ok", "what it said", ""),
        (node(version=None), "ok", "what it said", ""),
        (node(version="0.1.9"), "warn", f"what it said; needle-rig is {VERSION}", "flash it"),
        (node(protocol=None, version=None), "warn", "older than 0.2.0", "flash it"),
        (node(protocol=2, refusal="it speaks 2; flash it"), "fail", "it speaks 2", "flash it"),
    ],
)
def test_a_node_is_judged_by_what_it_says_of_itself(state: Any, verdict: str, text: str, todo: str) -> None:
    (found,) = check.check_firmware(STATE | state)
    assert (found.name, found.verdict) == ("torque firmware", verdict)
    assert text in found.text
    assert todo in found.todo


def test_of_a_node_that_is_not_heard_and_of_an_older_daemon_nothing_is_said() -> None:
    silent = {**SENSORS, "age_ms": {"torque": None, "hall": 1.0, "drive": 1.0}}
    unknown = node(protocol=None, version=None)
    assert check.check_firmware(STATE | unknown | {"sensors": silent}) == []
    assert check.check_firmware(STATE | unknown | {"sensors": None}) == []
    assert check.check_firmware(STATE) == []


def scattered(torque_nmm: float, hall_deg: float) -> list[Any]:
    signs = (1, -1) * 25
    return [
        {**SENSORS, "torque_nmm": s * torque_nmm, "hall_deg": [s * hall_deg, 0.0, 0.0, 0.0]} for s in signs
    ]


def test_noise_is_held_against_what_calibration_left() -> None:
    names = [finding.name for finding in check.check_noise(RIG, scattered(0.001, 0.2), 0.001, [0.2] * 4)]
    assert names == ["torque noise", *(f"hall_{n} noise" for n in range(1, 5))]
    quiet = check.check_noise(RIG, scattered(0.0028, 0.56), 0.001, [0.2] * 4)
    loud = check.check_noise(RIG, scattered(0.0032, 0.62), 0.001, [0.2] * 4)
    assert verdicts(quiet)[:2] == ["ok", "ok"]
    assert verdicts(loud)[:2] == ["warn", "warn"]
    assert set(verdicts(check.check_noise(RIG, scattered(9.0, 90.0), None, []))) == {"ok"}


def turned(base: float, torque: float, halls: tuple[float, ...]) -> list[check.Finding]:
    after: Any = {**SENSORS, "base_deg": base, "torque_nmm": torque, "hall_deg": list(halls)}
    return check.check_move(RIG, SENSORS, after, 20.0)


@pytest.mark.parametrize(
    ("moved", "expected"),
    [
        # 20° of a shaft of 61.8 N·mm² that is held at 175 mm take 0.123 N·mm
        ((20.0, 0.08, (8.0, 4.0, 2.0, 0.5)), ["ok", "ok", "ok", "ok", "ok", "warn"]),
        ((18.0, 0.08, (8.0, 4.0, 2.0, 2.0)), ["fail", "ok", "ok", "ok", "ok", "ok"]),
        ((20.0, -0.08, (8.0, 4.0, 2.0, 2.0)), ["ok", "fail", "ok", "ok", "ok", "ok"]),
        ((20.0, 0.19, (8.0, 4.0, 2.0, 2.0)), ["ok", "warn", "ok", "ok", "ok", "ok"]),
        ((20.0, 0.08, (-8.0, 4.0, 22.0, 2.0)), ["ok", "ok", "fail", "ok", "warn", "ok"]),
    ],
    ids=["well", "slips", "torque reversed", "torque too large", "Hall reversed and too large"],
)
def test_a_move_shows_directions_and_scales(
    moved: tuple[float, float, tuple[float, ...]], expected: list[str]
) -> None:
    assert verdicts(turned(*moved)) == expected


def test_rates_are_counted_over_a_second_and_fall_to_zero() -> None:
    passed: list[str] = []
    rates = Rates(lambda source, _: passed.append(source))
    for tick in range(401):
        if tick < 200:
            rates.raw("hall", (0.0,))
        rates.step(tick * 0.005)
        if tick == 210:
            assert rates.hz == {"hall": 200.0}
    assert rates.hz == {"hall": 0.0}
    assert len(passed) == 200


@pytest.mark.whole
def test_the_shipped_simulated_rig_is_checked_and_said_to_be_simulated(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    code = run(["check", "--config", str(shipped_file("rig.yaml")), "--json"])
    told = json.loads(capsys.readouterr().out)
    assert code == (1 if told["verdict"] == "fail" else 0)
    assert told["simulated"] is True
    names = [finding["name"] for finding in told["findings"]]
    for wanted in ("rig file", "needle", "layout", "clock", "disk", "torque node", "hall_4 noise", "drive"):
        assert wanted in names


def test_a_rig_file_that_cannot_be_used_fails_at_once(
    tmp_path: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "rig.yaml"
    bad.write_text("format: needle-rig/1\n")
    assert run(["check", "--config", str(bad)]) == 1
    assert capsys.readouterr().out.startswith("fail  rig file: ")
