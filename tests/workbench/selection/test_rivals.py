import dataclasses
import math

import pytest

from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.rivals import cannot_be_told_apart, find_rivals
from needle_rig.workbench.selection.unknown_starts import FoundStarts, Holder
from tests.workbench.hidden import dataset, effect, few

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


def test_what_foretells_as_well_from_the_unknown_starts_that_it_finds_itself_is_a_rival() -> None:
    found = diagnose(
        dataset(effect("tip_friction", torque_nmm=0.03)),
        few("tip_friction", "platform_friction", "hall_offset"),
    )
    named, others = "tip_friction", ("platform_friction", "hall_offset")
    assert found.effects == (named,)
    fits = {name: found.search.fits[frozenset({name})][0] for name in (named, *others)}
    values = 2.0 * found.baseline.problem.size

    def tied(behind: dict[str, float], least: float = 1000.0, owner: str = named) -> set[str]:
        holders = {
            name: Holder(fits[name].vector, fits[name], 0.9 * math.exp(behind.get(name, 0.0) / values))
            for name in fits
        }
        error = 0.9 * math.exp(least / values)
        starts = FoundStarts(
            found.baseline, dataclasses.replace(fits[named], effects=(owner,)), holders, error
        )
        rivals = find_rivals(found.search, Work(), 0, starts)[1]
        assert all(r.held is holders[r.effect] for r in rivals[named] if r.tied)
        return {r.effect for r in rivals[named] if r.tied}

    far = dict.fromkeys(others, 1.1 * CLOSE)
    assert tied(far) == set()
    assert tied(far | {"platform_friction": 0.9 * CLOSE}) == {"platform_friction"}
    assert tied(dict.fromkeys(others, 0.0)) == set(others)
    assert tied(dict.fromkeys(others, 0.0), least=0.9 * CLOSE) == set()
    assert tied(dict.fromkeys(others, 0.0), owner="platform_friction") == set()
