"""The matrices of a damped structure and how they change with its parameters.

Z(s) = sum_c kappa_c(s) K_c + mu(s) M, see `structure.damping`. Its derivative by a parameter is
a sum of terms, each a factor that depends on s alone times a symmetric form: sparse matrices over
the cells of one region, one assembly each by UFL's derivative along the change of the properties;
products of rows for springs and point masses.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from fenics_joints.modal.eigensolver import product
from fenics_joints.structure.damping import Damping
from fenics_joints.structure.loads import unit_loads
from fenics_joints.structure.points import PointRows, Sensors
from fenics_joints.structure.structure import Structure
from fenics_joints.structure.values import slopes

__all__ = [
    "DampedPencil", "MatrixForm", "RowForm", "Term", "imaginary", "linear", "point_loads",
]  # fmt: skip

_SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
#: Compiled derivatives of each structure's regions, and the direction they are taken in.
_FORMS: WeakKeyDictionary[Structure, dict] = WeakKeyDictionary()


class MatrixForm:
    """y^T A x for blocks of this rank's rows; ``owned`` if nobody else keeps A. Collective."""

    def __init__(self, A: PETSc.Mat, owned: bool = False):
        self.A, self.comm, self.owned = A, A.comm.tompi4py(), owned

    def __call__(self, Y: np.ndarray, X: np.ndarray) -> np.ndarray:
        """Shape (columns of Y, columns of X), equal on all ranks; real blocks."""
        return self.comm.allreduce(Y.T @ product(self.A, X))

    def apply(self, X: np.ndarray) -> np.ndarray:
        """This rank's rows of A X."""
        return product(self.A, X)

    def destroy(self) -> None:
        """Free A, if it is owned. Collective."""
        if self.owned:
            self.A.destroy()


class RowForm:
    """factor * sum_k (y . left_k) (x . right_k), with this rank's rows of both. Collective."""

    def __init__(self, left: np.ndarray, right: np.ndarray, factor: float, comm):
        self.left, self.right, self.factor, self.comm = left, right, factor, comm

    def __call__(self, Y: np.ndarray, X: np.ndarray) -> np.ndarray:
        """Shape (columns of Y, columns of X), equal on all ranks."""
        at_left, at_right = self.comm.allreduce(Y.T @ self.left), self._at(X)
        return self.factor * at_left @ at_right

    def apply(self, X: np.ndarray) -> np.ndarray:
        """This rank's rows of the form's matrix times X."""
        return self.factor * self.left @ self._at(X)

    def destroy(self) -> None:
        """Nothing to free."""

    def _at(self, X: np.ndarray) -> np.ndarray:
        return self.comm.allreduce(self.right.T @ X)


@dataclass(frozen=True)
class Term:
    """A share of dZ/dp.

    Attributes:
        parameter: Index of p.
        kind: What changes: ``"K"``, ``"M"``, or ``"D"`` for the damping alone.
        factor: s to its factor.
        form: Its form; or its matrix on a basis, (m, m).
    """

    parameter: int
    kind: str
    factor: Callable[[complex], complex]
    form: MatrixForm | RowForm | np.ndarray


def point_loads(structure: Structure, sensors: Sensors, what: str = "sensor") -> np.ndarray:
    """This rank's rows of the loads of one newton at points, (n_local, n). Collective.

    They are also the rows by which displacement there is read: held degrees of freedom, where both
    differ, do not move.
    """
    rows = structure.rows(sensors.points, what)
    return unit_loads(structure, rows, sensors.directions[:, : structure.gdim])


class DampedPencil:
    """K, M and the stiffness of every damped layer, at given values of the parameters. Collective.

    Args:
        structure: The full model.
        given: Values of parameters that differ from their nominal value.
        damping: The damping; None for none.

    Raises:
        InputError: For a parameter, region or support that does not exist, or bad values.

    Attributes:
        K: Stiffness, N/m.
        M: Mass, kg.
        parts: Stiffness of the layers with damping of their own, in K's pattern, by name.
        damping: The damping in numbers.
    """

    def __init__(
        self,
        structure: Structure,
        given: Mapping[str, float] | None = None,
        damping: Damping | None = None,
    ):
        self.structure = structure
        self.named = damping or Damping()
        self.named.check(structure)
        self.values = structure.values(given)
        self.damping = self.named.at(self.values)
        self.K, self.M = structure.stiffness(given), structure.mass(given)
        self.comm = structure.comm
        self.parts = {name: self._part(name) for name in self.named.layers}

    def destroy(self) -> None:
        """Free the matrices. Collective."""
        for A in (self.K, self.M, *self.parts.values()):
            A.destroy()
        self.parts = {}

    def apply(self, s: complex, X: np.ndarray) -> np.ndarray:
        """This rank's rows of Z(s) X, complex; without modal damping."""
        damping = self.damping
        return self._combine(damping.stiffness_factor, damping.mass_factor, s, X)

    def apply_slope(self, s: complex, X: np.ndarray) -> np.ndarray:
        """This rank's rows of dZ/ds X, complex; without modal damping."""
        damping = self.damping
        return self._combine(
            lambda s, name=None: damping.stiffness_slope(name), damping.mass_slope, s, X
        )

    def _combine(self, stiff, heavy, s: complex, X: np.ndarray) -> np.ndarray:
        parts = np.hstack([X.real, X.imag])

        def times(A):
            real, imag = np.hsplit(product(A, parts), 2)
            return real + 1j * imag

        base = stiff(s)
        total = base * times(self.K) + heavy(s) * times(self.M)
        for name, A in self.parts.items():
            total += (stiff(s, name) - base) * times(A)
        return total

    def viscous(self) -> PETSc.Mat:
        """The viscous damping matrix C, N s/m: Rayleigh's and the layers'."""
        alpha, beta = self.damping.rayleigh
        C = self.K.copy()
        C.scale(beta)
        C.axpy(alpha, self.M, structure=PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN)
        for name, A in self.parts.items():
            C.axpy(self.damping.viscous.get(name, 0.0), A, structure=_SUBSET)
        return C

    def _part(self, name: str) -> PETSc.Mat:
        """Stiffness of one region or elastic support, held rows and columns zero."""
        structure = self.structure
        A = self.K.duplicate()
        A.zeroEntries()
        for i, support in enumerate(structure.elastic_supports):
            if support.name == name:
                for k, unit in zip(
                    (support.k_n, support.k_t), structure.support_matrices(i), strict=True
                ):
                    A.axpy(structure.number(k, self.values), unit, structure=_SUBSET)
                return A
        number = [r.name for r in structure.regions].index(name)
        forms = _FORMS.setdefault(structure, {})
        if number not in forms:
            u, v = ufl.TrialFunction(structure.V), ufl.TestFunction(structure.V)
            forms[number] = fem.form(structure.region_form(number, u, v)[0])
        fem_petsc.assemble_matrix(A, forms[number], structure.bcs, 0.0)
        A.assemble()
        return A

    # -- derivatives ---------------------------------------------------------------------------

    def terms(self) -> list[Term]:
        """dZ/dp of all parameters but those of modal damping ratios. Collective."""
        self.structure.field.update(self.values)
        return [
            *self._region_terms(), *self._support_terms(), *self._spring_terms(),
            *self._mass_terms(), *self._damping_terms(),
        ]  # fmt: skip

    def _stiffness_factor(self, name: str | None = None):
        known = name if name in self.parts else None
        return lambda s: self.damping.stiffness_factor(s, known)

    def _place(self, name: str) -> int:
        return list(self.structure.parameters).index(name)

    def _region_terms(self):
        for number, region in enumerate(self.structure.regions):
            for p, name in enumerate(self.structure.parameters):
                change = self.structure.field.slopes(number, name, self.values)
                if change is None:
                    continue
                stiff, heavy = self._matters(number, name)
                if stiff:
                    A = self._slope(number, 0, change)
                    yield Term(p, "K", self._stiffness_factor(region.name), MatrixForm(A, True))
                if heavy:
                    A = self._slope(number, 1, change)
                    yield Term(p, "M", self.damping.mass_factor, MatrixForm(A, True))

    def _matters(self, number: int, name: str) -> tuple[bool, bool]:
        """Whether a parameter changes a region's stiffness and its mass, by its law's scalars."""
        region, q = self.structure.regions[number], self.structure.field.means(number)
        keys = [
            key for key in region.law.properties
            if region.properties[key] == name or callable(region.properties[key])
        ]  # fmt: skip
        terms = region.law.stiffness_terms, region.law.inertia_terms
        return tuple(any(np.any(slopes(t, q, key)) for key in keys) for t in terms)

    def _slope(self, number: int, which: int, change) -> PETSc.Mat:
        """dK (which = 0) or dM (1) along a change of a region's properties.

        Held rows are not zeroed: vectors that the form is used on are zero there.
        """
        structure, field = self.structure, self.structure.field
        forms = _FORMS.setdefault(structure, {})
        if "direction" not in forms:
            forms["direction"] = fem.Function(field.space)
        direction = forms["direction"]
        if (number, which) not in forms:
            u, v = ufl.TrialFunction(structure.V), ufl.TestFunction(structure.V)
            form = structure.region_form(number, u, v)[which]
            forms[number, which] = fem.form(ufl.derivative(form, field.q, direction))
        direction.x.array[:] = 0.0
        field.put(direction, *change)
        A = fem_petsc.create_matrix(forms[number, which])
        fem_petsc.assemble_matrix(A, forms[number, which])
        A.assemble()
        return A

    def _support_terms(self):
        for i, support in enumerate(self.structure.elastic_supports):
            units = self.structure.support_matrices(i)
            for k, unit in zip((support.k_n, support.k_t), units, strict=True):
                if isinstance(k, str):
                    factor = self._stiffness_factor(support.name)
                    yield Term(self._place(k), "K", factor, MatrixForm(unit))

    def _spring_terms(self):
        for spring in self.structure.springs:
            if isinstance(spring.stiffness, str):
                at = point_loads(self.structure, Sensors(spring.point, spring.direction))
                form = RowForm(at, at, spring.share, self.comm)
                yield Term(self._place(spring.stiffness), "K", self._stiffness_factor(), form)

    def _mass_terms(self):
        for mass in self.structure.masses:
            if not isinstance(mass.mass, str) and not isinstance(mass.travel, str):
                continue
            number, factor = self.structure.number, self.damping.mass_factor
            travel = number(mass.travel, self.values)
            at, slope = self._mass_rows(np.add(mass.point, travel * np.array(mass.direction)), mass)
            if isinstance(mass.mass, str):
                form = RowForm(at, at, mass.share, self.comm)
                yield Term(self._place(mass.mass), "M", factor, form)
            if isinstance(mass.travel, str):
                m = mass.share * number(mass.mass, self.values)
                left, right = np.hstack([slope, at]), np.hstack([at, slope])
                form = RowForm(left, right, m, self.comm)
                yield Term(self._place(mass.travel), "M", factor, form)

    def _mass_rows(self, place, mass) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the displacement at a mass and of its slope along the travel, (n_local, gdim)."""
        gdim = self.structure.gdim
        rows = self.structure.rows(np.repeat(place[None, :gdim], gdim, axis=0))
        along = rows.gradients @ np.asarray(mass.direction, dtype=float)[:gdim]
        moved = PointRows(rows.index, rows.nodes, along, rows.gradients)
        return tuple(unit_loads(self.structure, r, np.eye(gdim)) for r in (rows, moved))

    def _damping_terms(self):
        K, M = MatrixForm(self.K), MatrixForm(self.M)
        alpha, beta = self.named.rayleigh
        found = [(self.named.structural, imaginary, K), (alpha, linear, M), (beta, linear, K)]
        for layers, factor in ((self.named.hysteretic, imaginary), (self.named.viscous, linear)):
            found += [(v, factor, MatrixForm(self.parts[n])) for n, v in layers.items()]
        for name, factor, form in found:
            if isinstance(name, str):
                yield Term(self._place(name), "D", factor, form)


def imaginary(s: complex) -> complex:
    """Factor of what a loss factor is before: i at any s."""
    return 1j


def linear(s: complex) -> complex:
    """Factor of what a viscous damping is before: s."""
    return s
