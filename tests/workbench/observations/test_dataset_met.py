"""Independent check: with the right effect fitted, data made by another code is met to its noise."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needle_rig.dataset import Dataset, read_dataset
from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel, predict_batch
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.units import per_length_n, rad

PRACTICE = Path(__file__).parents[2] / "data" / "practice"
TORQUE_NOISE_NM, HALL_NOISE_RAD = 0.0008e-3, rad(0.25)
SCATTER, RIGIDITY_SIGMA = 0.02, 0.02
EFFECTS = find_effects()
Make = Callable[[np.ndarray], tuple[Effect, ...]]


def made(name: str, *values: Any) -> Effect:
    make: Callable[..., Effect] = EFFECTS[name]
    return make(*values)


CASES: dict[str, tuple[Make, list[float], list[float]]] = {
    "none": (lambda x: (), [], []),
    "elastic": (lambda x: (made("tissue_elasticity", x[0]),), [0.4], [0.01]),
    "layers": (lambda x: (made("layered_friction", tuple(x)),), [0.5, 0.8, 1.2, 1.5], [0.01] * 4),
    "backlash": (lambda x: (made("chuck_backlash", x[0]),), [5.0], [0.05]),
    "bias": (lambda x: (made("torque_bias", x[0]),), [0.01], [1e-3]),
    "two": (
        lambda x: (made("tissue_elasticity", x[0]), made("tip_friction", x[1])),
        [0.4, 0.03],
        [0.01, 0.001],
    ),
}
TRUTH: dict[str, list[float]] = {
    "none": [],
    "elastic": [0.45],
    "layers": [0.3, 0.8, 1.3, 1.6],
    "backlash": [6.0],
    "bias": [0.02],
    "two": [0.5, 0.035],
}


class Fit:
    """Gauss-Newton with damping over friction, rigidity, viscous slip, effects, and a factor a trial."""

    def __init__(self, dataset: Dataset, make: Make, start: list[float], steps: list[float]) -> None:
        self.dataset, self.make = dataset, make
        self.shared = np.array([0.11, 0.0, 0.002, *start])
        self.steps = np.array([2e-4, 2e-3, 1e-3, *steps])
        self.own = np.zeros(len(dataset.trials))

    def residuals(self, shared: np.ndarray, own: np.ndarray, every: int = 4) -> list[np.ndarray]:
        """Of each trial (samples, channels), in units of the noise."""
        rigidity = self.dataset.needle.torsional_rigidity_nm2 * np.exp(shared[1])
        effects = (*self.make(shared[3:]), made("viscous_slip", max(shared[2], 0.0)))
        model = NeedleModel("fit", self.dataset.layout, rigidity, per_length_n(shared[0]), effects)
        models = [model.with_effects(FrictionOfTrial(1.0 + f)) for f in own]
        trials = [
            Trial(t.trial.time_s[::every], t.trial.base_angle_rad[::every], t.trial.start_s, t.trial.index)
            for t in self.dataset.trials
        ]
        return [
            np.column_stack(
                [
                    (reading.torque_nm - t.torque_nm[::every]) / TORQUE_NOISE_NM,
                    (reading.hall_rad - t.hall_rad[::every]) / HALL_NOISE_RAD,
                ]
            )
            for t, reading in zip(self.dataset.trials, predict_batch(models, trials), strict=True)
        ]

    def cost(self, residuals: list[np.ndarray], shared: np.ndarray, own: np.ndarray) -> float:
        """Twice the negative log posterior."""
        return float(
            sum((r**2).sum() for r in residuals)
            + (shared[1] / RIGIDITY_SIGMA) ** 2
            + ((own / SCATTER) ** 2).sum()
        )

    def run(self) -> None:
        count, trials = len(self.shared), len(self.own)
        now = self.residuals(self.shared, self.own)
        cost, damping = self.cost(now, self.shared, self.own), 1e-3
        for _ in range(15):
            columns = []
            for k in range(count):
                moved = self.shared.copy()
                moved[k] += self.steps[k]
                changed = self.residuals(moved, self.own)
                columns.append([(a - b).ravel() / self.steps[k] for a, b in zip(changed, now, strict=True)])
            each = [
                (a - b).ravel() / 2e-3
                for a, b in zip(self.residuals(self.shared, self.own + 2e-3), now, strict=True)
            ]
            normal = np.diag([0.0, RIGIDITY_SIGMA**-2, *[0.0] * (count - 2), *[SCATTER**-2] * trials])
            gradient = normal @ np.concatenate([self.shared, self.own])
            for i in range(trials):
                part = np.column_stack([*(c[i] for c in columns), each[i]])
                at = np.array([*range(count), count + i])
                normal[np.ix_(at, at)] += part.T @ part
                gradient[at] += part.T @ now[i].ravel()
            gain = 0.0
            for _ in range(8):
                step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -gradient)
                shared, own = self.shared + step[:count], self.own + step[count:]
                shared[2] = max(shared[2], 0.0)
                after = self.residuals(shared, own)
                if (new := self.cost(after, shared, own)) < cost:
                    gain, cost, now = cost - new, new, after
                    self.shared, self.own, damping = shared, own, damping / 5
                    break
                damping *= 10
            if gain < 0.3:
                return


@pytest.mark.parametrize("name", list(CASES))
def test_practice_dataset_is_met_to_its_noise(name: str) -> None:
    make, start, steps = CASES[name]
    fit = Fit(read_dataset(PRACTICE / name), make, start, steps)
    fit.run()
    full = fit.residuals(fit.shared, fit.own, every=1)
    per_channel = np.mean([(r**2).mean(axis=0) for r in full], axis=0)
    # Samples are independent here, so chi² per sample is 1 within about 0.02 of chance.
    assert per_channel == pytest.approx(np.ones(5), abs=0.04)
    assert abs(fit.shared[1]) < 0.002
    if name == "layers":
        # friction and a factor common to all sections are one number
        common = fit.shared[3:].mean()
        assert fit.shared[0] * common == pytest.approx(0.11, rel=0.025)
        assert fit.shared[3:] / common == pytest.approx(TRUTH[name], rel=0.03)
    else:
        assert fit.shared[0] == pytest.approx(0.11, rel=0.025)
        assert fit.shared[3:] == pytest.approx(TRUTH[name], rel=0.02)


def test_the_null_model_does_not_meet_an_effect() -> None:
    """The check has teeth: without its effect, elastic data is far off."""
    fit = Fit(read_dataset(PRACTICE / "elastic"), *CASES["none"])
    fit.run()
    assert np.mean([(r**2).mean() for r in fit.residuals(fit.shared, fit.own)]) > 20
