import pytest

from needle_rig.workbench.selection.rivals import cannot_be_told_apart

CLOSE = 10.0


@pytest.mark.parametrize(
    ("behind", "missed", "share", "tied"),
    [
        (0.9 * CLOSE, 0.0, 1.0, True),
        (1.1 * CLOSE, 0.0, 1.0, False),
        (-CLOSE, 0.0, 1.0, True),
        (1.1 * CLOSE, CLOSE, 1.0, True),
        (2.1 * CLOSE, CLOSE, 1.0, False),
        (2.9 * CLOSE, 0.0, 0.5, True),
        (3.1 * CLOSE, 0.0, 0.5, False),
        (5.9 * CLOSE, CLOSE, 0.5, True),
        (6.1 * CLOSE, CLOSE, 0.5, False),
    ],
)
def test_what_is_close_beside_what_is_missed_ties_and_three_times_that_when_trials_disagree(
    behind: float, missed: float, share: float, tied: bool
) -> None:
    assert cannot_be_told_apart(behind, missed=missed, share=share) is tied


@pytest.mark.parametrize(("gain", "tied"), [(0.9 * CLOSE, False), (1.1 * CLOSE, True), (None, True)])
def test_what_only_generalises_another_is_no_rival_of_it(gain: float | None, tied: bool) -> None:
    assert cannot_be_told_apart(0.0, gain_over_special=gain) is tied
    assert cannot_be_told_apart(0.0, share=0.5, gain_over_special=gain) is tied
