"""Changes of a structure that are no property of a part or joint, with parameters of their own.

Local loss of stiffness, something attached at one of several places, a plate that is not flat or
not evenly thick: K and M change by fixed matrices times scalars of a few parameters
(`Law.stiffness_terms`). So a reduced model has them exactly, as regions
(`fenics_joints.reduction.affine.RegionTerm`), and the full one assembles them only where they are
not zero. The place of a change among several stations is a parameter with values 0, 1, ...: between
two stations each has its share, so that the parameter is continuous.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.forms import isotropic_stress, lame_parameters
from fenics_joints.structure.components import number, slopes
from fenics_joints.structure.laws import Law
from fenics_joints.structure.sparse import MatrixForm, RowForm

#: Properties of a `PlacedPoint`: stiffness along x, y and z.
STIFFNESSES = ("stiffness_x", "stiffness_y", "stiffness_z")
#: Distances from a point, m.
OFFSETS = ("x", "y", "z")

Value = float | str
#: `fenics_joints.structure.assembly.Assembly`, which holds changes.
Assembly = Any


def hat(x: np.ndarray, flat: float = 0.0) -> np.ndarray:
    """1 up to the distance ``flat`` from 0, then falling linearly to 0 over 1; complex x, too."""
    rest = 1 + flat - np.where(np.real(x) < 0, -x, x)
    rest = np.where(np.real(rest) > 0, rest, 0.0)
    return np.where(np.real(rest) < 1, rest, 1.0)


def _any(where: str, q: Mapping[str, object]) -> None:
    """Accept all values: they come from priors with limits."""


def _lost(q) -> np.ndarray:
    """Minus the depth times each station's share, times actual over nominal modulus."""
    at = np.add.outer(np.arange(_count(q)), q["first"])
    near = hat(at - q["place"], 0.5 * (q["size"] - 1))
    return -q["depth"] * near * (q["E"] / q["nominal"])


def _count(q) -> int:
    """Number of scalars."""
    return int(np.max(np.real(q["count"])))


def _here(q) -> np.ndarray:
    """Product of powers of the distances from this point; zero if another one is meant."""
    here = 1.0 * (np.abs(np.real(q["place"]) - q["at"]) < 0.5)
    for way in OFFSETS:
        here = here * q[way] ** q[f"{way}_power"]
    return here


def _placed(q) -> np.ndarray:
    here = _here(q)
    return np.array([q[key] * here for key in STIFFNESSES])


def _hung(q) -> np.ndarray:
    return np.array([q["stiffness"] * _here(q)])


def _powers(q) -> np.ndarray:
    """Powers of an amount from the first on, times actual over nominal modulus."""
    return np.array([q["amount"] ** (k + 1) * (q["E"] / q["nominal"]) for k in range(_count(q))])


def _law(name: str, properties: tuple[str, ...], terms, inertia) -> Law:
    return Law(name, properties, None, terms, (), _any, inertia_term=inertia)


_LOSS = _law(
    "local loss",
    ("depth", "place", "size", "E", "nominal", "first", "count"),
    _lost,
    lambda q: 0.0 * q["depth"],
)
_PLACE = ("place", "at", *OFFSETS, *(f"{way}_power" for way in OFFSETS), "idle")
_POINT = _law(
    "placed point", ("mass", *STIFFNESSES, *_PLACE), _placed, lambda q: q["mass"] * _here(q)
)
_RESONATOR = _law(
    "placed resonator", ("mass", "stiffness", *_PLACE), _hung, lambda q: q["mass"] * _here(q)
)
_SHAPE = _law(
    "shape",
    ("amount", "E", "nominal", "rho", "nominal_rho", "count"),
    _powers,
    lambda q: q["amount"] * q["rho"] / q["nominal_rho"],
)
#: Their laws, for files.
CHANGES = (_LOSS, _POINT, _RESONATOR, _SHAPE)


class _Scalars:
    """What all changes share: properties of a law at values of the parameters."""

    properties: Mapping[str, Value]

    def values(self, values: Mapping[str, float]) -> dict[str, float]:
        """Property values."""
        return {key: number(self.properties[key], values) for key in self.law.properties}


@dataclass(frozen=True, eq=False)
class LocalLoss(_Scalars):
    """Loss of a part's stiffness in one of several places.

    Attributes:
        name: Name in messages.
        region: Name of the part.
        cells: This rank's cells of each place, ghosts included.
        properties: ``depth``, the share lost; ``place``, and ``size``, how many places about it,
            1 or more; ``E`` of the part and its ``nominal`` value; ``first`` station and ``count``
            of them.
    """

    name: str
    region: str
    cells: Sequence[np.ndarray]
    properties: Mapping[str, Value]

    law, volume, has_mass = _LOSS, 0.0, False

    def matrix(self, model: Assembly, cells: np.ndarray) -> PETSc.Mat:
        """Stiffness of some cells of the part, at nominal values; the caller's. Collective."""
        model.update(None)
        at = [region.name for region in model.regions].index(self.region)
        return model.assembled(fem.form(model.cells_form(at, 0, cells)))


@dataclass(frozen=True, eq=False)
class _Attached(_Scalars):
    """One term of something attached near one of several points of a solid.

    It moves with the mean displacement there and its slopes. Its energy is quadratic in both, and
    this term is the part before one product of two distances from the point. Only reduced models
    have it (`fenics_joints.reduction.reduced.Projection.change`): in the full one, whose
    displacement at a point depends on the mesh, it must be idle.

    Attributes:
        name: Name in messages.
        points: Points around it, m, (P, 3).
        weights: Weights of these points' motions in the mean and in its slopes along x, y and z,
            (4, P).
        pair: Which two of 1, x, y and z the product is of.
        properties: See the law's.
    """

    name: str
    points: np.ndarray
    weights: np.ndarray
    pair: tuple[int, int]
    properties: Mapping[str, Value]

    has_mass = True

    @property
    def volume(self) -> float:
        """Its share of the mass."""
        return float(self.pair == (0, 0))

    def check_idle(self, values: Mapping[str, float]) -> None:
        """Refuse one that is not idle.

        Raises:
            InputError: If it has more than its idle mass, or a spring to the ground.
        """
        q = self.values(values)
        springs = any(q.get(key) for key in STIFFNESSES)
        if q["mass"] > q["idle"] * (1 + 1e-9) or springs:
            raise InputError(
                f"{self.name}: mass {q['mass']:g} kg: the full model has nothing attached; "
                "expected a reduced model"
            )


class PlacedPoint(_Attached):
    """A mass and a spring to the ground.

    Its properties are ``mass``, kg; ``stiffness_x``, ``stiffness_y``, ``stiffness_z``, N/m; near
    which point, ``place``, and ``at`` which this one is; the distances from it ``x``, ``y`` and
    ``z``, m, and their powers here, such as ``x_power``; and ``idle``, a negligible mass.
    """

    law = _POINT


class PlacedResonator(_Attached):
    """A mass on a spring, the same in all directions. Its displacement is a further unknown of
    reduced models (`fenics_joints.reduction.reduced.with_motions`).

    Its properties are ``mass`` and ``stiffness``, and otherwise those of a `PlacedPoint`.
    """

    law = _RESONATOR


@dataclass(frozen=True, eq=False)
class ShapeChange(_Scalars):
    """Cells of a part displaced from where the mesh has them, to x + a s(x) c(x) n.

    ``a`` is the amount, n a direction, s = s0 + s1 x.d + s2 (x.d)^2 along another direction d at
    right angles to n, and c = c0 + c1 x.n with numbers of each cell: 1 for a plate that is bowed,
    the distance from its middle for one whose thickness changes. With F = I + a (s c1 n n^T +
    c s' n d^T) stiffness and mass are those of the cells as meshed, of gradients grad(u) F^-1 and
    of volumes det F, as `fenics_joints.forms.elasticity` has it for a stretch. The mass is linear
    in a. The stiffness is a polynomial in a, of degree 2 where c1 = 0; else one of degree
    ``count`` goes through it at as many amounts up to ``largest`` either way.

    Cells are taken as stretched and wide as meshed, and with their nominal Poisson's ratio:
    otherwise a rotation of the body, which follows its shape, would not be free of strain.

    Attributes:
        name: Name in messages.
        region: Name of the part.
        normal: n, (gdim,).
        along: d, (gdim,).
        bend: (s0, s1, s2).
        across: (c0, c1) of each of this rank's cells, ghosts included, (2, n_cells).
        largest: Amount up to which the stiffness is looked at.
        properties: ``amount``; ``E`` and ``rho`` of the part, their ``nominal`` values, and the
            degree ``count``.
    """

    name: str
    region: str
    normal: tuple[float, ...]
    along: tuple[float, ...]
    bend: tuple[float, float, float]
    across: np.ndarray
    largest: float
    properties: Mapping[str, Value]

    law, volume = _SHAPE, 0.0

    @property
    def has_mass(self) -> bool:
        """Whether the volume changes."""
        return isinstance(self.properties["rho"], str)

    def matrices(self, model: Assembly) -> Iterator[PETSc.Mat]:
        """Matrices of the powers of the amount; the caller's to destroy. Collective."""
        count = int(self.properties["count"])
        nodes = np.linspace(-1.0, 1.0, count + 1 + count % 2)
        nodes = nodes[nodes != 0]
        weights = np.linalg.pinv(nodes[:, None] ** np.arange(1, count + 1))
        form, amount = self._form(model, 0)
        before = model.assembled(form)
        found = []
        for node in nodes:
            amount.value = node * self.largest
            found.append(model.assembled(form))
            found[-1].axpy(-1.0, before, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        before.destroy()
        for k in range(count):
            total = found[0].copy()
            total.scale(weights[k, 0])
            for w, A in zip(weights[k, 1:], found[1:], strict=True):
                total.axpy(w, A, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
            total.scale(self.largest ** -(k + 1.0))
            yield total
        for A in found:
            A.destroy()

    def inertia(self, model: Assembly) -> PETSc.Mat:
        """Derivative of the mass by the amount; the caller's to destroy. Collective."""
        form, amount = self._form(model, 1)
        before = model.assembled(form)
        amount.value = 1.0
        found = model.assembled(form)
        found.axpy(-1.0, before, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        before.destroy()
        return found

    def _form(self, model: Assembly, which: int) -> tuple[fem.Form, fem.Constant]:
        """Stiffness (0) or mass (1) of the part, and the amount in it, which is 0."""
        msh, gdim = model.mesh, model.gdim
        at = [region.name for region in model.regions].index(self.region)
        nominal, own = model.values(), model.regions[at].properties
        amount, bend = fem.Constant(msh, 0.0), fem.Constant(msh, np.array(self.bend, dtype=float))
        # As constants and coefficients, all parts and ways are one compiled form.
        n, d = (
            fem.Constant(msh, np.array(w[:gdim], dtype=float)) for w in (self.normal, self.along)
        )
        E, nu, rho = (
            fem.Constant(msh, float(number(own[key], nominal))) for key in ("E", "nu", "rho")
        )
        flat = fem.functionspace(msh, ("DG", 0))
        c0, c1 = (fem.Function(flat) for _ in range(2))
        for function, values in zip((c0, c1), self.across, strict=True):
            function.x.array[flat.dofmap.list[: len(values), 0]] = values
        x, unit = ufl.SpatialCoordinate(msh), ufl.Identity(gdim)
        t = ufl.dot(x, d)
        s = bend[0] + bend[1] * t + bend[2] * t**2
        stretch = 1 + amount * s * c1
        shear = amount * (c0 + c1 * ufl.dot(x, n)) * (bend[1] + 2 * bend[2] * t)
        # F = I + (stretch - 1) n n^T + shear n d^T, and d is at right angles to n.
        back = unit + (1 / stretch - 1) * ufl.outer(n, n) - shear / stretch * ufl.outer(n, d)
        dx = model.cells_measure(model.field.regions[at][1])
        u, v = model.arguments
        if which:
            return fem.form(rho * stretch * ufl.inner(u, v) * dx), amount
        eps = [ufl.sym(ufl.dot(ufl.grad(w), back)) for w in (u, v)]
        stress = isotropic_stress(eps[0], *lame_parameters(E, nu))
        return fem.form(stretch * ufl.inner(stress, eps[1]) * dx), amount


Change = LocalLoss | PlacedPoint | PlacedResonator | ShapeChange


def add_changes(model: Assembly, A: PETSc.Mat, which: int, values: Mapping[str, float]) -> None:
    """Put changes into a stiffness (0) or a mass (1), in place. Collective."""
    for change in model.changes:
        if isinstance(change, _Attached):
            change.check_idle(values)
            continue
        q = change.values(values)
        terms = [change.law.inertia_term(q)] if which else change.law.stiffness_terms(q)
        if not np.any(terms) or (which and not change.has_mass):
            continue
        for term, part in zip(terms, forms_of(model, change, which, terms), strict=True):
            if part is not None:
                A.axpy(float(term), part.A, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
                part.destroy()
    A.assemble()


def change_slopes(
    model: Assembly, values: Mapping[str, float]
) -> Iterator[tuple[int, str, None, MatrixForm | RowForm]]:
    """`Structure.slopes` by the parameters of changes. Collective."""
    position = {name: i for i, name in enumerate(model.parameters)}
    for change in model.changes:
        if isinstance(change, _Attached):
            continue
        q = change.values(values)
        names = [(key, name) for key, name in change.properties.items() if isinstance(name, str)]
        for which, terms in enumerate((change.law.stiffness_terms, change.law.inertia_term)):
            if which and not change.has_mass:
                continue
            by = {key: np.atleast_1d(slopes(terms, q, key)) for key, _ in names}
            wanted = np.any([np.abs(b) > 0 for b in by.values()], axis=0)
            if not np.any(wanted):
                continue
            parts = list(forms_of(model, change, which, wanted))
            for key, name in names:
                for slope, part in zip(by[key], parts, strict=True):
                    if slope and part is not None:
                        yield position[name], "KM"[which], None, _Scaled(part, float(slope))
            for part in parts:
                if part is not None:
                    part.destroy()


def forms_of(
    model: Assembly, change: Change, which: int, wanted
) -> Iterator[MatrixForm | RowForm | None]:
    """Matrices before each scalar of a change in K (0) or M (1); None where not wanted.
    Collective."""
    if isinstance(change, LocalLoss):
        for place, asked in enumerate(np.broadcast_to(wanted, len(change.cells))):
            make = partial(change.matrix, model, change.cells[place])
            yield model.kept_form(change, place, make) if asked else None
    elif which:
        yield MatrixForm(change.inertia(model), True)
    else:
        yield from (MatrixForm(A, True) for A in change.matrices(model))


class _Scaled:
    """A number times a form that another owns."""

    def __init__(self, part: MatrixForm | RowForm, factor: float):
        self.part, self.factor, self.comm = part, factor, part.comm

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        return self.factor * (self.part @ X)

    def destroy(self) -> None:
        """Nothing: the form is another's."""
