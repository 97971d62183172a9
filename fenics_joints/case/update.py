"""The ``[update]`` section of a case file: what to fit, to what, and how."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from fenics_joints.case.values import (
    CaseSection,
    File,
    Names,
    Number,
    Positive,
    Share,
    Spacing,
    Written,
    ascending,
    listed,
    quantity,
)
from fenics_joints.units import to_si


class Published(CaseSection):
    """``[update.published]``: somebody's values and frequencies, to show beside one's own.

    Attributes:
        source: Where they are from.
        parameters: Values by parameter.
        frequencies: Frequency of each mode of the test.
    """

    source: str = ""
    parameters: dict[str, Written] = {}
    frequencies: list[quantity("Hz", 0, above=True)] = []


class CutoffUpdate(CaseSection):
    """``[update.cutoff]``: the pressure below which a contact is lost (Fronk et al. 2019).

    Attributes:
        scheme: Contact conditions: two (stuck, open), three (stuck, sliding, open), or both.
        contacts: Names of the contacts; all that can open by default.
        calibrate: Parameter that is first fitted to one mode of the stuck model.
        max_solves: Most solutions of the model.
    """

    class Calibrate(CaseSection):
        """``[update.cutoff.calibrate]``.

        Attributes:
            parameter: Such as "beams.E".
            mode: A mode that the contact hardly moves.
        """

        parameter: str
        mode: str

    scheme: Literal["two", "three", "both"] = "both"
    contacts: Names | None = None
    calibrate: Calibrate | None = None
    max_solves: Annotated[int, Field(ge=5, le=10_000, strict=True)] = 15


def _lines(value: Any) -> Any:
    if isinstance(value, list):
        return [_line_hz(v) for v in value]
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ValueError("expected a whole number of lines from 1 on, or a list of frequencies")
    return value


def _line_hz(value: Any) -> float:
    hertz = to_si(value, "Hz")
    if not hertz > 0:
        raise ValueError("expected frequencies above 0 Hz")
    return hertz


class HeldSection(CaseSection):
    """``[update.held]``: what no fit sees and the updated model must predict.

    Attributes:
        modes: Modes by name, with the functions' lines around them; or "each": every mode in turn,
            predicted by a fit to all else.
        bands: Bands of frequency of the functions.
        responses: Responses of the functions by name.
    """

    modes: Names | None = None
    bands: Annotated[list[ascending(Spacing)], Field(min_length=1)] | None = None
    responses: Names | None = None

    @property
    def each(self) -> bool:
        """Whether every mode is held out in turn."""
        return self.modes == ["each"]


class PriorSection(CaseSection):
    """A prior, such as ``{ kind = "normal", mean = "1763 N m", sd = "88 N m" }``.

    Attributes:
        kind: Its distribution; `fenics_joints.bayes.priors.KINDS` says which numbers each kind
            needs.
    """

    model_config = ConfigDict(extra="allow", frozen=True)
    kind: str


def _a_table(value):
    """Refuse a prior that is not a table."""
    if not isinstance(value, dict | PriorSection):
        such = '{ kind = "lognormal", median = 1, log_sd = 0.5 }'
        raise ValueError(f"expected a table such as {such}")
    return value


#: Keys that a likelihood makes no use of.
_WITHOUT_EFFECT = {
    "gaussian": ("distributions", "scatter", "noise", "noise_known"),
    "fitted": ("scatter", "noise", "noise_known", "discrepancy"),
    "hierarchical": ("sampler",),
}


class Bayes(CaseSection):
    """``[update.bayes]``: a posterior of the parameters.

    A parameter without a prior has a lognormal one about its start, as wide as the regularisation.

    Attributes:
        likelihood: Of a table of specimens: "hierarchical" (their scatter and the lack of knowledge
            apart), "fitted" (the paper's: a product of a distribution for each mode) or "gaussian"
            (of the specimens' mean).
        specimens: Table with a row for each specimen and a column for each mode; without it the
            frequencies of the test are one set of data.
        distributions: Families from which the distribution of each mode is chosen.
        sampler: How samples are drawn.
        samples: How many are kept; 20,000 by default, 2,000 of the hierarchical likelihood.
        burn_in: How many are dropped before; a quarter of the samples by default.
        chains: Number of chains.
        seed: Of the random numbers.
        discrepancy: Relative error of frequencies of the best model; that of [diagnose] by default.
        scatter: Scale of the prior of the specimens' scatter.
        noise: Relative noise of a specimen's frequency: the scale of its prior.
        noise_known: Whether the noise is known, instead of having a prior.
        tolerance: Largest relative error of the reduced model's frequencies.
        priors: Prior of each parameter.
    """

    likelihood: Literal["gaussian", "fitted", "hierarchical"] | None = None
    specimens: File | None = None
    distributions: Names | None = None
    sampler: Literal["metropolis", "prior_metropolis", "emcee"] = "metropolis"
    samples: Annotated[int, Field(ge=10, le=10**7, strict=True)] | None = None
    burn_in: Annotated[int, Field(ge=0, le=10**7, strict=True)] | None = None
    chains: Annotated[int, Field(ge=2, le=1000, strict=True)] = 4
    seed: Annotated[int, Field(ge=0, le=2**32 - 1, strict=True)] = 1
    discrepancy: Share | None = None
    scatter: Share = 0.1
    noise: Share = 0.001
    noise_known: bool = False
    tolerance: Positive = 1e-4
    priors: dict[str, Annotated[PriorSection, BeforeValidator(_a_table)]] = {}

    @property
    def kind(self) -> str:
        """The likelihood, the default one put in."""
        return self.likelihood or ("gaussian" if self.specimens is None else "hierarchical")

    def length(self) -> tuple[int, int]:
        """Samples and burn-in: the paper's 20,000 and 5,000, but fewer of the costlier Gibbs."""
        samples = self.samples or (2000 if self.kind == "hierarchical" else 20000)
        return samples, samples // 4 if self.burn_in is None else self.burn_in

    def without_effect(self) -> list[str]:
        """Keys that were given though the likelihood makes no use of them, in words."""
        unused = [key for key in _WITHOUT_EFFECT[self.kind] if key in self.model_fields_set]
        return [
            f"update.bayes.{key} = {getattr(self, key)!r} has no effect with the {self.kind} "
            "likelihood"
            for key in unused
        ]


class UpdateSection(CaseSection):
    """``[update]``: what `fenics-joints update` fits: ``parameters``, or the ``cutoff``.

    Attributes:
        at: The condition; of frequencies alone all conditions are fitted by default.
        parameters: Names of the parameters, such as joint.E.
        start: Values to start from; the nominal ones by default.
        hold_out: Conditions that are not fitted.
        regularisation: Standard deviation of the logarithm of every parameter about its starting
            value; it decides what the data leave open.
        published: Somebody's values, to compare with.
        cutoff: The pressure below which a contact is lost.
        data: Kinds of data to fit. By default what there is: functions only with [damping], damping
            ratios only if a parameter of damping is fitted and they do not come from fitted
            functions.
        method: Logarithms of functions at frequencies relative to the resonances ("log"), or
            Machines 2022, eqs. 15 to 20 ("weighted").
        step_limit: Largest step of the weighted method, relative to each value; the paper has none.
        lines: Lines of the functions that are fitted: how many, or which frequencies.
        held: What no fit sees.
        bayes: A posterior of the parameters.
    """

    at: Number | None = None
    parameters: Names = []
    start: dict[str, Written] = {}
    hold_out: list[Number] = []
    regularisation: Positive = 2.3
    published: Published | None = None
    cutoff: CutoffUpdate | None = None
    data: (
        Annotated[
            list[Literal["frequencies", "shapes", "damping", "frfs"]],
            BeforeValidator(listed),
            Field(min_length=1),
        ]
        | None
    ) = None
    method: Literal["log", "weighted"] | None = None
    step_limit: Positive | None = None
    lines: Annotated[int | list[float], BeforeValidator(_lines)] | None = None
    held: HeldSection | None = None
    bayes: Bayes | None = None

    @model_validator(mode="after")
    def _one_of_parameters_and_cutoff(self) -> UpdateSection:
        if bool(self.parameters) == (self.cutoff is not None):
            raise ValueError("expected either parameters or a section [update.cutoff]")
        more = [*self.combined_keys(), *(["bayes"] if self.bayes is not None else [])]
        if self.cutoff is not None and more:
            raise ValueError(f"{', '.join(more)}: expected only with update.parameters")
        if self.step_limit is not None and self.method != "weighted":
            raise ValueError(
                f"step_limit = {self.step_limit:g}: expected only with method = 'weighted'"
            )
        return self

    def combined_keys(self) -> list[str]:
        """Keys that the file gives and only a fit to several kinds of data has."""
        return [k for k in ("data", "method", "lines", "held") if getattr(self, k) is not None]
