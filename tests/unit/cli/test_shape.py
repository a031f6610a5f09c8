"""The shape of the command line: groups, nearest names, one meaning an option, completion, Ctrl-C."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from needle_rig.cli._groups import GROUPS, LOOKED_FOR
from needle_rig.cli._renamed import RENAMED, in_new_words
from needle_rig.cli.main import Commands, group, run
from needle_rig.errors import BadInput
from needle_rig.service.api.orders import read_order

assert isinstance(group, Commands)
CONTEXT = click.Context(group)
NAMES = group.list_commands(CONTEXT)
TERMINAL_COLUMNS = 80


def options(command: str) -> dict[str, click.Option]:
    found = group.get_command(CONTEXT, command)
    assert found is not None
    return {name: p for p in found.params if isinstance(p, click.Option) for name in p.opts}


def every(name: str) -> Iterator[tuple[str, click.Option]]:
    """Each command that has an option of this name."""
    for command in NAMES:
        if (option := options(command).get(name)) is not None:
            yield command, option


def test_every_command_stands_in_one_group_with_a_line_that_fits() -> None:
    listed = [name for lines in GROUPS.values() for name in lines]
    assert sorted(listed) == NAMES
    told = CliRunner().invoke(group, ["--help"]).stdout.splitlines()
    entries = [line for line in told if line.split(" ", 3)[2:3] and line.split()[0] in NAMES]
    assert len(entries) == len(NAMES)
    assert max(map(len, entries)) <= TERMINAL_COLUMNS
    assert not [line for line in entries if line.endswith(("...", "…"))]


@pytest.mark.parametrize(
    ("typed", "meant"), [("diagnoze", "diagnose"), ("stauts", "status"), *LOOKED_FOR.items()]
)
def test_an_unknown_command_gets_the_nearest(
    typed: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert meant in NAMES
    assert run([typed]) == 2
    assert f"Did you mean {meant}?" in capsys.readouterr().err


def test_a_word_that_is_near_nothing_gets_no_guess(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["qqqq"]) == 2
    assert "Did you mean" not in capsys.readouterr().err


@pytest.mark.parametrize("change", RENAMED, ids=lambda c: f"{c.command} {c.old}")
@pytest.mark.parametrize("equals", [True, False])
def test_an_old_spelling_works_with_a_warning(
    change: object, equals: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    old, new = change.old, change.new  # type: ignore[attr-defined]
    command, kept = change.command, change.kept  # type: ignore[attr-defined]
    assert new in options(command)
    assert bool(kept) == (old in options(command))
    words = [f"{old}=x"] if equals else [old, "x"]
    assert in_new_words(command, [*words, "--", old]) == [
        *([f"{new}=x"] if equals else [new, "x"]),
        "--",
        old,
    ]
    assert f"{old} of {command} is called {new} now" in capsys.readouterr().err
    for value in kept:
        assert in_new_words(command, [old, value]) == [old, value]
    assert in_new_words(command, [new, "x"]) == [new, "x"]
    assert capsys.readouterr().err == ""


def test_an_old_spelling_reaches_its_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", str(tmp_path / "no.h5"), "--png"]) == 2
    told = capsys.readouterr().err
    assert told.startswith("warning: --png of export is called --picture now")
    assert "no.h5" in told


def test_an_option_means_the_same_everywhere() -> None:
    for command, option in every("--rig"):
        assert isinstance(option.type, click.Choice), command
        assert set(option.type.choices) <= {"simulated", "bench"}, command
    for command, option in every("--config"):
        assert (option.help or "").startswith("Rig file"), command
    for command, option in every("--png"):
        assert not option.is_flag, command
    for command, option in every("--pictures"):
        assert option.metavar == "DIR", command
    for command, option in every("--picture"):
        assert option.is_flag or option.flag_value, command
    for command, option in every("--out"):
        assert not option.is_flag, command


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["history", "m.yaml", "--png", "picdir"],
            "--png picdir: names no kind of picture; let it end in .png",
        ),
        (
            ["compare", "data", "--pictures", "x.png"],
            "--pictures x.png: is the name of a picture; name a folder",
        ),
    ],
)
def test_a_picture_is_a_file_with_an_ending_and_pictures_a_folder(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == 2
    assert capsys.readouterr().err.startswith(said)


def test_the_first_help_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--help"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80


@pytest.mark.parametrize(
    "name", ["--target", "--extra", "--by", "--to", "--here", "--move", "--speed", "--settle"]
)
def test_a_quantity_says_its_unit(name: str) -> None:
    found = [
        (command, option) for command, option in every(name) if not isinstance(option.type, click.Choice)
    ]
    assert found
    for command, option in found:
        unit = {"--speed": "DEG/S", "--settle": "S"}.get(name, "DEG")
        assert option.metavar == unit, command


@pytest.mark.parametrize(
    ("words", "begun", "found"),
    [
        ([], "diag", "diagnose"),
        (["compensate", "--strategy"], "my", "my_lag"),
        (["compensate", "--strategy"], "reed2008_", "reed2008_elastic"),
        (["compensate", "--protocol"], "st", "standard"),
        (["simulate", "--effect"], "tip_f", "tip_friction"),
        (["simulate", "--parameters"], "rig_r", "rig_rigid"),
        (["compare", "--model"], "rig_e", "rig_elastic"),
        (["effects"], "tissue_e", "tissue_elasticity"),
        (["parameters"], "paper", "paper_literal"),
    ],
)
def test_a_shell_completes_names(
    words: list[str], begun: str, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "config" / "strategies").mkdir(parents=True)
    (tmp_path / "config" / "strategies" / "my_lag.py").write_text("raise SystemExit  # it is not run\n")
    monkeypatch.chdir(tmp_path)
    shell = ShellComplete(group, {}, "needle-rig", "_NEEDLE_RIG_COMPLETE")
    assert found in [item.value for item in shell.get_completions(words, begun)]


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({"target_deg": 4500.0}, "target_deg: 4500.0 is above 3600; give 3600 at most"),
        ({"target_deg": 1.0, "speed_deg_s": -5.0}, "speed_deg_s: -5.0 is below 0.1; give 0.1 at least"),
    ],
)
def test_an_order_out_of_range_gets_its_limit(order: dict[str, float], words: str) -> None:
    with pytest.raises(BadInput) as caught:
        read_order("compensate", order)
    assert str(caught.value) == words


def test_a_file_for_a_strategy_gets_its_home(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["compensate", "--target", "45", "--strategy", "./my_lag.py"]) == 2
    assert "config/strategies/my_lag.py" in capsys.readouterr().err


INTERRUPTED = """
import os, signal, sys
import needle_rig.__main__ as program

class Presses:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Presses())
sys.argv = ["needle-rig", "effects"]
program.main()
"""


@pytest.mark.parametrize(
    ("module", "said"),
    [("needle_rig.cli.main", ["Stopped."]), ("needle_rig.physics.library", ["stopping …", "Stopped."])],
)
def test_ctrl_c_while_python_imports_leaves_no_traceback(module: str, said: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED.format(module=module)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 4, done.stderr
    assert done.stderr.split("\n")[-1] == ""
    assert [line for line in done.stderr.splitlines() if line] == said
