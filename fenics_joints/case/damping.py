"""The ``[damping]`` section of a case file: linear damping whose values are parameters."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from fenics_joints.case.values import Positive, Section, Share, listed, quantity
from fenics_joints.structure.damping import Damping

Ratio = quantity("", 0, 1)
Rate = quantity("1/s", 0)
Time = quantity("s", 0)
Relaxation = quantity("s", 0, above=True)


class DampingSection(Section):
    """``[damping]``: see `fenics_joints.structure.damping.Damping`, for whose values it has names.

    Each value above 0 is a parameter, which an update may fit: ``damping.ratio`` (of a list
    ``damping.ratio_1``, ``damping.ratio_2``, ...) of ``modal``, ``damping.alpha`` and
    ``damping.beta`` of ``rayleigh``, ``damping.loss_factor`` of ``structural``,
    ``NAME.loss_factor`` of ``hysteretic`` and ``NAME.relaxation`` of ``viscous``, where NAME is a
    part or joint.
    """

    modal: Annotated[list[Ratio], BeforeValidator(listed), Field(min_length=1)] | None = None
    rayleigh: tuple[Rate, Time] = (0.0, 0.0)
    structural: Share = 0.0
    viscous: dict[str, Relaxation] = {}
    hysteretic: dict[str, Positive] = {}

    @model_validator(mode="after")
    def _some(self) -> DampingSection:
        if not self.nominal():
            raise ValueError(
                "expected some damping: modal, rayleigh, structural, viscous or hysteretic above 0"
            )
        return self

    def nominal(self) -> dict[str, float]:
        """Value of each parameter, SI, by its name."""
        ratios = self.modal or []
        names = ["ratio"] if len(ratios) == 1 else [f"ratio_{i + 1}" for i in range(len(ratios))]
        own = dict(zip(names, ratios, strict=True))
        own |= dict(zip(("alpha", "beta"), self.rayleigh, strict=True))
        own["loss_factor"] = self.structural
        values = {f"damping.{key}": value for key, value in own.items()}
        values |= {f"{name}.loss_factor": value for name, value in self.hysteretic.items()}
        values |= {f"{name}.relaxation": value for name, value in self.viscous.items()}
        return {name: value for name, value in values.items() if value > 0}

    def damping(self) -> Damping:
        """The damping, with the names of its parameters in place of values above 0."""
        there = self.nominal()

        def named(name: str) -> float | str:
            return name if name in there else 0.0

        ratios = self.modal or [0.0]
        keys = ["ratio"] if len(ratios) == 1 else [f"ratio_{i + 1}" for i in range(len(ratios))]
        return Damping(
            modal=tuple(named(f"damping.{key}") for key in keys),
            rayleigh=(named("damping.alpha"), named("damping.beta")),
            structural=named("damping.loss_factor"),
            viscous={name: f"{name}.relaxation" for name in self.viscous},
            hysteretic={name: f"{name}.loss_factor" for name in self.hysteretic},
        )
