"""The result of an update by either method, its iterations, and notes for its reader."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_joints.files import dataframe
from fenics_joints.formatting import html_table, number, percent, quantity
from fenics_joints.modal.sensitivity import Identifiability
from fenics_joints.reduction.frf_basis import ModelError
from fenics_joints.structure.components import Parameter
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

    def to_dataframe(self):
        """A ``pandas.DataFrame`` with parameter, start, value and sd, in SI units.

        Raises:
            InputError: If pandas is not installed.
        """
        return dataframe(
            {"parameter": self.names, "start": self.start, "value": self.values, "sd": self.sd}
        )

    def mapping(self) -> dict[str, float]:
        """The values by name."""
        return dict(zip(self.names, self.values.tolist(), strict=True))


# -- notes on an update ----------------------------------------------------------------------------


#: Distance from a bound within which a value counts as stopped there, relative to the bound where
#: the scale is logarithmic, otherwise to the room between the bounds; chosen.
_AT_BOUND = 2e-3
#: Factor of standard deviations from which a note tells that they were widened; chosen.
_WIDENED = 1.05
#: Words for each kind of a reduced model's errors, and their decimals in per cent.
_ERRORS = {
    "frequencies": ("frequencies by", 3),
    "frfs": ("FRFs by up to", 2),
    "damping": ("damping ratios by up to", 2),
}


def too_far(error: ModelError, limits: ModelError) -> list[str]:
    """What of a reduced model is further from the full one than the limits allow, in words."""
    return [
        f"{words} {percent(getattr(error, key), digits)}"
        for key, (words, digits) in _ERRORS.items()
        if (getattr(error, key) or 0.0) > getattr(limits, key)
    ]


def fit_notes(found: Update, mode_names: Sequence[str]) -> list[str]:
    """What a reader has to know of the way in which a fit ended."""
    notes, widths = [], found.widths
    if not found.converged:
        notes.append(f"the fit has {found.message}; its values are the best ones found")
    factors = {
        "frequencies": [widths.frequencies],
        "shapes": widths.shapes,
        "damping ratios": [widths.damping],
    }
    wide = [
        f"{kind} {_times(min(some), max(some))}"
        for kind, some in factors.items()
        if max(some, default=1.0) >= _WIDENED
    ]
    if wide:
        notes.append(
            "the model does not reproduce the test within the standard deviations of the data, "
            f"which the fit therefore widened: {', '.join(wide)}"
        )
    left = [mode_names[i] for i in widths.without]
    if left:
        names = " and ".join([", ".join(left[:-1]), left[-1]] if len(left) > 1 else left)
        do, were = (
            ("changes its partner", "was") if len(left) == 1 else ("change their partners", "were")
        )
        notes.append(
            f"{names} {do} among the model's modes near the solution and {were} not fitted; "
            "more accurate measured shapes would identify the partners"
        )
    return notes


def _times(low: float, high: float) -> str:
    """A factor, or the range of several."""
    low, high = number(low, 2), number(high, 2)
    return f"{high} times" if low == high else f"{low} to {high} times"


def bound_notes(parameters: Sequence[Parameter], found: Update) -> list[str]:
    """What a reader has to know of parameters at or beyond their bounds."""
    notes = []
    for p, value in zip(parameters, found.values, strict=True):
        if found.method == "weighted":
            if not p.lower <= value <= p.upper:
                notes.append(
                    f"{p.name} is outside its bounds, {quantity(p.lower, p.unit)} to "
                    f"{quantity(p.upper, p.unit)}, which the weighted equations do not enforce"
                )
            continue
        notes += [
            f"{p.name} ended at its bound, {quantity(bound, p.unit)}: the best value lies beyond "
            "this limit, and its standard deviation is not meaningful"
            for bound in (p.lower, p.upper)
            if is_at(p, value, bound)
        ]
    return notes


def is_at(parameter: Parameter, value: float, bound: float) -> bool:
    """Whether a value is as good as at a bound."""
    if not np.isfinite(bound):
        return False
    room = parameter.upper - parameter.lower
    size = abs(bound) if parameter.log or not np.isfinite(room) else room
    size = size or abs(parameter.value)
    return abs(value - bound) <= _AT_BOUND * size
