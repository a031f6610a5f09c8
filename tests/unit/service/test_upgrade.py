"""Another version for the service: switched in one step, and taken back where more fails than before."""

from __future__ import annotations

import fcntl
from collections.abc import Sequence
from pathlib import Path

import pytest

from needle_rig.config.files import shipped_file
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.service.installed.installation import Installation
from needle_rig.service.setup import upgrade as upgrade_module
from needle_rig.service.setup.install import unit_text
from needle_rig.service.setup.upgrade import Versions, roll_back, upgrade, versions_of


class Computer:
    """A service's computer whose commands do what the real ones do to files; `fails` names what does not."""

    def __init__(self, root: Path) -> None:
        self.place = Installation(root)
        self.versions = versions_of(self.place)
        self.flat = root / "opt/needle-rig"
        for path, text in (
            (self.place.rig_file, shipped_file("rig.hardware.yaml").read_text(encoding="utf-8")),
            (self.place.unit, unit_text(self.flat / "bin/needle-rig")),
            (self.flat / "bin/needle-rig", ""),
        ):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        self.commands: list[str] = []
        self.fails: dict[str, type[BaseException]] = {}
        self.failures: dict[str, dict[str, str]] = {}
        self.running = self.flat
        self.said: list[str] = []

    def run(self, command: Sequence[str], _: float | None) -> str:
        shown = " ".join(command)
        self.commands.append(shown)
        for part, error in self.fails.items():
            if part in shown:
                del self.fails[part]
                raise error(f"{part} failed")
        if "-m venv" in shown:
            (Path(command[-1]) / "bin").mkdir(parents=True)
        elif "pip install" in shown:
            Path(command[0]).with_name("needle-rig").write_text("")
        elif "--version" in shown:
            return f"needle-rig, version {Path(command[0]).parent.parent.name}\n"
        elif "install-service" in shown:
            self.place.unit.write_text(unit_text(self.versions.python.with_name("needle-rig")))
        elif "systemctl restart" in shown:
            assert self.place.program is not None
            self.running = self.place.program.parent.parent.resolve()
        return ""

    def told(self, sentence: str) -> None:
        self.said.append(sentence)

    def upgrade(self, wanted: str = "0.2.0") -> None:
        upgrade(self.place, wanted, self.told)


@pytest.fixture
def computer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Computer:
    made = Computer(tmp_path)
    monkeypatch.setattr(upgrade_module, "_run", made.run)
    monkeypatch.setattr(upgrade_module, "_failures", lambda path: made.failures.get(path.name, {}))
    monkeypatch.setattr(upgrade_module, "find_daemon", lambda: None)
    monkeypatch.setattr(upgrade_module, "_LINKS_S", 0.0)
    monkeypatch.setattr(upgrade_module, "_AGAIN_S", 0.01)
    return made


def test_a_version_is_installed_beside_and_used_and_the_way_back_is_known(computer: Computer) -> None:
    computer.upgrade()
    assert computer.running == computer.flat / "0.2.0"
    assert computer.place.program == computer.flat / "current/bin/needle-rig"
    assert computer.versions.previous == computer.flat
    assert [path.suffix for path in (computer.flat / "backups").iterdir()] == [".zip"]
    computer.upgrade("0.3.0")
    assert computer.running == computer.flat / "0.3.0"
    roll_back(computer.place, computer.told)
    assert computer.running == computer.flat / "0.2.0"
    # and to and fro
    roll_back(computer.place, computer.told)
    assert computer.running == computer.flat / "0.3.0"
    # what was installed once is not installed anew
    computer.commands.clear()
    computer.upgrade("0.2.0")
    assert not [command for command in computer.commands if "pip" in command]


def test_a_wheel_is_named_by_its_file(computer: Computer, tmp_path: Path) -> None:
    wheel = tmp_path / "needle_rig-0.2.0-py3-none-any.whl"
    with pytest.raises(BadInput, match="no wheel of needle-rig that is there"):
        computer.upgrade(str(wheel))
    wheel.write_text("")
    computer.upgrade(str(wheel))
    assert f"pip install --quiet {wheel}" in "\n".join(computer.commands)
    assert computer.running.name == "0.2.0"


@pytest.mark.parametrize("part", ["install-service", "systemctl restart"])
@pytest.mark.parametrize("error", [NeedleRigError, KeyboardInterrupt])
def test_what_fails_after_the_switch_is_taken_back(
    computer: Computer, part: str, error: type[BaseException]
) -> None:
    computer.upgrade("0.2.0")
    computer.fails = {part: error}
    with pytest.raises(RigFault if error is NeedleRigError else KeyboardInterrupt):
        computer.upgrade("0.3.0")
    assert computer.running == computer.flat / "0.2.0"
    assert computer.versions.previous == computer.flat  # the way back is what it was


@pytest.mark.parametrize("part", ["-m venv", "pip install", "--version", "load_rig_config"])
@pytest.mark.parametrize("error", [NeedleRigError, KeyboardInterrupt])
def test_what_fails_before_the_switch_changes_nothing(
    computer: Computer, part: str, error: type[BaseException]
) -> None:
    computer.fails = {part: error}
    with pytest.raises(error):
        computer.upgrade()
    assert not [command for command in computer.commands if "systemctl" in command]
    assert computer.versions.current is None
    # the next try makes it anew, also where the computer went off in between
    (computer.flat / "0.2.0/.whole").unlink(missing_ok=True)
    computer.upgrade()
    assert computer.running.name == "0.2.0"


def test_what_failed_before_the_upgrade_is_no_reason_to_go_back_and_what_is_new_is(
    computer: Computer,
) -> None:
    computer.failures = {computer.flat.name: {"drive": "stopped"}, "0.2.0": {"drive": "the stop is pressed"}}
    computer.upgrade("0.2.0")
    assert computer.running.name == "0.2.0"
    computer.failures["0.3.0"] = {"drive": "stopped", "hall node": "no value came"}
    with pytest.raises(RigFault, match=r"0\.3\.0 was taken back: hall node: no value came; the service runs"):
        computer.upgrade("0.3.0")
    assert computer.running.name == "0.2.0"


def test_a_run_that_goes_on_is_waited_for(computer: Computer) -> None:
    journal = computer.place.runs / "now.journal"
    journal.parent.mkdir(parents=True)
    journal.write_bytes(b"")
    text = computer.place.rig_file.read_text().replace("directory: runs", "directory: /var/lib/needle-rig")
    computer.place.rig_file.write_text(text)
    held = open(journal, "rb")  # noqa: SIM115 - the test closes it
    fcntl.flock(held, fcntl.LOCK_EX)

    def told(sentence: str) -> None:
        computer.told(sentence)
        if sentence.startswith("wait"):
            assert computer.running == computer.flat
            held.close()

    upgrade(computer.place, "0.2.0", told)
    assert [sentence for sentence in computer.said if "now: this run goes on" in sentence]
    assert computer.running.name == "0.2.0"


def test_what_cannot_be_is_refused(computer: Computer, tmp_path: Path) -> None:
    for wanted in ("../x", "latest", "0.2.0;rm"):
        with pytest.raises(BadInput, match="give a wheel"):
            computer.upgrade(wanted)
    with pytest.raises(BadInput, match="there is no version before"):
        roll_back(computer.place, computer.told)
    computer.upgrade("0.2.0")
    with pytest.raises(BadInput, match=r"runs 0\.2\.0 already"):
        computer.upgrade("0.2.0")
    with open(computer.flat / ".lock") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(BadInput, match="another upgrade goes on"):
            computer.upgrade("0.3.0")
    with pytest.raises(BadInput, match="no service is set up here"):
        upgrade(Installation(tmp_path / "none"), "0.2.0", computer.told)


def test_a_switch_that_is_cut_off_leaves_a_version_that_is_whole(tmp_path: Path) -> None:
    versions = Versions(tmp_path)
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    versions.switch(tmp_path / "a", tmp_path / "a")
    (tmp_path / ".current.new").symlink_to("nowhere")  # left by a power cut
    versions.switch(tmp_path / "b", tmp_path / "a")
    assert (versions.current, versions.previous) == (tmp_path / "b", tmp_path / "a")
