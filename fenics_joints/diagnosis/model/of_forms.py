"""A model by forms and a test from a script as the case that a diagnosis takes.

Such a case has no parts, joints or masses: what may be wrong is the model's parameters, the test,
and what effects of one's own say.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import PrivateAttr, ValidationError

from fenics_joints.case.messages import case_error, describe, did_you_mean
from fenics_joints.case.sections import PartSection
from fenics_joints.case.values import named
from fenics_joints.diagnosis.model.of_structure import DIAGNOSE, ScriptedCase
from fenics_joints.errors import InputError, mapping, real, wanted
from fenics_joints.measurements import TestData
from fenics_joints.structure import FormModel, Parameter


class FormCase(ScriptedCase):
    """A case of a model by forms."""

    parts: named(PartSection) = {}
    _model: FormModel = PrivateAttr()
    _tolerances: dict[str, float] = PrivateAttr(default_factory=dict)

    @property
    def model(self) -> FormModel:
        """The nominal model."""
        return self._model

    @property
    def known_parameters(self) -> dict[str, float]:
        """Relative standard deviations of the parameters that are known so well, by name."""
        return self._tolerances

    @property
    def unknown_parameters(self) -> dict[str, Parameter]:
        """The other parameters, which may be wrong."""
        return {n: p for n, p in self._model.parameters.items() if n not in self._tolerances}


def form_case(
    model: FormModel,
    test: TestData,
    *,
    effects: Sequence[str] | None = None,
    tolerances: Mapping[str, float] | None = None,
    title: str = "model by forms",
    **options: Any,
) -> FormCase:
    """The case of a model by forms and its test.

    Args:
        model: The nominal model; K and M are linear in its parameters.
        test: What was measured.
        effects: Names of the library's effects, of which it can have errors of the test and of
            parameters, such as ``error of E``; None for all.
        tolerances: Relative standard deviations of parameters that are known so well.
        title: For people.
        options: Keys of ``[diagnose]``.

    Raises:
        InputError: If K or M is not linear in a parameter, or an option is unknown or out of range.
    """
    if not isinstance(test, TestData):
        raise wanted("test", test, "a TestData")
    if not model.has_displacement:
        raise InputError("model: expected forms of a displacement, which a test measures")
    bent = model.not_linear()
    if bent:
        raise InputError(
            f"{', '.join(bent)}: a or m is not linear in it: expected parameters in which both "
            "are, such as Lame's instead of Poisson's ratio"
        )
    for key in options:
        if key not in DIAGNOSE:
            raise InputError(f"{key}: unknown option{did_you_mean(key, DIAGNOSE)}")
    known = dict(mapping("tolerances", tolerances, "standard deviations by parameter"))
    for name, spread in known.items():
        if name not in model.parameters or not model.parameters[name].value:
            there = [n for n, p in model.parameters.items() if p.value]
            expected = ", ".join(there) or "none, as the model has no parameters"
            raise InputError(f"tolerances: {name!r}: expected one of {expected}")
        real(f"tolerances[{name!r}]", spread, above=0)
    said = {
        "title": title,
        "mesh": {"degree": 1},
        "test": {},
        "diagnose": {"effects": effects, **options},
    }
    try:
        case = FormCase.model_validate(said)
    except ValidationError as error:
        raise case_error(Path("model"), [describe(e, FormCase) for e in error.errors()]) from None
    case._model, case._tolerances, case._measured = model, known, test
    return case
