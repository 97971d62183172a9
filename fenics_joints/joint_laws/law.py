"""What a nonlinear joint law is: parallel elements with memory, each written once, as UFL.

From that one function come the residual and the consistent tangent of a finite-element problem
(`fenics_joints.joint_laws.field`), and the compiled kernel of harmonic balance and time integration
(`fenics_joints.joint_laws.kernel`).
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from fenics_joints.errors import InputError, reals


def check_names(what: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse parameters that something does not have.

    Raises:
        InputError: For the first unknown one.
    """
    for key in given:
        if key not in known:
            raise InputError(
                f"{what} has no parameter {key!r}; expected one of: {', '.join(known)}."
            )


def is_rated(law: JointLaw) -> bool:
    """Whether a law's `JointLaw.element` takes the rate of strain, as an argument ``rate``.

    Raises:
        InputError: If it has memory too: of such a law the steps of a cycle say nothing of rates.
    """
    rated = "rate" in inspect.signature(law.element).parameters
    if rated and law.state_size(1):
        raise InputError(
            f"{law.label} has memory and asks for the rate of strain; expected one of them, and "
            "two laws at the same points for both."
        )
    return rated


def positive(law: JointLaw, *keys: str) -> None:
    """Refuse values of some parameters that are not above zero.

    Raises:
        InputError: For the first of them.
    """
    for key in keys:
        if np.any(law.parameters[key] <= 0):
            raise InputError(f"{law.label}.{key} = {law.parameters[key]}: expected numbers > 0.")


def not_negative(law: JointLaw, *keys: str) -> None:
    """Refuse values of some parameters that are below zero.

    Raises:
        InputError: For the first of them.
    """
    for key in keys:
        if np.any(law.parameters[key] < 0):
            raise InputError(f"{law.label}.{key} = {law.parameters[key]}: expected numbers >= 0.")


class JointLaw(ABC):
    """Stress of an interface, as the sum over parallel elements with memory.

    The strain of a point is that of a thin layer (normal strain, engineering shear strain) or the
    jump of a zero-thickness interface (opening, slip, m); the stress, Pa, is its work conjugate. A
    law of yours gives its parameters to this constructor and writes `element`; what it returns
    may depend on strain, state and parameters in any way that UFL can say.

    Args:
        parameters: Values by name: a number, or an array of shape (E,), one for each of E parallel
            elements, or (P, 1) or (P, E), for each of P points too. Names with a leading
            underscore are not allowed.

    Raises:
        InputError: If a value is not finite, or their shapes do not fit together.

    Attributes:
        parameters: The values, as arrays.
    """

    #: Name in case files and messages.
    name: str = ""
    #: Whether the law takes the normal strain and returns a normal stress.
    coupled: bool = False
    #: Whether, in one direction, one step along a way without reversal gives what many steps along
    #: it give, as of a slider; harmonic balance takes fewer then.
    exact_steps: bool = False

    def __init__(self, **parameters: ArrayLike):
        self.parameters: dict[str, np.ndarray] = {}
        for key, value in parameters.items():
            array = reals(f"{self.label}.{key}", value)
            if array.ndim > 2:
                expected = "a number, or shape (elements,) or (points, elements)"
                raise InputError(f"{self.label}.{key} has shape {array.shape}: expected {expected}")
            self.parameters[key] = array
        try:
            self._shape = np.broadcast_shapes((1,), *(a.shape for a in self.parameters.values()))
        except ValueError:
            shapes = ", ".join(f"{k} {a.shape}" for k, a in self.parameters.items())
            raise InputError(
                f"{self.label}: the shapes of its parameters do not fit together: {shapes}."
            ) from None
        self.check()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.n_elements} elements: {', '.join(self.parameters)})"

    def check(self) -> None:
        """Refuse parameters that the law does not allow; every change of them is checked too.

        Raises:
            InputError: If one is out of range.
        """
        return

    @property
    def label(self) -> str:
        """Name for messages."""
        return self.name or type(self).__name__

    @property
    def n_elements(self) -> int:
        """Number of parallel elements, E."""
        return self._shape[-1]

    @property
    def n_points(self) -> int | None:
        """Number of points, if the parameters differ from point to point; else None."""
        return self._shape[0] if len(self._shape) == 2 and self._shape[0] > 1 else None

    def state_size(self, n_slip: int) -> int:
        """Numbers that one element remembers; 0 for a law without memory.

        Args:
            n_slip: Tangential directions, 1 in the plane and 2 in space.
        """
        return 0

    @abstractmethod
    def element(self, normal, slip, state, p: Mapping[str, object]) -> tuple:
        """One element, from the last converged state to the present strain.

        Args:
            normal: Normal strain or opening, UFL scalar; zero where the interface has none.
            slip: Shear strain or slip, UFL vector of shape (n_slip,).
            state: What the element remembers, UFL vector of shape (state_size,); None without.
            p: The element's parameters by name, UFL scalars.

        A law without memory may have a fifth argument ``rate``: the rates of normal strain and slip
        over time, 1/s or m/s, UFL vector of shape (1 + n_slip,), the first zero where the
        interface has no normal strain.

        Returns:
            (normal stress, traction of shape (n_slip,), new state of shape (state_size,) or None).
            A law that is not `coupled` returns 0 for the normal stress. Where the state does not
            change it must be returned as it is (in a ``ufl.conditional``), not computed anew.
        """

    def stored(self, normal, slip, state, p: Mapping[str, object]):
        """Energy per volume or area in one element's springs, with the state after the step.

        Arguments as `element`. UFL; None for a law that does not tell.
        """
        return

    def dissipated(self, normal, slip, old, new, p: Mapping[str, object]):
        """Energy per volume or area that one element turned to heat in a step from old to new.

        Arguments as `element`. UFL; None for a law that does not tell.
        """
        return

    def values(self, n_points: int) -> np.ndarray:
        """Parameters of every element of every point, shape (n_points, E, n_parameters).

        Raises:
            InputError: If the law is for another number of points.
        """
        if self.n_points not in (None, n_points):
            raise InputError(
                f"{self.label}: its parameters are for {self.n_points} points, the interface has "
                f"{n_points}."
            )
        shape = (n_points, self.n_elements)
        arrays = [np.broadcast_to(a, shape) for a in self.parameters.values()]
        return np.ascontiguousarray(np.stack(arrays, axis=-1)) if arrays else np.empty((*shape, 0))

    def with_values(self, **values: ArrayLike) -> JointLaw:
        """The same law with other values of some of its element parameters.

        Raises:
            InputError: For an unknown parameter, or a value that the law does not allow.
        """
        check_names(self.label, values, self.parameters)
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        JointLaw.__init__(other, **{**self.parameters, **values})
        return other

    def change(self, **values: float) -> JointLaw:
        """The same law with other values of what it was made of: `with_values` unless it says.

        Raises:
            InputError: For an unknown parameter or one out of range.
        """
        return self.with_values(**values)

    def __getstate__(self) -> dict:
        """Without compiled kernels, which cannot be pickled and are soon made again."""
        return {k: v for k, v in self.__dict__.items() if not k.startswith("_kernel")}
