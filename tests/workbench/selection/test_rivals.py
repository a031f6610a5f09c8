import pytest

from needle_rig.workbench.selection.rivals import cannot_be_told_apart

CLOSE = 10.0


@pytest.mark.parametrize(("gain", "tied"), [(0.9 * CLOSE, False), (1.1 * CLOSE, True), (None, True)])
def test_what_only_generalises_another_is_no_rival_of_it(gain: float | None, tied: bool) -> None:
    assert cannot_be_told_apart(0.0, gain_over_special=gain) is tied
