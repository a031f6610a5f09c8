import dataclasses

import pytest

from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.selection.evidence import improves_cross_validation
from tests.workbench.hidden import null_fit


@pytest.mark.parametrize(
    ("loss", "error", "relieved_sigmas", "speaks_for"),
    [
        (99.0, 1.20, 0.0, True),
        (101.0, 1.20, 0.0, False),
        (101.0, 1.20, 2.9, False),
        (101.0, 1.20, 3.1, True),
        (101.0, 1.20 * 1.0201, 3.1, False),
    ],
)
def test_the_needle_s_constants_stand_in_for_commands_left_out_but_not_against_them(
    loss: float, error: float, relieved_sigmas: float, speaks_for: bool
) -> None:
    child = null_fit(seed=21).current
    child = dataclasses.replace(child, pull_rigidity=0.0)
    parent = dataclasses.replace(child, pull_rigidity=relieved_sigmas)
    assert (
        improves_cross_validation(
            parent, CrossValidation(1.20, 100.0, ()), child, CrossValidation(error, loss, ())
        )
        is speaks_for
    )


def test_nothing_is_predicted_where_nothing_was_left_out() -> None:
    found = null_fit(seed=21).current
    parent = dataclasses.replace(found, pull_rigidity=5.0)
    child = dataclasses.replace(found, pull_rigidity=0.0)
    assert not improves_cross_validation(parent, None, child, CrossValidation(1.0, 1.0, ()))
