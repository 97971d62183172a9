"""The matrices of a damped structure and how they change with its parameters.

Z(s) = sum_c kappa_c(s) K_c + mu(s) M, see `structure.damping`. Its derivative by a parameter is
a sum of terms, each a factor that depends on s alone times a share of dK/dp or dM/dp.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI

from fenics_joints.errors import InputError, wanted
from fenics_joints.structure import Damped, Damping
from fenics_joints.structure.sparse import MatrixForm, product, project, slope_products


@dataclass(frozen=True)
class Term:
    """A share of dZ/dp.

    Attributes:
        parameter: Index of p.
        kind: Matrix that changes: ``"K"``, ``"M"``, or ``"D"`` for the damping alone.
        factor: s to its factor.
        form: Its matrix, dense on a basis, (m, m), or a form that multiplies blocks of columns.
    """

    parameter: int
    kind: str
    factor: Callable[[complex], complex]
    form: object

    def destroy(self) -> None:
        """Free its matrix, unless that is an array. Collective."""
        if not isinstance(self.form, np.ndarray):
            self.form.destroy()


class DampedPencil:
    """K, M and the stiffness of every damped layer, at given values of the parameters. Collective.

    Args:
        structure: A model of any kind; of one of plain arrays all matrices are arrays.
        given: Values of parameters that differ from their nominal value.
        damping: The damping; None for none.

    Raises:
        InputError: For a parameter, region or support that does not exist, or bad values.

    Attributes:
        K: Stiffness, N/m.
        M: Mass, kg.
        parts: Stiffness of the layers with damping of their own, by name.
        damping: The damping in numbers.
    """

    def __init__(
        self,
        structure: Damped,
        given: Mapping[str, float] | None = None,
        damping: Damping | None = None,
    ):
        self.structure = structure
        self.named = damping or Damping()
        self.named.check(structure.parameters, structure.layers, structure.dampers)
        self.values = structure.values(given)
        self.damping = self.named.at(self.values)
        self.K, self.M = structure.stiffness(given), structure.mass(given)
        self.comm = MPI.COMM_SELF if structure.is_dense else structure.comm
        self.parts = {name: structure.region_stiffness(name, given) for name in self.named.layers}

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        if not self.structure.is_dense:
            for A in (self.K, self.M, *self.parts.values()):
                A.destroy()
        self.parts = {}

    def apply(self, s: complex, X: np.ndarray) -> np.ndarray:
        """This rank's rows of Z(s) X, complex; without modal damping."""
        parts = np.hstack([X.real, X.imag])

        def times(A):
            real, imag = np.hsplit(product(A, parts), 2)
            return real + 1j * imag

        base = self.damping.stiffness_factor(s)
        total = base * times(self.K) + self.damping.mass_factor(s) * times(self.M)
        for name, A in self.parts.items():
            total += (self.damping.stiffness_factor(s, name) - base) * times(A)
        return total

    def terms(self, basis: np.ndarray | None = None) -> Iterator[Term]:
        """dZ/dp of all parameters but those of modal damping ratios. Collective.

        Args:
            basis: This rank's rows of vectors, (n_local, m), on which the forms are wanted, as
                symmetric (m, m) arrays; without, they are forms that multiply blocks.
        """
        model, named, numbers = self.structure, self.named, self.damping
        slopes = model.slopes(self.values, named.layers)
        for p, kind, name, form in slopes if basis is None else _projected(slopes, basis):
            factor = numbers.mass_factor
            if kind == "K":
                factor = partial(numbers.stiffness_factor, name=name)
            yield Term(p, kind, factor, form)
        alpha, beta = named.rayleigh
        found = [(named.structural, imaginary, self.K), (alpha, linear, self.M)]
        found += [(beta, linear, self.K)]
        found += [(v, imaginary, self.parts[n]) for n, v in named.hysteretic.items()]
        found += [(v, linear, self.parts[n]) for n, v in named.viscous.items()]
        position = {name: i for i, name in enumerate(model.parameters)}
        for value, factor, A in found:
            if isinstance(value, str):
                form = A if model.is_dense else MatrixForm(A)
                yield Term(
                    position[value], "D", factor, form if basis is None else project(A, basis)
                )


def _projected(slopes, basis: np.ndarray):
    for p, kind, name, found in slope_products(slopes, basis, basis):
        yield p, kind, name, 0.5 * (found + found.T)


def check_damped(model: object) -> None:
    """Refuse an object that is no `Damped` model.

    Raises:
        InputError: If it is none.
    """
    if isinstance(model, type) or not isinstance(model, Damped):
        raise InputError(
            f"model: expected a Structure, ReducedStructure or ArrayModel, not a "
            f"{type(model).__name__}."
        )


def check_damping(damping: Damping | None) -> Damping:
    """The damping, none without one.

    Raises:
        InputError: If it is something else.
    """
    if damping is not None and not isinstance(damping, Damping):
        raise wanted("damping", damping, "a Damping, or None")
    return damping or Damping()


def imaginary(s: complex) -> complex:
    """Factor of a loss factor: i at any s."""
    return 1j


def linear(s: complex) -> complex:
    """Factor of a viscous damping: s."""
    return s
