"""The contract: the shipped devices keep it, and each clause is broken by a device that breaks it."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from needle_rig.cli.check_device import command
from needle_rig.config.schema import Cia402Drive, NetFtTorque, TextHall
from needle_rig.devices.contract import check_device
from needle_rig.devices.device import Device
from needle_rig.devices.drive_cia402 import DriveCia402
from needle_rig.devices.hall_text import HallText
from needle_rig.devices.library import load_device, make_device, shipped_device
from needle_rig.devices.memory_host import MemoryHost
from needle_rig.devices.torque_netft import TorqueNetFt
from needle_rig.errors import BadInput
from needle_rig.records import Command
from needle_rig.simulation.nodes.twins import TWINS

DRIVE: dict[str, Any] = {"node_id": 5, "position_units_per_turn": 409_600, "velocity_units_per_rpm": 100}


def cia402(**options: Any) -> Cia402Drive:
    return Cia402Drive(device="cia402", **{**DRIVE, **options})


def netft(**options: Any) -> NetFtTorque:
    return NetFtTorque(device="netft", address="192.168.1.1", **options)


def text(**options: Any) -> TextHall:
    return TextHall(device="text", port="/dev/none", **options)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("drive", cia402()),
        ("drive", cia402(mode="pv", reversed=True)),
        ("drive", cia402(node_id=127, lost_host_ms=20, position_units_per_turn=4000)),
        ("torque", netft()),
        ("torque", netft(axis="x", reversed=True)),
        ("hall", text()),
        ("hall", text(checksum=True, angle="rad", clock="us")),
        ("hall", text(angle="counts", counts_per_turn=4096)),
    ],
)
def test_the_shipped_devices_keep_the_contract(kind: str, options: Any) -> None:
    made = shipped_device(kind, options.device)
    broken = [c for c in check_device(made, options, lambda: TWINS[options.device](options)) if c.broken]
    assert broken == []


class NeverOld(TorqueNetFt):
    def age_s(self, now_s: float) -> float:
        return 0.0 if math.isfinite(self.torque_nm) else math.inf


class WrongSign(TorqueNetFt):
    def __init__(self, options: Any, host: Any) -> None:
        super().__init__(options.model_copy(update={"reversed": True}), host)


class AlwaysKnown(TorqueNetFt):
    def age_s(self, now_s: float) -> float:
        return 0.001


class SetUpOnce(TorqueNetFt):
    def needs_set_up(self, now_s: float) -> bool:
        return False


class Wrapped(HallText):
    def _receive(self, data: bytes, now_s: float) -> None:
        super()._receive(data, now_s)
        self.angle_rad = tuple(math.remainder(angle, math.tau) for angle in self.angle_rad)


class Raises(HallText):
    def _receive(self, data: bytes, now_s: float) -> None:
        super()._receive(data, now_s)
        data.decode("ascii")


class WakesByItself(DriveCia402):
    def command(self, command: Command) -> None:
        self._woken = self._set_up
        super().command(command)


class WrongScale(DriveCia402):
    def __init__(self, options: Any, host: Any) -> None:
        super().__init__(options, host)
        self._units_per_rad_s *= 1.1


class CountsBackwards(DriveCia402):
    def __init__(self, options: Any, host: Any) -> None:
        super().__init__(options, host)
        self._unit_rad *= -1.0


class NoReference(DriveCia402):
    def command(self, command: Command) -> None:
        super().command(Command(command.velocity_rad_s, command.enable, command.clear))


class NoHeartbeatConsumer(DriveCia402):
    def __init__(self, options: Any, host: Any) -> None:
        super().__init__(options, host)
        self._heartbeat_id = 0x7FF


class ClearsWhatLatches(DriveCia402):
    def command(self, command: Command) -> None:
        super().command(dataclasses.replace(command, acknowledge=True))


class NeverCleared(DriveCia402):
    def command(self, command: Command) -> None:
        super().command(dataclasses.replace(command, acknowledge=False))


class Slow(DriveCia402):
    def command(self, command: Command) -> None:
        self.told = getattr(self, "told", -1) + 1
        if self.told % 8 == 0 or not command.enable:
            super().command(command)


class Holds(DriveCia402):
    def command(self, command: Command) -> None:
        super().command(Command() if command.release else command)


class KeepsItsZero(DriveCia402):
    def _receive(self, frame_id: int, data: bytes, now_s: float) -> None:
        known = self.referenced
        super()._receive(frame_id, data, now_s)
        self.referenced = known


@pytest.mark.parametrize(
    ("made", "options", "clause"),
    [
        (AlwaysKnown, netft(), "before the first message nothing is known"),
        (AlwaysKnown, netft(), "noise is no reading"),
        (NeverOld, netft(), "in a silence its value grows old, and it is heard again"),
        (NeverOld, netft(), "garbled messages are no readings"),
        (NeverOld, netft(), "a message that repeats itself grows old"),
        (SetUpOnce, netft(), "a restart is noticed, and it is heard again"),
        (WrongSign, netft(), "it measures torque, with its sign"),
        (Wrapped, text(), "it measures angles over any number of turns"),
        (Raises, text(), "noise is no reading"),
        (WakesByItself, cia402(), "it sleeps until a clear"),
        (WakesByItself, cia402(), "it stops by itself when its host falls silent, and sleeps until a clear"),
        (WrongScale, cia402(), "it turns as asked and counts what it turned, both ways, and stops"),
        (CountsBackwards, cia402(), "it turns as asked and counts what it turned, both ways, and stops"),
        (NoReference, cia402(), "it takes a reference"),
        (
            NoHeartbeatConsumer,
            cia402(),
            "it stops by itself when its host falls silent, and sleeps until a clear",
        ),
        (Holds, cia402(), "a release lets go of the base"),
        (ClearsWhatLatches, cia402(), "a fault that latches stays until a clear that a person gave"),
        (NeverCleared, cia402(), "a fault that latches stays until a clear that a person gave"),
        (
            Slow,
            cia402(lost_host_ms=100),
            "while it turns its angle is at most 100 ms old, at 50 to 1000 ticks a second",
        ),
    ],
)
def test_a_device_that_breaks_a_clause_is_found_out(made: type[Device], options: Any, clause: str) -> None:
    found = {c.name: c.broken for c in check_device(made, options, lambda: TWINS[options.device](options))}
    assert found[clause] is not None


def own_device(folder: Path, text: str) -> Path:
    path = folder / "config" / "devices" / "mine.py"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


GOOD = """
from needle_rig.config.schema import Section
from needle_rig.devices.device import TorqueSensor

class Mine(TorqueSensor):
    class Options(Section):
        port: str
        gain: float = 1.0

    def __init__(self, options, host):
        self.options = options
        self.link = host.serial(options.port, 9600, lambda data, now_s: None)

    def age_s(self, now_s):
        return 1e9
"""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("x = (", "mine.py:1: '(' was never closed; correct the file"),
        ("1 / 0", "mine.py:1: ZeroDivisionError while the file is read: division by zero"),
        ("x = 1", "mine.py:1: 0 classes derive from Device; a device's file has exactly one"),
        (
            GOOD.replace("(TorqueSensor)", "(Device)").replace("TorqueSensor", "Device"),
            "derive it from Drive",
        ),
        (GOOD.replace("Options(Section)", "Choices(Section)"), "has no Options"),
        (GOOD.replace("gain: float", "device: float"), "Options has a key `device`"),
        (GOOD.replace("options, host):", "options):"), "must be made by __init__(self, options, host)"),
        (GOOD.replace("def age_s", "def years"), "has no age_s"),
    ],
)
def test_a_file_that_is_no_device_gets_one_sentence_with_its_line(
    tmp_path: Path, text: str, told: str
) -> None:
    with pytest.raises(BadInput) as refused:
        load_device(own_device(tmp_path, text))
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def links(section: dict[str, Any]) -> Any:
    from needle_rig.config.schema import LinksSection

    return LinksSection.model_validate(
        {
            "can": {"channel": "x"},
            "hall": {"port": "x"},
            "drive": {"device": "cia402", **DRIVE},
            "torque": section,
        }
    )


def test_a_file_of_config_devices_is_chosen_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own_device(tmp_path, GOOD)
    monkeypatch.chdir(tmp_path)
    made = make_device(links({"device": "mine", "port": "/dev/x", "gain": 2.0}), "torque", MemoryHost())
    assert type(made).__name__ == "Mine"
    assert made.options.gain == 2.0  # type: ignore[attr-defined]
    assert made.link.place == "/dev/x"


@pytest.mark.parametrize(
    ("section", "told"),
    [
        ({"device": "mine"}, "links.torque: port is missing; add it"),
        ({"device": "mine", "port": "x", "gian": 2.0}, "gian: unknown key; did you mean gain?"),
        ({"device": "mine", "port": "x", "gain": "2"}, "gain: '2' is text, not a number; write 2"),
        ({"device": "yours"}, "'yours' is unknown; there are node, cia402, netft, text, mine;"),
    ],
)
def test_options_that_its_file_does_not_read_are_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, section: dict[str, Any], told: str
) -> None:
    own_device(tmp_path, GOOD)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput) as refused:
        make_device(links(section), "torque", MemoryHost())
    assert told in str(refused.value)


def test_a_file_for_another_link_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    own_device(tmp_path, GOOD)
    monkeypatch.chdir(tmp_path)
    wrong = links({"device": "mine", "port": "x"}).model_copy(
        update={"drive": links({"device": "mine"}).torque}
    )
    with pytest.raises(BadInput, match=r"mine\.py is for links\.torque; name one for drive"):
        make_device(wrong, "drive", MemoryHost())


def run(*arguments: str) -> tuple[int, str]:
    done = CliRunner().invoke(command, list(arguments), standalone_mode=False)
    if done.exception is not None:
        raise done.exception
    return done.return_value, done.output


def test_the_command_tells_every_clause_and_how_many_are_kept() -> None:
    code, output = run("text", "port=/dev/none", "checksum=true")
    assert code == 0
    assert "ok    noise is no reading" in output
    assert "8 of 8 clauses are kept" in output


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("text",), "text: port is missing; add it"),
        (("text", "port"), "'port' is no KEY=VALUE"),
        (("nothing",), "'nothing' is unknown"),
        (("cia402", "node_id=300"), "is above 127"),
    ],
)
def test_bad_use_is_one_sentence(arguments: tuple[str, ...], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        run(*arguments)


def test_a_file_without_a_twin_is_told_so(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="has no twin to be tried against"):
        run(str(own_device(tmp_path, GOOD)), "port=x")


TWIN = """
class Silent:
    def reset(self, now_s): pass
    def receive(self, now_s, frame_id, data): pass
    def step(self, now_s): return ()
    def page(self, path): raise KeyError(path)
"""


def test_a_device_that_breaks_the_contract_ends_with_1(tmp_path: Path) -> None:
    with_twin = (
        GOOD + "\n    @classmethod\n    def simulated(cls, options):\n        return Silent()\n" + TWIN
    )
    code, output = run(str(own_device(tmp_path, with_twin)), "port=x")
    assert code == 1
    assert "fail  before the first message nothing is known: its value is said to be 1e+09 s old" in output


def test_a_device_of_another_make_has_no_page_to_calibrate() -> None:
    from needle_rig.calibration.stand import RealStand
    from tests.closed_loop.other_devices import config_of

    with pytest.raises(BadInput, match=r"links\.drive\.device: cia402 keeps no calibration of ours"):
        RealStand(config_of(), lambda text: None)


def amplifier(tmp_path: Path, good: str, broken: str) -> Any:
    """What check-device says of the example with one line broken."""
    page = (Path(__file__).parents[3] / "docs/how-to/own-device.md").read_text(encoding="utf-8")
    text = page.split("```python\n")[1].split("```")[0]
    assert good in text
    path = tmp_path / "amplifier.py"
    path.write_text(text.replace(good, broken))
    return CliRunner().invoke(command, [str(path), "port=/dev/ttyUSB0"], standalone_mode=False)


def test_a_device_of_one_s_own_that_cannot_be_made_breaks_every_clause(tmp_path: Path) -> None:
    made = "def __init__(self, options, host):\n"
    done = amplifier(tmp_path, made, made + "        raise KeyError('port')\n")
    assert done.return_value == 1
    assert "it raised KeyError: 'port'" in done.output
    assert "ok" not in done.output.split("\n", 1)[0]


def test_a_twin_that_raises_is_told_with_its_file(tmp_path: Path) -> None:
    done = amplifier(tmp_path, "        return Twin()\n", "        return options.nothing\n")
    assert isinstance(done.exception, BadInput)
    assert "amplifier.py: it raises AttributeError" in str(done.exception)


def test_a_link_that_leads_to_itself_is_no_device(tmp_path: Path) -> None:
    path = tmp_path / "round.py"
    path.symlink_to(path)
    with pytest.raises(BadInput, match="round"):
        load_device(path)
