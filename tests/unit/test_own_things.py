"""Things of one's own: found in one home, by entry points too; a broken one leaves the others alone."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from needle_rig.cli.main import group
from needle_rig.config import own_things
from needle_rig.control.strategy import find_strategies, make_strategy
from needle_rig.devices.library import find_device
from needle_rig.errors import BadInput
from needle_rig.physics.library import built_in_effects, find_effects

ROOT = Path(__file__).parents[2]
STRATEGY = (ROOT / "needle_rig" / "control" / "strategies" / "single_lag.py").read_text(encoding="utf-8")
EFFECT = (ROOT / "needle_rig" / "physics" / "effects" / "tip_friction.py").read_text(encoding="utf-8")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder of one's own, with homes of all kinds."""
    for kind in own_things.SINGULAR:
        (tmp_path / "config" / kind).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "config"


def ran(*arguments: str) -> Result:
    return CliRunner().invoke(group, arguments, standalone_mode=False)


def test_a_strategy_of_ones_own_is_found_and_read_again_when_edited(home: Path) -> None:
    file = home / "strategies" / "my_lag.py"
    file.write_text(STRATEGY)
    assert make_strategy("my_lag", {}).expected_motions() == 2
    file.write_text(STRATEGY.replace("return 2", "return 7"))
    os.utime(file, ns=(1, 1))  # the clock of files is coarse
    assert make_strategy("my_lag", {}).expected_motions() == 7


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("return 2", "return = 2", r"broken\.py:\d+: invalid syntax"),
        ("@dataclass(frozen=True)", "", "is not a frozen dataclass"),
        ("def next(", "def following(", r"has no next; define next\(self, task, history\)"),
        ("task: Task, history: History", "task: Task", r"next must be def next\(self, task, history\)"),
        ("(Strategy)", "(object)", "0 classes derive from Strategy"),
        ("(Strategy):", "(Strategy):\n    turn_deg: float\n", "the option turn_deg has no default"),
    ],
)
def test_a_broken_strategy_is_named_and_the_others_go_on(home: Path, old: str, new: str, words: str) -> None:
    assert old in STRATEGY
    (home / "strategies" / "broken.py").write_text(STRATEGY.replace(old, new, 1))
    (home / "strategies" / "good.py").write_text(STRATEGY)
    found = find_strategies()
    assert {"good", "reed2008"} <= set(found)
    assert "broken" not in found
    with pytest.raises(BadInput, match=words) as caught:
        make_strategy("broken", {})
    assert str(caught.value).startswith(str(home / "strategies" / "broken.py"))


def test_a_name_that_is_taken_or_that_no_order_can_say(home: Path) -> None:
    for name in ("reed2008", "My-Lag"):
        (home / "strategies" / f"{name}.py").write_text(STRATEGY)
    told = dict(find_strategies().broken)
    assert "taken by a built-in strategy; rename" in told["reed2008"]
    assert "no name for orders" in told["My-Lag"]


def test_effects_lists_the_others_and_then_the_broken_one(home: Path) -> None:
    (home / "effects" / "bad.py").write_text("x = = 1\n")
    done = ran("effects")
    assert done.return_value == 2
    assert "tissue_elasticity" in done.stdout
    assert "bad.py:1: invalid syntax" in done.stderr
    listed = json.loads(ran("effects", "--json").stdout)
    assert len(listed["effects"]) == len(built_in_effects())
    assert "bad.py:1" in listed["broken"][0]


def test_simulate_says_that_a_file_is_broken_and_goes_on(home: Path) -> None:
    (home / "effects" / "bad.py").write_text("x = = 1\n")
    done = ran("simulate", "--effect", "tissue_elasticity", "--rate-hz", "5", "--out", "d")
    assert done.exception is None
    assert done.stderr.startswith("warning: ")
    assert "bad.py:1: invalid syntax" in done.stderr
    asked = ran("simulate", "--effect", "bad", "--out", "e")
    assert "bad.py:1: invalid syntax" in str(asked.exception)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A laboratory's installed package with one thing of each kind, and an entry point that is wrong."""
    site = tmp_path / "site"
    lab = site / "lab_of_a_test"
    lab.mkdir(parents=True)
    (lab / "__init__.py").touch()
    (lab / "lab_lag.py").write_text(STRATEGY)
    (lab / "lab_friction.py").write_text(EFFECT)
    (lab / "lab_broken.py").write_text("1 / 0\n")
    told = site / "lab_of_a_test-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-of-a-test\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(
        "[needle_rig.strategies]\nlab_lag = lab_of_a_test.lab_lag\nlab_broken = lab_of_a_test.lab_broken\n"
        "[needle_rig.effects]\nlab_friction = lab_of_a_test.lab_friction\n"
        "other = lab_of_a_test.lab_friction\n"
        "[needle_rig.devices]\nlab_missing = lab_of_a_test.lab_missing\n"
    )
    monkeypatch.syspath_prepend(str(site))
    own_things._entries.cache_clear()
    yield lab
    own_things._entries.cache_clear()
    for name in [name for name in sys.modules if name.startswith("lab_of_a_test")]:
        del sys.modules[name]


@pytest.mark.usefixtures("home", "package")
def test_a_package_brings_things_by_entry_points() -> None:
    strategies, effects = find_strategies(), find_effects()
    assert strategies["lab_lag"].name == "lab_lag"
    assert effects["lab_friction"].name() == "lab_friction"
    assert (
        "entry point lab_broken of lab-of-a-test: ZeroDivisionError" in dict(strategies.broken)["lab_broken"]
    )
    assert "must be a module whose last word is other" in dict(effects.broken)["other"]
    with pytest.raises(BadInput, match="entry point lab_missing of lab-of-a-test: ModuleNotFoundError"):
        find_device("drive", "lab_missing")
