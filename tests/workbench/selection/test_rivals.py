import pytest

from needle_rig.workbench.selection.rivals import CLOSE, cannot_be_told_apart


@pytest.mark.parametrize(
    ("behind", "missed", "sure", "tied"),
    [
        (0.9 * CLOSE, 0.0, True, True),
        (1.1 * CLOSE, 0.0, True, False),
        (-CLOSE, 0.0, True, True),
        (1.1 * CLOSE, CLOSE, True, True),
        (2.1 * CLOSE, CLOSE, True, False),
        (2.9 * CLOSE, 0.0, False, True),
        (3.1 * CLOSE, 0.0, False, False),
        (5.9 * CLOSE, CLOSE, False, True),
        (6.1 * CLOSE, CLOSE, False, False),
    ],
)
def test_what_is_close_beside_what_is_missed_ties_and_three_times_that_when_trials_disagree(
    behind, missed, sure, tied
):
    assert cannot_be_told_apart(behind, missed=missed, sure=sure) is tied


@pytest.mark.parametrize(("gain", "tied"), [(0.9 * CLOSE, False), (1.1 * CLOSE, True), (None, True)])
def test_what_only_generalises_another_is_no_rival_of_it(gain, tied):
    assert cannot_be_told_apart(0.0, gain_over_special=gain) is tied
    assert cannot_be_told_apart(0.0, sure=False, gain_over_special=gain) is tied
