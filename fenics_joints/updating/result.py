"""What an update found, by either method, and the way there."""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import numpy as np

from fenics_joints.formatting import html_table, number, percent
from fenics_joints.modal.sensitivity import Identifiability
from fenics_joints.updating.prediction import Prediction
from fenics_joints.updating.residuals import Widths


@dataclass(frozen=True, eq=False, repr=False)
class Iteration:
    """A set of values on the way.

    Attributes:
        values: The parameters, (p,).
        frequency_errors: Model over test less 1, (m,).
        frf_errors: |H_model - H_test| / |H_test| at the test's lines, or at moved ones where
            ``moved``: median and largest; nan without FRFs.
        moved: Whether the lines were.
        cost: Half the sum of squared residuals in standard deviations; nan in the weighted way.
        condition_before: Condition number of A of Machines 2022, eq. 16: Hz and the FRFs' unit
            by the parameters' SI units; inf where the data have fewer rows than parameters.
        condition_after: That of what is solved: W_m A W_p (eq. 18), or the sensitivities in
            standard deviations by logarithms.
    """

    values: np.ndarray
    frequency_errors: np.ndarray
    frf_errors: tuple[float, float]
    moved: bool
    cost: float
    condition_before: float
    condition_after: float

    def __repr__(self) -> str:
        values = ", ".join(f"{v:.4g}" for v in self.values[:8])
        return f"Iteration({values}: cost {self.cost:.4g})"


@dataclass(frozen=True, eq=False)
class Update:
    """Parameters identified from a `Target`.

    Attributes:
        method: ``"weighted"`` (Machines 2022) or ``"log"``.
        names: Names of the parameters.
        start: Their values at the start, SI.
        values: Their values, SI.
        covariance: Covariance of the values, (p, p): the data's noise, its variances times
            ``excess``, propagated to first order; frequencies, shapes and FRFs are taken as
            independent of each other.
        identifiability: What the data alone determine, by logarithms (of ``log`` parameters).
        converged: Whether the iteration came to its end.
        message: Why it ended.
        evaluations: Sets of values at which the model was solved.
        history: The iterations, the start first.
        prediction: What the updated model says of the data, at the test's lines unless they were
            moved throughout.
        chi2: Sum of squared residuals in standard deviations, regularisation left out.
        degrees_of_freedom: What it is expected to be: independent data less parameters. Less where
            lines were moved throughout, since then one error of a frequency counts at many lines.
        excess: chi2 per degree of freedom with ``widths``, at least 1: where a model misses the
            data by more than their noise, its parameters are less certain than the noise says
            (Birge, Phys. Rev. 40, 1932). Covariance and identifiability include it.
        widths: Factors by which the data's standard deviations were widened, where the model cannot
            come as near to the test as they say; they count in covariance and identifiability.
    """

    method: str
    names: tuple[str, ...]
    start: np.ndarray
    values: np.ndarray
    covariance: np.ndarray
    identifiability: Identifiability
    converged: bool
    message: str
    evaluations: int
    history: tuple[Iteration, ...]
    prediction: Prediction
    chi2: float
    degrees_of_freedom: int
    widths: Widths = Widths()
    excess: float = 1.0

    @property
    def sd(self) -> np.ndarray:
        """Standard deviations of the values, SI, (p,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def relative_sd(self) -> np.ndarray:
        """Standard deviations relative to the values, (p,)."""
        return self.sd / np.abs(self.values)

    @property
    def log_covariance(self) -> np.ndarray:
        """Covariance of the values' logarithms, to first order, (p, p)."""
        return self.covariance / np.outer(self.values, self.values)

    def __repr__(self) -> str:
        found = ", ".join(
            f"{name}={value:.4g}" for name, value in zip(self.names, self.values, strict=True)
        )
        return f"Update({textwrap.shorten(found, 70, placeholder='...')}: {self.message})"

    def _repr_html_(self) -> str:
        rows = [
            (name, number(a, 4), number(b, 4), percent(sd, 1) if sd < 1 else "open")
            for name, a, b, sd in zip(
                self.names, self.start, self.values, self.relative_sd, strict=True
            )
        ]
        head = ("parameter", "start", "identified (SI)", "standard deviation")
        return html_table(f"Update, {self.message}", head, rows)

    def mapping(self) -> dict[str, float]:
        """The values by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))
