"""Setting up a service below another root: all is there, twice changes nothing, and it can be taken away."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from needle_rig.cli import install_service
from needle_rig.cli.main import run
from needle_rig.config.files import shipped_file
from needle_rig.config.loader import load_rig_config
from needle_rig.errors import BadInput
from needle_rig.service.installed.installation import Installation
from needle_rig.service.setup.install import installed_program, refuse_unable, unit_text
from needle_rig.service.setup.rig_file import Answers, rig_file_text

pytestmark = pytest.mark.skipif(
    not all(map(shutil.which, ("systemd-sysusers", "systemctl", "userdel"))), reason="no systemd here"
)
NETWORKD = "usr/lib/systemd/system/systemd-networkd.service"
HALL = "/dev/serial/by-id/usb-hall"


@pytest.fixture
def place(tmp_path: Path) -> Installation:
    """A root in which systemd-networkd is installed and off."""
    service = tmp_path / "root" / NETWORKD
    service.parent.mkdir(parents=True)
    service.write_text("[Service]\nExecStart=/bin/true\n[Install]\nWantedBy=multi-user.target\n")
    return Installation(tmp_path / "root")


def put_in_place(place: Installation, *options: str) -> int:
    return run(["install-service", "--root", str(place.root), *options])


def files(place: Installation) -> dict[str, str]:
    """Every file and link with what it holds, but for the locks and copies of shadow's tools."""
    found = {}
    for path in sorted(place.root.rglob("*")):
        if path.is_symlink():
            found[str(path.relative_to(place.root))] = f"→ {path.readlink()}"
        elif path.is_file() and not path.name.endswith(("-", ".lock")):
            found[str(path.relative_to(place.root))] = path.read_text()
    return found


def test_all_that_a_service_needs_is_there(place: Installation) -> None:
    assert (
        put_in_place(place, "--hall", HALL, "--bitrate", "500", "--name", "the one: here", "--member", "anna")
        == 0
    )
    rig = load_rig_config(place.rig_file)
    assert (rig.name, rig.kind) == ("the one: here", "hardware")
    assert (rig.links.can.interface, rig.links.can.channel, rig.links.hall_port) == (
        "socketcan",
        "can0",
        HALL,
    )
    assert rig.recording.directory == "/var/lib/needle-rig"
    half_gb = shutil.disk_usage(place.root).total / 2e9
    assert rig.recording.keep_gb == pytest.approx(half_gb, rel=0.01)
    network = place.network("can0").read_text()
    assert "Name=can0" in network
    assert "BitRate=500000" in network
    assert "RestartSec=100ms" in network
    assert "needle-rig" in (place.root / "etc/passwd").read_text()
    groups = dict(line.split(":", 1) for line in (place.root / "etc/group").read_text().splitlines())
    assert groups["needle-rig"].endswith(":anna")
    assert groups["dialout"].endswith(":needle-rig")
    wants = place.root / "etc/systemd/system/multi-user.target.wants"
    assert {link.name for link in wants.iterdir()} == {"needle-rig.service", "systemd-networkd.service"}
    assert place.udev_rules.is_file()
    assert place.link.readlink() == Path("/opt/needle-rig/bin/needle-rig")
    assert place.signs({}) == [place.unit, place.rig_file]


def test_a_second_time_changes_nothing(place: Installation, capsys: pytest.CaptureFixture[str]) -> None:
    put_in_place(place, "--hall", HALL, "--member", "anna")
    place.rig_file.write_text(place.rig_file.read_text().replace("settle_s: 3.0", "settle_s: 4.0"))
    before = files(place)
    capsys.readouterr()
    assert put_in_place(place, "--member", "anna") == 0
    assert "nothing was changed" in capsys.readouterr().out
    assert files(place) == before


def test_another_member_joins_those_that_are_there(place: Installation) -> None:
    put_in_place(place, "--hall", HALL, "--member", "anna")
    assert put_in_place(place, "--member", "ben") == 0
    assert ":anna,ben\n" in (place.root / "etc/group").read_text()


def test_a_dry_run_shows_every_file_and_makes_none(
    place: Installation, capsys: pytest.CaptureFixture[str]
) -> None:
    before = files(place)
    assert put_in_place(place, "--hall", HALL, "--dry-run") == 0
    shown = capsys.readouterr().out
    assert files(place) == before
    units = (place.unit, place.failed_unit)
    for path in (place.rig_file, *units, place.udev_rules, place.network("can0"), place.sysusers):
        assert f"write {path}\n" in shown
    assert HALL in shown
    assert "systemd-sysusers" in shown


def test_it_is_taken_away_but_for_runs_and_rig_file(place: Installation) -> None:
    before = files(place)
    put_in_place(place, "--hall", HALL, "--can", "vcan0", "--member", "anna")
    assert place.device("vcan0").is_file()
    place.runs.mkdir(parents=True)
    (place.runs / "a.h5").write_text("a run")
    text = place.rig_file.read_text()
    assert put_in_place(place, "--remove") == 0
    left = files(place)
    assert left.pop("etc/needle-rig/rig.yaml.removed") == text
    assert left.pop("var/lib/needle-rig/a.h5") == "a run"
    # networkd may serve others by now, and people and their groups are not ours
    assert left.keys() - before.keys() <= {
        "etc/group",
        "etc/gshadow",
        "etc/passwd",
        "etc/shadow",
        "etc/systemd/system/multi-user.target.wants/systemd-networkd.service",
    }
    assert "needle-rig" not in left["etc/passwd"] + left["etc/group"]
    assert place.signs({}) == []
    assert put_in_place(place, "--remove") == 0


def test_a_program_where_the_link_would_be_stays(place: Installation) -> None:
    place.link.parent.mkdir(parents=True)
    place.link.write_text("installed by somebody else")
    assert put_in_place(place, "--hall", HALL) == 0
    assert put_in_place(place, "--remove") == 0
    assert place.link.read_text() == "installed by somebody else"


def test_another_program_at_the_place_of_the_link_stays_and_is_told(
    place: Installation, capsys: pytest.CaptureFixture[str]
) -> None:
    put_in_place(place, "--hall", HALL)
    place.link.unlink()
    place.link.symlink_to("/usr/bin/env")
    capsys.readouterr()
    assert put_in_place(place) == 0
    assert f"{place.link} was not made by this service and stays" in capsys.readouterr().err
    assert put_in_place(place, "--remove") == 0
    assert f"{place.link} stays: it is not the service's" in capsys.readouterr().out
    assert place.link.readlink() == Path("/usr/bin/env")


def test_a_second_installation_moves_unit_and_link(
    place: Installation, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    put_in_place(place, "--hall", HALL)
    second = Path("/opt/needle-rig-2/bin/needle-rig")
    monkeypatch.setattr(install_service, "_program", lambda *_: second)
    assert put_in_place(place) == 0
    assert place.program == second
    assert place.link.readlink() == second
    assert "warning" not in capsys.readouterr().err
    before = files(place)
    assert put_in_place(place) == 0
    assert files(place) == before
    assert put_in_place(place, "--remove") == 0
    assert not place.link.is_symlink()


def test_taking_it_away_says_what_stays_and_takes_the_cache(
    place: Installation, capsys: pytest.CaptureFixture[str]
) -> None:
    put_in_place(place, "--hall", HALL)
    for path in (place.runs / "a.h5", place.cache / "solver.nbc", place.calibration / "hall.yaml"):
        path.parent.mkdir(parents=True)
        path.write_text("")
    capsys.readouterr()
    assert put_in_place(place, "--remove") == 0
    told = capsys.readouterr().out.splitlines()[-2:]
    assert told[0].startswith(f"The runs stay in {place.runs}")
    assert told[1] == f"Rig file, calibration and models stay in {place.rig_file.parent}."
    assert not place.cache.exists()
    assert (place.calibration / "hall.yaml").exists()


def test_a_dry_run_works_where_a_service_could_not_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    program = tmp_path / "bin/needle-rig"
    program.parent.mkdir()
    program.write_text("")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert run(["install-service", "--dry-run"]) == 0
    said = capsys.readouterr()
    assert "note: " in said.err
    assert "a service does not see /tmp" in said.err
    assert "PATH=/opt/needle-rig/bin" in said.out
    assert "Nothing was done." in said.out


def test_a_serial_adapter_needs_no_network(place: Installation) -> None:
    assert put_in_place(place, "--hall", HALL, "--can", "/dev/serial/by-id/usb-CANable") == 0
    can = load_rig_config(place.rig_file).links.can
    assert (can.interface, can.channel) == ("slcan", "/dev/serial/by-id/usb-CANable")
    assert place.networks() == []


def test_a_rig_file_that_is_named_is_taken_as_it_is(place: Installation, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(shipped_file("rig.hardware.yaml").read_text().replace("can0", "can7"))
    assert put_in_place(place, "--rig-file", str(mine)) == 0
    assert place.rig_file.read_text() == mine.read_text()
    assert [path.name for path in place.networks()] == ["60-needle-rig-can7.network"]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--hall", HALL, "--length", "5"), "length_mm"),
        (("--rig-file", "nowhere.yaml"), "nowhere.yaml"),
        ((), "--hall is missing"),
    ],
    ids=str,
)
def test_what_cannot_be_used_is_refused_before_anything_is_done(
    place: Installation,
    options: tuple[str, ...],
    words: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("needle_rig.cli.install_service._serial_ports", list)
    before = files(place)
    assert put_in_place(place, *options) == 2
    assert words in capsys.readouterr().err
    assert files(place) == before


def test_an_answer_is_text_whatever_it_looks_like() -> None:
    answers = Answers("it's: {a} # rig", "can0", 1000, "/dev/tty'x: 1", 397, 0.39, 27.2, 50.0)
    text = rig_file_text(answers, Path("/a b/c"))
    assert "'it''s: {a} # rig'" in text
    assert "/dev/tty''x: 1" in text


def test_the_unit_runs_the_needle_rig_that_installed_it() -> None:
    assert "Environment=PATH=/srv/venv/bin:/usr/bin:/bin" in unit_text(Path("/srv/venv/bin/needle-rig"))


def test_what_runs_stay_is_said(place: Installation, capsys: pytest.CaptureFixture[str]) -> None:
    put_in_place(place, "--hall", HALL)
    said = capsys.readouterr().out
    assert (
        "Runs that were exported or diagnosed are removed: the oldest while all runs take more than" in said
    )
    lines = place.rig_file.read_text().splitlines(keepends=True)
    place.rig_file.write_text("".join(line for line in lines if "keep_gb" not in line))
    put_in_place(place, "--member", "anna")
    assert "Every run stays, until the disk is full" in capsys.readouterr().out


def named(place: Installation, tmp_path: Path, torque: str) -> int:
    """The exit code for the shipped rig file with another torque sensor."""
    text = shipped_file("rig.hardware.yaml").read_text(encoding="utf-8")
    rig_file = tmp_path / "rig.yaml"
    units = "position_units_per_turn: 409600, velocity_units_per_rpm: 100"
    others = f"  drive: {{device: cia402, node_id: 5, {units}}}\n  torque: {torque}\n"
    rig_file.write_text(text.replace("links:\n", f"links:\n{others}", 1))
    return put_in_place(place, "--rig-file", str(rig_file))


@pytest.mark.parametrize(
    ("address", "family"), [("192.168.1.1", "AF_INET"), ("fe80::1", "AF_INET6")], ids=["IPv4", "IPv6"]
)
def test_a_sensor_on_the_network_may_be_reached_and_nothing_else(
    place: Installation, tmp_path: Path, address: str, family: str
) -> None:
    assert named(place, tmp_path, f"{{device: netft, address: '{address}'}}") == 0
    unit = place.unit.read_text()
    assert f"RestrictAddressFamilies=AF_UNIX AF_CAN AF_NETLINK {family}\n" in unit
    assert f"IPAddressDeny=any\nIPAddressAllow={address}\n" in unit
    before = files(place)
    assert put_in_place(place) == 0
    assert files(place) == before


def test_a_sensor_that_leaves_the_rig_file_leaves_the_unit(place: Installation, tmp_path: Path) -> None:
    named(place, tmp_path, "{device: netft, address: 192.168.1.1}")
    text = place.rig_file.read_text()
    lines = text.splitlines(keepends=True)
    devices = ("  torque: {device", "  drive: {device")
    place.rig_file.write_text("".join(line for line in lines if not line.startswith(devices)))
    assert put_in_place(place) == 0
    assert "IPAddressAllow" not in place.unit.read_text()


def test_a_sensor_by_its_name_is_refused_with_what_to_do(
    place: Installation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = files(place)
    assert named(place, tmp_path, "{device: netft, address: sensor.lab}") == 2
    assert (
        "links.torque.address is 'sensor.lab'; a service may reach an IP address" in capsys.readouterr().err
    )
    assert files(place) == before


def test_networkmanager_leaves_the_bus_alone_where_it_is_installed(place: Installation) -> None:
    put_in_place(place, "--hall", HALL)
    assert not (place.root / "etc/NetworkManager").exists()
    (place.root / "etc/NetworkManager").mkdir()
    assert put_in_place(place) == 0
    told = place.unmanaged("can0").read_text().splitlines()
    assert told[-2:] == ["[keyfile]", "unmanaged-devices+=interface-name:can0"]
    assert put_in_place(place, "--remove") == 0
    assert not place.unmanaged("can0").exists()


def test_a_failure_runs_a_program_of_this_computer(place: Installation) -> None:
    put_in_place(place, "--hall", HALL)
    assert f"OnFailure={place.failed_unit.name}\n" in place.unit.read_text()
    hook = place.failed_unit.read_text()
    program = f"/{place.on_failure.relative_to(place.root)}"
    assert f"ConditionFileIsExecutable={program}\n" in hook
    assert f"timeout 60 {program} {place.unit.name}\n" in hook
    put_in_place(place, "--remove")
    assert not place.failed_unit.exists()


def test_systemd_takes_both_units(place: Installation, tmp_path: Path) -> None:
    if not shutil.which("systemd-analyze"):
        pytest.skip("no systemd-analyze here")
    put_in_place(place, "--hall", HALL)
    for unit in (place.unit, place.failed_unit):
        (tmp_path / unit.name).write_text(unit.read_text())
    names = [str(tmp_path / unit.name) for unit in (place.unit, place.failed_unit)]
    done = subprocess.run(["systemd-analyze", "verify", *names], capture_output=True, text=True)
    assert not [line for line in done.stderr.splitlines() if str(tmp_path) in line], done.stderr


def test_nothing_is_begun_without_systemd_or_without_root(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="systemd does not run here"):
        refuse_unable(0, tmp_path / "none")
    with pytest.raises(BadInput, match="sudo needle-rig install-service"):
        refuse_unable(1000, tmp_path)
    refuse_unable(0, tmp_path)


@pytest.mark.parametrize("prefix", ["/home/anna/venv", "/root/venv"])
def test_a_program_that_a_service_does_not_see_is_refused(
    prefix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", prefix)
    monkeypatch.setattr(Path, "is_file", lambda _: True)
    with pytest.raises(BadInput, match="/opt/needle-rig"):
        installed_program()
