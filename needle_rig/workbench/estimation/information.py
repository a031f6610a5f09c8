"""What a fit's data say of the shared parameters, apart from every prior: their likelihood, as a Gaussian.

About the fit's parameters x̂ (p,), with steps δ, −2 log likelihood = δᵀ Λ δ − 2 gᵀ δ up to a constant, the
random effects and nuisances marginalised. Λ is singular where the data do not see a direction; a posterior
has a prior beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.gaussian import Gaussian
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.problem import Fit, Problem

SEEN = 1e-3
"""Information over that of the prior below which data say nothing of a direction: 0.05 % narrower."""


@dataclass(frozen=True)
class Information:
    """Fisher information of a fit's data on the shared parameters, and the score at the fit."""

    at: Array
    """Logarithms of friction (N) and torsional rigidity (N·m²), scaled values of effects (p,)."""
    matrix: Array
    """Λ (p, p)."""
    score: Array
    """g (p,): half the slope of 2 log likelihood."""
    constraint: Array
    """Precision (p, p) that holds constrained means of items."""

    @classmethod
    def of(cls, problem: Problem, found: Fit) -> Information:
        """About a fit. A trial's friction is a draw about the common one, with the scatter of the fit."""
        linear = LinearisedFit.of(problem, found)
        p = linear.p
        matrix = np.sum(linear.information, axis=0)
        friction = found.vector.trial_friction
        pushes = [t.push(t.residuals, float(b)) for t, b in zip(linear.trials, friction, strict=True)]
        score = np.sum(pushes, axis=0)
        rest = matrix[p:, p:] + np.eye(matrix.shape[0] - p)
        carried = np.linalg.solve(rest, np.column_stack([matrix[p:, :p], score[p:] - found.nuisance]))
        return cls(
            found.vector.shared,
            matrix[:p, :p] - matrix[:p, p:] @ carried[:, :p],
            score[:p] - matrix[:p, p:] @ carried[:, p],
            linear.level[:p, :p],
        )

    def posterior(self, prior: Gaussian) -> Gaussian:
        """The product of the likelihood and a prior (Bayes' theorem)."""
        precision = np.linalg.inv(prior.covariance)
        covariance = np.linalg.inv(self.matrix + precision + self.constraint)
        step = covariance @ (self.score - precision @ (self.at - prior.mean) - self.constraint @ self.at)
        return Gaussian(self.at + step, np.asarray(covariance, dtype=np.float64))

    def conflict(self, prior: Gaussian) -> float:
        """p value of what the data say, predicted by the prior (Box 1980): small where the two contradict.

        Directions that the data do not see are left out.
        """
        root = np.linalg.cholesky(prior.covariance)
        seen, directions = np.linalg.eigh(root.T @ self.matrix @ root)
        use = seen > SEEN
        away = directions.T @ root.T @ (self.score + self.matrix @ (self.at - prior.mean))
        squares = away[use] ** 2 / (seen[use] * (1.0 + seen[use]))
        return float(chdtrc(max(1, int(use.sum())), squares.sum()))
