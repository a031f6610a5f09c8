"""The algebra of the linearised fit against one dense stacked matrix, on three trials."""

import dataclasses
from collections.abc import Collection

import numpy as np
import pytest

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.linear import (
    LinearisedFit,
    Projection,
    TrialTerms,
    prediction_covariance,
)
from needle_rig.workbench.estimation.posterior import LEVEL

SIZES, P, T, Q = (14, 11, 9), 6, 3, 2
ITEMS = np.array([3, 4, 5])
PRECISION = np.r_[0.0, 2500.0, 0.01, 0.25, 0.25, 0.25, np.full(T, 400.0), np.ones(Q)]


def toy(
    *, constrained: tuple[Array, ...] = (), lumped: bool = True, blind: bool = False, alike: bool = False
) -> LinearisedFit:
    """Three trials; `lumped`: the random effect is a direction of its own; `blind`: nothing tells of
    the first scaled value; `alike`: two scaled values can hardly be told apart."""
    random = np.random.default_rng(5)
    trials = []
    for size in SIZES:
        columns = 30.0 * random.standard_normal((size, P + 1 + Q))
        if not lumped:
            columns[:, P] = columns[:, 0]
        if blind:
            columns[:, 2] = 1e-6
        if alike:
            columns[:, 4] = columns[:, 3] + 0.01 * random.standard_normal(size)
        trials.append(TrialTerms(random.standard_normal(size), columns, P, 400.0))
    from_centre = 0.1 * random.standard_normal(P + T + Q)
    from_centre[0] = 0.0
    from_centre[P : P + T] -= from_centre[P : P + T].mean()
    for places in constrained:
        from_centre[places] -= from_centre[places].mean()
    return LinearisedFit(tuple(trials), from_centre, PRECISION, tuple(constrained), np.arange(T))


def dense(
    linear: LinearisedFit, *, trials: Collection[int] = range(T), mean_of_trials: bool = False
) -> tuple[Array, Array]:
    """(rows, values): data, priors as rows, and a very heavy row for every mean that is held."""
    data = np.zeros((sum(SIZES), P + T + Q))
    begin = 0
    for t, terms in enumerate(linear.trials):
        random_effect = np.zeros((terms.residuals.size, T))
        random_effect[:, t] = terms.columns[:, P]
        part = np.hstack([terms.columns[:, :P], random_effect, terms.columns[:, P + 1 :]])
        data[begin : begin + terms.residuals.size] = part
        begin += terms.residuals.size
    kept = np.repeat([t in trials for t in range(T)], SIZES)
    tight = np.sqrt(PRECISION)
    means = np.zeros((0, P + T + Q))
    for places in [*linear.constrained_means, *([np.arange(P, P + T)] if mean_of_trials else [])]:
        row = np.zeros((1, P + T + Q))
        row[0, places] = (np.sqrt(LEVEL) if mean_of_trials else 1e6) / places.size
        means = np.vstack([means, row])
    values = np.concatenate([t.residuals for t in linear.trials])[kept]
    rows = np.vstack([data[kept], np.diag(tight), means])
    return rows, np.r_[values, -tight * linear.from_centre, np.zeros(len(means))]


def test_a_step_is_the_least_squares_solution_of_the_stacked_rows() -> None:
    linear = toy()
    rows, values = dense(linear, mean_of_trials=True)
    step = np.linalg.solve(linear.curvature + linear.level, linear.descent)
    assert step == pytest.approx(np.linalg.lstsq(rows, values, rcond=None)[0], abs=1e-4)
    assert abs((step + linear.from_centre)[P : P + T].mean()) < 1e-4 < np.abs(step[P : P + T]).max()


@pytest.mark.parametrize("constrained", [(), (ITEMS,)])
def test_the_covariance_is_that_of_the_stacked_rows_and_of_a_draw_of_the_trials_mean(
    constrained: tuple[Array, ...],
) -> None:
    linear = toy(constrained=constrained)
    rows, _ = dense(linear, mean_of_trials=True)
    inverse = np.linalg.inv(rows.T @ rows)[:P, :P]
    data = rows[: sum(SIZES)]
    carried = np.linalg.lstsq(data[:, :P], data[:, P : P + T].sum(1), rcond=None)[0]
    expected = inverse + np.outer(carried, carried) / 400.0 / T
    assert linear.covariance == pytest.approx(expected, rel=0.01, abs=1e-5)


@pytest.mark.parametrize("constrained", [(), (ITEMS,)])
def test_projection_leaves_the_residual_of_least_squares(constrained: tuple[Array, ...]) -> None:
    linear = toy(constrained=constrained)
    rows, values = dense(linear)
    left = values - rows @ np.linalg.lstsq(rows, values, rcond=None)[0]
    size = sum(SIZES) + P + T + Q
    assert linear.projection.missed == pytest.approx(left[:size], abs=1e-6)


def test_a_constrained_mean_is_nothing_that_parameters_can_fit() -> None:
    """All items together are a direction that the fit does not have: what looks like it is left."""
    free, constrained = toy().projection, toy(constrained=(ITEMS,)).projection
    together = toy().columns[:, ITEMS].sum(1)
    apart = toy().columns[:, ITEMS] @ np.array([1.0, -0.5, -0.5])
    assert np.linalg.norm(free(together)) < 0.05 * np.linalg.norm(together)
    assert np.linalg.norm(constrained(together)) > 0.5 * np.linalg.norm(together)
    assert np.linalg.norm(constrained(apart)) < 0.05 * np.linalg.norm(apart)


def test_a_projected_change_brings_its_share_of_the_random_effects() -> None:
    linear = toy()
    rows, _ = dense(linear)
    change, random_effect = np.linspace(-1.0, 2.0, sum(SIZES)), np.array([0.02, -0.03, 0.01])
    padded = np.zeros(len(rows))
    padded[: sum(SIZES)] = change
    padded[sum(SIZES) + P : sum(SIZES) + P + T] = random_effect * 20.0
    left = padded - rows @ np.linalg.lstsq(rows, padded, rcond=None)[0]
    assert linear.projection(change, random_effect) == pytest.approx(left, abs=1e-9)


def test_projected_means_are_those_of_the_averaged_rows() -> None:
    linear = toy()
    means = np.linalg.qr(np.random.default_rng(6).standard_normal((sum(SIZES), 15)))[0].T
    rows, values = dense(linear)
    rows = np.vstack([means @ rows[: sum(SIZES)], rows[sum(SIZES) :]])
    values = np.r_[means @ values[: sum(SIZES)], values[sum(SIZES) :]]
    left = values - rows @ np.linalg.lstsq(rows, values, rcond=None)[0]
    assert Projection(linear, means).missed == pytest.approx(left, abs=1e-9)


def test_the_stated_rigidity_against_the_data_is_the_projection_of_its_own_row() -> None:
    linear = toy()
    rows, _ = dense(linear)
    unit = np.zeros(len(rows))
    unit[sum(SIZES) + 1] = 1.0
    left = unit - rows @ np.linalg.lstsq(rows, unit, rcond=None)[0]
    assert linear.projection.rigidity() == pytest.approx(left, abs=1e-9)


@pytest.mark.parametrize("constrained", [(), (ITEMS,)])
def test_without_a_trial_the_covariance_is_that_of_the_other_rows(
    constrained: tuple[Array, ...],
) -> None:
    linear = toy(constrained=constrained)
    shared = np.r_[0:P, P + T : P + T + Q]
    rows, _ = dense(linear, trials=(0, 2))
    curvature, covariance = linear.without([1])
    assert covariance == pytest.approx(
        np.linalg.inv(rows.T @ rows)[np.ix_(shared, shared)], rel=1e-4, abs=1e-8
    )
    if not constrained:
        assert curvature @ covariance == pytest.approx(np.eye(shared.size), abs=1e-6)


def test_a_trial_pushes_the_shared_parameters_as_its_rows_do_with_its_random_effect_profiled_out() -> None:
    linear = toy()
    terms, at = linear.trials[1], 0.05
    rows = np.vstack([np.insert(terms.shared, 0, terms.random_effect, axis=1), np.zeros((1, 1 + P + Q))])
    rows[-1, 0] = 20.0
    values = np.r_[terms.residuals, -20.0 * at]
    random_effect = rows[:, :1]
    left = values - random_effect @ np.linalg.lstsq(random_effect, values, rcond=None)[0]
    freed = rows[:, 1:] - random_effect @ np.linalg.lstsq(random_effect, rows[:, 1:], rcond=None)[0]
    assert terms.push(terms.residuals, at) == pytest.approx(rows[:, 1:].T @ left, abs=1e-8)
    assert terms.information() == pytest.approx(freed.T @ freed, abs=1e-6)


def test_the_rank_counts_directions_that_the_data_see_beside_the_means_that_are_constrained() -> None:
    assert toy().rank == 4
    assert toy(constrained=(ITEMS,)).rank == 3
    assert toy(blind=True).rank == 3
    # a curve's coefficients have a prior, which pays for them
    assert dataclasses.replace(toy(), uncounted=(3,)).rank == 3


def test_a_prediction_is_as_uncertain_as_draws_of_the_parameters_make_it() -> None:
    random = np.random.default_rng(7)
    covariance = np.diag([0.1, 0.2, 0.05]) + 0.02
    columns = random.standard_normal((5, 4))
    draws = random.multivariate_normal(np.zeros(3), covariance, 200_000)
    random_effect = 0.3 * random.standard_normal(200_000)
    seen = np.cov(columns[:, :3] @ draws.T + np.outer(columns[:, 3], random_effect))
    assert prediction_covariance(covariance, 0.3**2, columns) == pytest.approx(seen, abs=0.02)


def test_of_trials_with_friction_of_one_kind_the_mean_makes_no_new_direction() -> None:
    """Where a trial's own friction acts as that of all does, only its prior tells of the trials' mean."""
    linear = toy(lumped=False)
    mean = np.zeros(P + T + Q)
    mean[0], mean[P : P + T] = 1.0, -1.0
    assert np.linalg.norm(linear.columns @ mean) < 1e-9
    assert mean @ linear.curvature @ mean == pytest.approx(400.0 * T)


def test_blocks_of_one_recorded_trial_move_alike() -> None:
    apart, alike = toy(), dataclasses.replace(toy(), recorded=np.r_[0, np.arange(T - 1)])
    ends = [
        np.linalg.solve(linear.curvature + linear.level, linear.descent) + linear.from_centre
        for linear in (apart, alike)
    ]
    free, tied = (abs(float(after[P] - after[P + 1])) for after in ends)
    assert tied < 0.02 * free  # the constraint is a spring of LEVEL beside the data's curvature
    difference = alike.columns[:, P] - alike.columns[:, P + 1]
    left = [float(np.linalg.norm(linear.projection(difference))) for linear in (apart, alike)]
    assert left[1] > 1.5 * left[0]


def test_leaving_out_the_trials_that_alone_tell_of_a_parameter() -> None:
    """What is left of its curvature is rounding, of either sign: it does not move, and nothing is NaN."""
    linear = toy()
    for t in (1, 2):
        linear.trials[t].columns[:, 2] = 0.0
    unprior = dataclasses.replace(linear, precision=np.r_[PRECISION[:2], 0.0, PRECISION[3:]])
    _, spread = unprior.without([0])
    assert np.isfinite(spread).all()
    assert np.abs(spread[2]).max() < 1e-9
    others = np.delete(np.arange(P + Q), 2)
    assert (np.diag(spread)[others] > 0.0).all()


def test_a_parameter_that_no_trial_tells_of_has_no_variance() -> None:
    """As friction has where the tip is clamped and no torque is recorded."""
    linear = toy()
    for trial in linear.trials:
        trial.columns[:, 0] = 0.0
    for group in ([0], [1], [2]):
        _, spread = linear.without(group)
        assert np.isfinite(spread).all()
        assert np.abs(spread[0]).max() == 0.0
