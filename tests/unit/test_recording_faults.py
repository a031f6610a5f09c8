"""A sample of the campaigns of `recording_faults`: no row may be wrong after any of them."""

from pathlib import Path

import pytest

from campaigns.rig import recording_faults


@pytest.mark.whole
def test_power_cuts(tmp_path: Path) -> None:
    tally = recording_faults.cuts(18, tmp_path, 1)
    assert tally.good, tally
    assert tally.torn_seen, "no end was torn: the cuts test nothing"


@pytest.mark.whole
def test_full_disks(tmp_path: Path) -> None:
    tally = recording_faults.full(6, tmp_path, 4)
    assert tally.good, tally
    assert tally.counts["run stopped, or its file not made"], "no disk was full: they test nothing"


@pytest.mark.real_time
def test_kills(tmp_path: Path) -> None:
    tally = recording_faults.kills(6, tmp_path, 1)
    assert tally.good, tally
    assert tally.lost_s, "no kill fell into a run: they test nothing"
