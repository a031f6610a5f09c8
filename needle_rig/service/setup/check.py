"""What `needle-rig check` finds: each thing that a rig needs, whether it is well, and what to do."""

from __future__ import annotations

import math
import os
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from needle_rig.config.schema import RigConfig
from needle_rig.control.in_si import torsional_rigidity_nm2
from needle_rig.control.supervision import BLIND_S
from needle_rig.recording import kept_text, run_tables, size_bytes, to_remove
from needle_rig.service.api.documents import Sensors, State
from needle_rig.service.setup.interface import Interface
from needle_rig.units import deg
from needle_rig.version import VERSION, differs

Verdict = Literal["ok", "warn", "fail"]

NOISE_TIMES = 3.0
"""So much more than calibration left is no chance: 50 samples tell a standard deviation to 10 %."""
RIGIDITY_APART = 0.2
"""Stated and computed rigidity: the diameter counts four times, so 5 % of it make this."""
TIP_SHARE = 0.1
"""Further from the tip than this share of the needle's length, the last sensor says little about the tip."""
BUSY, FULL = 0.7, 0.95
"""Bus load at which frames of low priority begin to wait for long, and at which they may never be sent."""
FEW_RUNS, NO_RUNS = 100, 2
RUN_S = 30.0
"""A compensation with the usual settling takes 25 s."""
SENSOR_HZ = 1000.0
"""What the firmware's nodes send."""
RATE_SHARE = 0.9
"""A drive that answers each tick is counted a few short of the ticks in the second that is looked at."""
LATE_SHARE = 0.5
"""A tick that begins after half its period has no time left for a second such delay."""
MOVED_DEG = 1.0
"""Less than four times a Hall sensor's noise is no motion."""
TORQUE_TIMES = 1.5
"""A turn's torque is at most that of the free needle before the first tissue, whose length is known worse."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    name: str
    verdict: Verdict
    text: str
    todo: str = ""


def check_needle(config: RigConfig) -> list[Finding]:
    """Whether needle and layout can be what a person meant."""
    needle, found = config.needle, []
    rigidity_nm2 = torsional_rigidity_nm2(config)
    by_size_nm2 = math.pi / 32 * (needle.diameter_mm * 1e-3) ** 4 * needle.shear_modulus_gpa * 1e9
    apart = rigidity_nm2 / by_size_nm2 - 1.0
    if abs(apart) > RIGIDITY_APART:
        text = (
            f"its rigidity is {rigidity_nm2 * 1e6:.4g} N·mm², {apart:+.0%} off what diameter and modulus give"
        )
        found.append(Finding("needle", "warn", text, "measure the diameter, see needle in the rig file"))
    twist_deg = deg(config.drive.torque_limit_nmm * 1e-3 * needle.length_mm * 1e-3 / rigidity_nm2)
    if twist_deg > 2 * config.drive.windup_limit_deg:
        text = (
            f"drive.torque_limit_nmm would twist it by {twist_deg:.0f}°,"
            f" far beyond drive.windup_limit_deg: {config.drive.windup_limit_deg:g}°"
        )
        found.append(Finding("needle", "warn", text, "lower drive.torque_limit_nmm"))
    if not found:
        found.append(Finding("needle", "ok", f"{needle.length_mm:g} mm, {rigidity_nm2 * 1e6:.4g} N·mm²"))
    last = config.layout.hall_sensors[-1]
    beyond_mm = needle.length_mm - last.position_mm
    if beyond_mm > TIP_SHARE * needle.length_mm:
        text = f"the last Hall sensor, {last.name}, sits {beyond_mm:.0f} mm from the tip"
        found.append(Finding("layout", "warn", text, "see layout.hall_sensors in the rig file"))
    else:
        sections = len(config.layout.tissue_sections_mm)
        text = f"{len(config.layout.hall_sensors)} Hall sensors, {sections} tissue sections"
        found.append(Finding("layout", "ok", text))
    return found


def check_interface(config: RigConfig, found: Interface | None) -> Finding:
    """Whether the CAN interface is up, at the rig's bit rate, and comes back after a bus-off."""
    name = config.links.can.channel
    up = f"sudo ip link set {name} up type can bitrate 1000000 restart-ms 100"
    if found is None:
        return Finding(
            "CAN", "fail", f"there is no interface {name}", "plug the adapter in; ip link shows them"
        )
    if found.kind == "vcan":
        verdict: Verdict = "ok" if found.up else "fail"
        return Finding("CAN", verdict, f"{name} is virtual: no bus with wires", f"sudo ip link set {name} up")
    if found.kind != "can":
        return Finding("CAN", "fail", f"{name} is no CAN interface but {found.kind}", "see links.can")
    if not found.up or found.state == "STOPPED":
        return Finding("CAN", "fail", f"{name} is down", up)
    if found.state == "BUS-OFF":
        return Finding("CAN", "fail", f"{name} is off the bus", "look at cable, terminators and bit rates")
    told = f"{name}, {found.bitrate_bit_s / 1000:g} kbit/s, {found.state.lower()}"
    if found.state != "ERROR-ACTIVE":
        return Finding("CAN", "warn", told, "frames are damaged: look at cable, terminators and bit rates")
    if found.restart_ms == 0:
        return Finding(
            "CAN", "warn", f"{told}: stays off after a bus-off", f"sudo ip link set {name} down; {up}"
        )
    return Finding("CAN", "ok", told)


def check_port(name: str, port: str, *, mine: bool) -> Finding:
    """Whether a serial port is there and, when it is `mine` to open, may be opened."""
    path = port.partition("@")[0]
    if not os.path.exists(path):
        return Finding(
            name, "fail", f"there is no {path}", "plug it in; ls /dev/serial/by-id shows what is there"
        )
    if mine and not os.access(path, os.R_OK | os.W_OK):
        return Finding(
            name, "fail", f"no right to open {path}", "sudo usermod -aG dialout $USER, log in again"
        )
    return Finding(name, "ok", path)


def check_load(bits: int, seconds_s: float, frames: int, found: Interface | None) -> Finding:
    """How much of the bus is taken."""
    told = f"{frames / seconds_s:.0f} frames/s"
    if found is None or not found.bitrate_bit_s:
        return Finding("bus load", "ok", f"{told} (a bus without a bit rate)")
    load = bits / seconds_s / found.bitrate_bit_s
    verdict: Verdict = "ok" if load < BUSY else "warn" if load < FULL else "fail"
    todo = "" if verdict == "ok" else "take other nodes off this bus, or raise its bit rate"
    return Finding("bus load", verdict, f"{load:.0%}, {told}", todo)


def check_clocks(source: str, synchronized: bool | None) -> list[Finding]:
    """The kernel's clock source, and whether the time of day can be believed."""
    slow = source in ("jiffies", "acpi_pm", "hpet", "pit")
    found = [
        Finding(
            "clock",
            "warn",
            f"the kernel's clock is {source}, which is slow to read",
            "see tsc= of the kernel",
        )
        if slow
        else Finding("clock", "ok", source or "unknown")
    ]
    if synchronized is not None:
        text = (
            "set by a time server" if synchronized else "not set by a time server: runs may be dated wrongly"
        )
        todo = "" if synchronized else "sudo timedatectl set-ntp true"
        found.append(Finding("time of day", "ok" if synchronized else "warn", text, todo))
    return found


def check_disk(config: RigConfig, free_bytes: int) -> Finding:
    """How many runs fit."""
    fit = int(free_bytes / (bytes_a_second(config) * RUN_S))
    verdict: Verdict = "ok" if fit >= FEW_RUNS else "warn" if fit >= NO_RUNS else "fail"
    text = f"{free_bytes / 1e9:.3g} GB free, {fit} runs of {RUN_S:g} s"
    return Finding("disk", verdict, text, "" if verdict == "ok" else "export runs and remove them")


def check_runs(config: RigConfig, directory: Path) -> Finding:
    """What stays of the runs, and which go when the next one ends."""
    days, gb = config.recording.keep_days, config.recording.keep_gb
    text = kept_text(days, gb)
    going = to_remove(directory, days, gb)
    if going:
        size_gb = sum(map(size_bytes, going)) / 1e9
        text += f"; when the next run ends: {going[0].name}"
        text += f" to {going[-1].name}, {len(going)} runs" if len(going) > 1 else ""
        text += f", {size_gb:.3g} GB"
    return Finding("runs", "ok", text)


def bytes_a_second(config: RigConfig) -> float:
    """What recording takes, with nodes that send at 1 kHz."""
    tables = run_tables(len(config.layout.hall_sensors))
    raw = sum(tables[name].itemsize for name in ("torque", "hall", "drive"))
    return config.tick_hz * tables["ticks"].itemsize + SENSOR_HZ * raw


def check_ticks(state: State) -> list[Finding]:
    """Whether the daemon may be in real time, and whether it is."""
    found = [Finding("real time", "warn", warning) for warning in state["warnings"]]
    if not found:
        found.append(Finding("real time", "ok", "real-time priority, locked memory"))
    ticks, period_ms = state.get("ticks", {}), 1e3 / state["rig"]["tick_hz"]
    late_ms = ticks.get("late_p99_ms")
    if late_ms is not None:
        missed = f"{ticks['missed']} of {ticks['missed'] + ticks['count']} missed"
        text = f"late by {late_ms:.2f} ms (99 %) of {period_ms:g} ms, {missed}"
        late = late_ms > LATE_SHARE * period_ms
        todo = "end other programs, or lower tick_hz" if late else ""
        found.append(Finding("ticks", "warn" if late else "ok", text, todo))
    return found


def check_version(daemon: str | None) -> Finding:
    """Whether the daemon is of the version that looks at it."""
    told = differs(daemon)
    if told is None:
        return Finding("version", "ok", f"needle-rig {daemon}")
    text, _, todo = told.partition("; ")
    return Finding("version", "warn", text, todo)


def check_links(config: RigConfig, state: State) -> list[Finding]:
    """Whether every node is heard, young enough and often enough."""
    sensors, rates, found = state["sensors"], state["rates_hz"], []
    limits_ms = {
        "torque": config.links.torque_age_limit_ms,
        "hall": config.links.hall_age_limit_ms,
        # while it is enabled
        "drive": min(config.links.drive_age_limit_ms, BLIND_S * 1e3),
    }
    ages = None if sensors is None else sensors["age_ms"]
    for name, limit_ms in limits_ms.items():
        age_ms = None if ages is None else ages[name]  # type: ignore[literal-required]  # the names of Ages
        rate_hz = rates.get(name, 0.0)
        if age_ms is None or age_ms > limit_ms:
            text = state["fault"] or "no value came"
            found.append(Finding(f"{name} node", "fail", text, "look at its cable and its supply"))
        elif rate_hz < RATE_SHARE * config.tick_hz:
            text = f"{rate_hz:.0f} readings/s are fewer than ticks: {config.tick_hz:g}/s"
            found.append(Finding(f"{name} node", "warn", text, "look at the load of its bus"))
        else:
            text = f"{rate_hz:.0f} readings/s, {age_ms:.1f} ms old, limit {limit_ms:g} ms"
            found.append(Finding(f"{name} node", "ok", text))
    return found


def check_firmware(state: State) -> list[Finding]:
    """What each node is; whether it can be worked with, and is of this version."""
    found = []
    ages = {} if state["sensors"] is None else {**state["sensors"]["age_ms"]}
    for link, node in state.get("firmware", {}).items():
        name, flash = f"{link} firmware", "flash it: needle-rig firmware build"
        if node["refusal"] is not None:
            text, _, todo = node["refusal"].partition("; ")
            found.append(Finding(name, "fail", text, todo))
        elif node["protocol"] is None and ages.get(link) is None:
            continue  # the check of its link says that it is not heard
        elif node["protocol"] is None:
            found.append(Finding(name, "warn", f"{node['text']}: older than 0.2.0", flash))
        elif node["version"] not in (None, VERSION):
            found.append(Finding(name, "warn", f"{node['text']}; needle-rig is {VERSION}", flash))
        else:
            found.append(Finding(name, "ok", node["text"]))
    return found


def check_noise(
    config: RigConfig, seen: Sequence[Sensors], residual_nmm: float | None, residual_deg: Sequence[float]
) -> list[Finding]:
    """The scatter at rest, held against what calibration left of each sensor."""
    torques = [each["torque_nmm"] for each in seen if each["torque_nmm"] is not None]
    names = [sensor.name for sensor in config.layout.hall_sensors]
    angles = [
        [
            each["hall_deg"][n]
            for each in seen
            if len(each["hall_deg"]) > n and each["hall_deg"][n] is not None
        ]
        for n in range(len(names))
    ]
    found = []
    if len(torques) > 2:
        found.append(_noise("torque noise", statistics.stdev(torques), "N·mm", residual_nmm, "torque"))
    for number, (name, values) in enumerate(zip(names, angles, strict=True)):
        if len(values) > 2:
            said = residual_deg[number] if number < len(residual_deg) else None
            scatter_deg = statistics.stdev(value for value in values if value is not None)
            found.append(_noise(f"{name} noise", scatter_deg, "°", said, "hall"))
    return found


def _noise(name: str, scatter: float, unit: str, residual: float | None, node: str) -> Finding:
    space = "" if unit == "°" else " "
    told = f"{scatter:.2g}{space}{unit} (one standard deviation)"
    if residual is None:
        return Finding(name, "ok", f"{told}; no calibration to hold it against")
    if scatter > NOISE_TIMES * residual:
        text = f"{told}, calibration left {residual:.2g}{space}{unit}"
        return Finding(name, "warn", text, f"look at its cable and screen; needle-rig calibrate {node}")
    return Finding(name, "ok", f"{told}, calibration left {residual:.2g}{space}{unit}")


def check_drive(state: State) -> list[Finding]:
    """Whether the drive waits for a person, and whether a fault stands."""
    sensors, found = state["sensors"], []
    if sensors is not None and sensors["emergency_stop"]:
        found.append(Finding("drive", "fail", "the emergency stop is pressed", "release it"))
    if sensors is not None and not sensors["referenced"]:
        found.append(Finding("drive", "warn", "its zero is not known", "needle-rig home --by hall"))
    if state["latched"]:
        found.append(Finding("drive", "fail", state["fault"] or "a fault", "needle-rig clear"))
    return found or [Finding("drive", "ok", "no fault" if sensors is None else sensors["drive_state"])]


def check_move(config: RigConfig, before: Sensors, after: Sensors, turn_deg: float) -> list[Finding]:
    """What a turn of the base by `turn_deg` did: directions and scales of encoder, cell and Hall sensors."""
    found = [_moved("encoder", before["base_deg"], after["base_deg"], turn_deg)]
    torque_nmm = _change(before["torque_nmm"], after["torque_nmm"]) * math.copysign(1.0, turn_deg)
    free_mm = config.layout.tissue_sections_mm[0][0]
    most_nmm = torsional_rigidity_nm2(config) * 1e6 / max(free_mm, 1.0) * math.radians(abs(turn_deg))
    text = f"{torque_nmm:+.4f} N·mm against the turn, at most {most_nmm:.4f} is expected"
    if torque_nmm < 0:
        found.append(Finding("torque cell", "fail", text, "it is wired or mounted the wrong way round"))
    elif torque_nmm > TORQUE_TIMES * most_nmm:
        found.append(
            Finding("torque cell", "warn", text, "needle-rig calibrate torque; see needle in the rig file")
        )
    else:
        found.append(Finding("torque cell", "ok", text))
    for number, sensor in enumerate(config.layout.hall_sensors):
        moved_deg = _change(before["hall_deg"][number], after["hall_deg"][number]) * math.copysign(
            1.0, turn_deg
        )
        text = f"turned by {moved_deg:.1f}° with the base's {abs(turn_deg):g}°"
        if math.isnan(moved_deg) or moved_deg < -MOVED_DEG:
            found.append(Finding(sensor.name, "fail", text, "it is mounted the wrong way round"))
        elif moved_deg > abs(turn_deg) + MOVED_DEG:
            found.append(Finding(sensor.name, "warn", text, "needle-rig calibrate hall"))
        elif moved_deg < MOVED_DEG:
            found.append(
                Finding(sensor.name, "warn", f"{text}: the tissue holds it", "turn further: --move 45")
            )
        else:
            found.append(Finding(sensor.name, "ok", text))
    return found


def _moved(name: str, before: float | None, after: float | None, turn_deg: float) -> Finding:
    moved_deg = _change(before, after)
    text = f"counted {moved_deg:.2f}° of {turn_deg:g}°"
    if math.isnan(moved_deg) or abs(moved_deg - turn_deg) > MOVED_DEG:
        return Finding(name, "fail", text, "look at motor, coupling and encoder")
    return Finding(name, "ok", text)


def _change(before: float | None, after: float | None) -> float:
    return math.nan if before is None or after is None else after - before


def worst(findings: Sequence[Finding]) -> Verdict:
    """The gravest verdict among them."""
    order: dict[Verdict, int] = {"ok": 0, "warn": 1, "fail": 2}
    return max((finding.verdict for finding in findings), key=order.__getitem__)
