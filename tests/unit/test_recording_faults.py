"""A sample of the campaigns of scripts/recording_faults: no row may be wrong after any of them."""

import importlib.machinery
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "scripts" / "recording_faults"


@pytest.fixture(scope="module")
def campaigns() -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("recording_faults", str(SCRIPT))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[loader.name] = module
    loader.exec_module(module)
    return module


@pytest.mark.whole
def test_power_cuts(campaigns: ModuleType, tmp_path: Path) -> None:
    tally = campaigns.cuts(18, tmp_path, 1)
    assert tally.good, tally.table("cuts")
    assert tally.torn_seen, "no end was torn: the cuts test nothing"


@pytest.mark.whole
def test_full_disks(campaigns: ModuleType, tmp_path: Path) -> None:
    tally = campaigns.full(6, tmp_path, 4)
    assert tally.good, tally.table("full")
    assert tally.counts["run stopped, or its file not made"], "no disk was full: they test nothing"


@pytest.mark.real_time
def test_kills(campaigns: ModuleType, tmp_path: Path) -> None:
    tally = campaigns.kills(6, tmp_path, 1)
    assert tally.good, tally.table("kills")
    assert tally.lost_s, "no kill fell into a run: they test nothing"
