"""A hypothesis at its most probable parameters, and what it predicts there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from fenics_joints.diagnosis.evidence.hypothesis import Hypothesis
from fenics_joints.diagnosis.evidence.scales import Scales


@dataclass(frozen=True, repr=False)
class Fit:
    """A hypothesis at its most probable parameters.

    Attributes:
        hypothesis: The hypothesis.
        z: Parameters in prior standard deviations, shape (d,).
        covariance: Posterior covariance of z (Laplace), shape (d, d).
        predicted: Everything predicted, held out or not, as `Evidence.data`, shape (N,).
        shape: Numbers of conditions and modes, (n, m).
        jacobian: Derivative of `predicted` by z, shape (N, d).
        log_evidence: ln of the marginal likelihood of the fitted entries.
        misfit: Squared whitened residual of the fitted entries.
        n_data: Number of fitted entries.
        scales: The most probable standard deviations of those that the data infer.
        widening: ln of the evidence over the evidence at these.
        stated: Of errors that are stated at most: the least misfit + |z|^2 if all of them is there,
            linear about the fit; None where none are.
        placed: Of an unknown cause, the probability that it is a change somewhere
            (`fenics_joints.diagnosis.evidence.localised_unknown`), and does not move modes
            independently; None where the test has no signatures.
        simulated: Probability that the best explanation of a test like this one, made by a cause of
            the library, leaves as much as this leaves of the real one
            (`fenics_joints.diagnosis.evidence.linear_fits`); None where none were simulated.
    """

    hypothesis: Hypothesis
    z: np.ndarray
    covariance: np.ndarray
    predicted: np.ndarray
    shape: tuple[int, int]
    jacobian: np.ndarray
    log_evidence: float
    misfit: float
    n_data: int
    scales: Scales | None = None
    widening: float = 0.0
    stated: float | None = None
    placed: float | None = None
    simulated: float | None = None

    def __repr__(self) -> str:
        label = self.hypothesis.label
        return f"Fit({label}: ln Z {self.log_evidence:.2f}, misfit {self.misfit:.1f})"

    @property
    def at_bound(self) -> tuple[str, ...]:
        """Names of parameters at a limit of their prior."""
        near = np.flatnonzero(self.hypothesis.at_limit(self.z))
        pairs = [self.hypothesis.priors[i] for i in near]
        return tuple(f"{effect.name}: {prior.name}" for effect, prior in pairs)

    @property
    def log_f(self) -> np.ndarray:
        """Predicted ln f, shape (n, m)."""
        n, m = self.shape
        return self.predicted[: n * m].reshape(n, m)

    @property
    def log_damping(self) -> np.ndarray | None:
        """Predicted ln of the damping ratios, shape (n, m); None if they are not predicted."""
        n, m = self.shape
        if not self.hypothesis.damped:
            return None
        return self.predicted[n * m : 2 * n * m].reshape(n, m)

    @property
    def square(self) -> float:
        """Least misfit + |z|^2, the data's distance from the prediction in the metric of errors and
        prior together.

        Standard deviations between levels count by their distance from the expected ones. Errors
        that are stated as limits are taken at these limits: a misfit is what they cannot explain.
        """
        if self.stated is not None:
            return self.stated
        scales = 0.0 if self.scales is None else self.scales.squares
        return float(self.misfit + self.z @ self.z + scales)

    @property
    def p_value(self) -> float:
        """Probability of a misfit as large as this, if the hypothesis were right.

        By `simulated` tests; else, in the linear-Gaussian case and for a hypothesis that was not
        chosen among others, `square` is distributed as chi-square with n_data degrees.
        """
        if self.simulated is not None:
            return self.simulated
        return float(chi2.sf(self.square, self.n_data))
