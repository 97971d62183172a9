"""Linear damping of a structure and of its joints, as factors before its matrices.

At the complex frequency s (s = i omega for forced vibration, the eigenvalue for a free one) the
dynamic stiffness is

    Z(s) = sum_c kappa_c(s) K_c + mu(s) M,      mu = s^2 + alpha s,
    kappa_c = 1 + i eta + beta s                 of all springs, supports, parts and joints,
            + i eta_c + tau_c s                  of the region or elastic support c besides,

with Rayleigh's alpha and beta, a loss factor eta of the whole, and of each damped layer a loss
factor eta_c (hysteretic) or a relaxation time tau_c (viscous: Kelvin and Voigt's stress
E (strain + tau d strain/dt)). A model of plain arrays may have dashpots too: matrices D_c that are
not in K, with their coefficient in place of tau_c, which adds c s D_c. Every one of them may be the
name of a parameter.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from numbers import Real

import numpy as np

from fenics_joints.errors import InputError, items, real, text, wanted
from fenics_joints.structure.components import number

Value = float | str


@dataclass(frozen=True)
class Damping:
    """Damping of a structure; all numbers are non-negative, or names of parameters.

    Attributes:
        modal: Damping ratio of all modes, or of each elastic mode, the last one holding for all
            above. With ``method="modal"`` only.
        rayleigh: alpha, 1/s, and beta, s: C = alpha M + beta K.
        structural: Loss factor of the whole structure.
        viscous: Relaxation time, s, of regions or elastic supports, by name; or the coefficient of
            a dashpot, such as the slip of bolted beams, N m s.
        hysteretic: Loss factor of regions or elastic supports, by name.
    """

    modal: Value | Sequence[Value] = 0.0
    rayleigh: tuple[Value, Value] = (0.0, 0.0)
    structural: Value = 0.0
    viscous: Mapping[str, Value] = field(default_factory=dict)
    hysteretic: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self):
        for key in ("viscous", "hysteretic"):
            if not isinstance(getattr(self, key), Mapping):
                raise wanted(f"damping.{key}", getattr(self, key), "numbers by names of layers")
        items("damping.rayleigh", self.rayleigh, object, "numbers")
        if not isinstance(self.modal, str | Real):
            items("damping.modal", self.modal, object, "numbers")
        if len(tuple(self.rayleigh)) != 2 or not self.ratios:
            raise InputError(
                f"damping.rayleigh = {self.rayleigh}, modal = {self.modal}: expected two numbers, "
                "alpha and beta, and at least one damping ratio."
            )
        for where, value in self._entries():
            if isinstance(value, str):
                text(f"damping.{where}", value)
            else:
                real(f"damping.{where}", value, least=0)

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of regions and supports with damping of their own."""
        return tuple(dict.fromkeys([*self.viscous, *self.hysteretic]))

    @property
    def is_modal(self) -> bool:
        """Whether modes have damping ratios."""
        return not np.all([m == 0 for m in self.ratios])

    @property
    def ratios(self) -> tuple[Value, ...]:
        """`modal` as a sequence."""
        single = isinstance(self.modal, str | Real)
        return (self.modal,) if single else tuple(self.modal)

    def check(
        self, parameters: Collection[str], layers: Sequence[str], dampers: Collection[str] = ()
    ) -> None:
        """Refuse names that are not a model's.

        Args:
            parameters: Names of its parameters.
            layers: Names of its parts, joints and elastic supports.
            dampers: Names of its dashpots.

        Raises:
            InputError: For an unknown parameter, region or support.
        """
        known = {"viscous": (*layers, *dampers), "hysteretic": layers}
        for key, names in known.items():
            for name in getattr(self, key):
                if name not in names:
                    raise InputError(
                        f"damping.{key} names {name!r}: expected a part, joint or elastic support, "
                        f"one of: {', '.join(names)}."
                    )
        for where, value in self._entries():
            if isinstance(value, str) and value not in parameters:
                raise InputError(
                    f"damping.{where} names the parameter {value!r}, which does not exist; "
                    f"expected a number or one of: {', '.join(parameters) or 'none'}."
                )

    def at(self, values: Mapping[str, float]) -> Damping:
        """The damping in numbers.

        Raises:
            InputError: If one is negative or not finite.
        """
        return replace(
            self,
            modal=tuple(number(m, values) for m in self.ratios),
            rayleigh=tuple(number(r, values) for r in self.rayleigh),
            structural=number(self.structural, values),
            viscous={k: number(v, values) for k, v in self.viscous.items()},
            hysteretic={k: number(v, values) for k, v in self.hysteretic.items()},
        )

    def _entries(self):
        for f in fields(self):
            value = self.ratios if f.name == "modal" else getattr(self, f.name)
            if f.name in ("viscous", "hysteretic"):
                yield from ((f"{f.name}.{name}", v) for name, v in value.items())
            elif f.name != "structural":
                yield from ((f"{f.name}[{i}]", v) for i, v in enumerate(value))
            else:
                yield f.name, value

    # -- factors; of a damping in numbers ------------------------------------------------------

    def stiffness_factor(self, s: complex, name: str | None = None) -> complex:
        """kappa(s) of a layer, or without a name of all that has no damping of its own."""
        own = 1j * self.hysteretic.get(name, 0.0) + s * self.viscous.get(name, 0.0)
        return 1.0 + 1j * self.structural + s * self.rayleigh[1] + own

    def stiffness_slope(self, name: str | None = None) -> float:
        """d kappa / ds."""
        return self.rayleigh[1] + self.viscous.get(name, 0.0)

    def mass_factor(self, s: complex) -> complex:
        """mu(s)."""
        return s * (s + self.rayleigh[0])

    def mass_slope(self, s: complex) -> complex:
        """d mu / ds."""
        return 2 * s + self.rayleigh[0]
