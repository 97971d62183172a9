"""A linear structure with nonlinear interfaces, on few degrees of freedom.

What `harmonic` and `transient` work on: dense matrices of the structure without the stress of its
nonlinear interfaces, and for each interface the rows that make its strains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import (
    InputError,
    capable,
    flag,
    items,
    mapping,
    real,
    reals,
    text,
    wanted,
)
from fenics_joints.interfaces.motion import (
    FreeMotions,
    LawPoints,
    Motion,
    named,
    named_points,
    no_motions,
    strainless,
)
from fenics_joints.joint_laws.law import JointLaw


def check_interfaces(model: object) -> None:
    """Refuse an object that is no `InterfaceModel`.

    Raises:
        InputError: If it is none.
    """
    calls = ("M", "K", "C", "row", "interfaces", "n_dofs")
    capable("model", model, calls, "an InterfaceModel, such as reduce_layers makes")


#: Eigenvalues below this share of trace(K) / trace(M) are rigid-body motion.
_RIGID = 1e-8
#: Directions with this share of the mass per stiffness of the heaviest have none.
_MASSLESS = 1e-12


@dataclass(frozen=True, repr=False)
class InterfacePoints(LawPoints):
    """`LawPoints` with dense rows, (P, d, n)."""

    def __post_init__(self):
        text("interface.name", self.name)
        if not isinstance(self.law, JointLaw):
            raise wanted(f"{self.name}.law", self.law, "a joint law")
        flag(f"{self.name}.normal", self.normal)
        shape = reals(f"{self.name}.rows", self.rows).shape
        if len(shape) != 3 or shape[1] not in ((2, 3) if self.normal else (1, 2)):
            raise InputError(
                f"{self.name}.rows has shape {shape}: expected (points, components, n_dofs) with "
                f"{'2 or 3' if self.normal else '1 or 2'} components."
            )
        if np.shape(self.weights) != shape[:1]:
            raise InputError(
                f"{self.name}.weights has shape {np.shape(self.weights)}: expected ({shape[0]},)."
            )
        reals(f"{self.name}.weights", self.weights, shape[:1], least=0)
        if self.law.coupled and not self.normal:
            raise InputError(
                f"{self.name}: the law {self.law.label} needs the normal strain; expected rows "
                "with it, and normal = True."
            )
        if self.points is not None:
            places = reals(f"{self.name}.points", self.points)
            if places.shape not in ((shape[0], 2), (shape[0], 3)):
                raise InputError(
                    f"{self.name}.points has shape {places.shape}: expected ({shape[0]}, 2 or 3)."
                )
        self.law.values(shape[0])

    @property
    def n_components(self) -> int:
        """Components of strain, d."""
        return self.rows.shape[1]

    def tangent(self) -> np.ndarray:
        """Stress by strain at rest, Pa, (P, d, d)."""
        P, d, _ = self.rows.shape
        still = np.zeros((P, self.kernel.inputs))
        return self.kernel.step(still, None, self.law.values(P))[2][..., :d]


@dataclass(frozen=True, repr=False)
class InterfaceModel:
    """Mass, damping and stiffness, nonlinear interfaces, places of forces and sensors.

    Attributes:
        M: Mass, kg, (n, n).
        K: Stiffness without the interfaces' stress, N/m, (n, n).
        interfaces: The nonlinear interfaces.
        C: Viscous damping, N s/m, (n, n); None for none.
        forces: Load per unit force at the places of forces, by name, (n,).
        sensors: Rows of displacement at sensors, by name, (n,).
    """

    M: np.ndarray
    K: np.ndarray
    interfaces: Sequence[InterfacePoints] = ()
    C: np.ndarray | None = None
    forces: Mapping[str, np.ndarray] = field(default_factory=dict)
    sensors: Mapping[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        n = len(reals("M", self.M, (None, None)))
        square = {"M": self.M, "K": self.K} | ({} if self.C is None else {"C": self.C})
        for key, array in square.items():
            reals(key, array, (n, n))
        for what in ("forces", "sensors"):
            if getattr(self, what) is None:
                raise wanted(what, None, "rows by name")
            for key, array in mapping(what, getattr(self, what), "rows by name").items():
                reals(f"{what}[{key!r}]", array, (n,))
        found = items("interfaces", self.interfaces, LawPoints, "points with their law")
        names = [points.name for points in found]
        if len(set(names)) < len(names):
            raise wanted("interfaces", names, "names that stand once")
        for points in found:
            if points.rows.shape[2] != n:
                raise InputError(
                    f"{points.name}.rows has {points.rows.shape[2]} columns: expected {n}."
                )
        if self.C is None:
            object.__setattr__(self, "C", np.zeros((n, n)))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.n_dofs} DOFs, {named_points(self.interfaces)})"

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, n."""
        return len(self.M)

    def motion(self) -> DenseMotion:
        """The equation of motion."""
        return DenseMotion(self)

    def with_laws(self, **laws: JointLaw) -> InterfaceModel:
        """The same model with other laws at some interfaces, by the interface's name.

        Raises:
            InputError: For an unknown interface.
        """
        names = [points.name for points in self.interfaces]
        for name in laws:
            if name not in names:
                raise InputError(f"no interface {name!r}; expected one of: {', '.join(names)}.")
        changed = [replace(p, law=laws.get(p.name, p.law)) for p in self.interfaces]
        return replace(self, interfaces=tuple(changed))

    def with_parameters(self, values: Mapping[str, float]) -> InterfaceModel:
        """The same model with other parameters of its laws, named ``INTERFACE.PARAMETER``.

        Raises:
            InputError: For an unknown name, or a value that the law does not allow.
        """
        laws, changes = {p.name: p.law for p in self.interfaces}, {}
        for points in self.interfaces:
            points.kernel  # noqa: B018  compiled once, and taken over by changed laws
        for name, value in values.items():
            interface, _, key = name.rpartition(".")
            if interface not in laws:
                raise InputError(
                    f"parameters: {name!r} belongs to no interface; expected INTERFACE.PARAMETER "
                    f"with one of the interfaces {', '.join(laws) or 'none'}."
                )
            changes.setdefault(interface, {})[key] = float(value)
        return self.with_laws(**{k: laws[k].change(**v) for k, v in changes.items()})

    def stiffness_at_rest(self) -> np.ndarray:
        """Stiffness of small vibrations: K and the interfaces' tangents, N/m, (n, n)."""
        K = np.array(self.K, dtype=float)
        for points in self.interfaces:
            weighted = points.weights[:, None, None] * points.tangent()
            K += np.einsum("pin,pij,pjm->nm", points.rows, weighted, points.rows, optimize=True)
        return 0.5 * (K + K.T)

    def modes_at_rest(self) -> tuple[float, np.ndarray, np.ndarray]:
        """`inverted_modes` of small vibrations."""
        return inverted_modes(self.stiffness_at_rest(), self.M)

    def free_motions(self) -> FreeMotions:
        """Rigid motions that neither K nor an interface resists."""
        if not np.trace(self.stiffness_at_rest()) > 0:
            return no_motions(self.n_dofs, MPI.COMM_SELF)
        s, inverse, X = self.modes_at_rest()
        heavy = inverse > _MASSLESS * inverse[0]
        inverse, X = inverse[heavy], X[:, heavy] / np.sqrt(inverse[heavy])
        rigid = X[:, 1 / inverse - s < self._rigid_below()]
        if rigid.shape[1]:
            strains = [np.sqrt(p.weights)[:, None, None] * p.rows for p in self.interfaces]
            none = np.zeros((0, self.n_dofs))
            rows = np.concatenate([none, *(r.reshape(-1, self.n_dofs) for r in strains)])
            largest = np.linalg.norm(rows @ X, axis=0).max(initial=0.0)
            rigid = strainless(rigid, rows @ rigid, largest)
        return FreeMotions(rigid, self.M @ rigid, MPI.COMM_SELF)

    def _rigid_below(self) -> float:
        """Eigenvalue, (rad/s)^2, below which a mode at rest is a rigid motion."""
        return _RIGID * float(np.trace(self.stiffness_at_rest()) / np.trace(self.M))

    def row(self, kind: str, name: str) -> np.ndarray:
        """A place of force or a sensor by its name.

        Args:
            kind: ``forces`` or ``sensors``.
            name: Its name.

        Raises:
            InputError: If there is none of that name.
        """
        return np.asarray(named(getattr(self, kind), kind, name), dtype=float)


def inverted_modes(
    K: np.ndarray, M: np.ndarray, share: float = 1e-6
) -> tuple[float, np.ndarray, np.ndarray]:
    """Modes by theta = 1 / (omega^2 + s), (K + s M) x theta = M x, the lowest first.

    Inverted, since directions of a reduced basis may have next to no mass, and shifted, since a
    free body has no stiffness along some.

    Args:
        K: Stiffness, N/m, (n, n).
        M: Mass, kg, (n, n).
        share: s over trace(K) / trace(M).

    Returns:
        (s, (rad/s)^2; theta, descending, (n,); x with x^T (K + s M) x = 1 as columns, (n, n)).
    """
    s = share * np.trace(K) / np.trace(M)
    theta, X = scipy.linalg.eigh(M, 0.5 * (K + K.T) + s * M)
    return s, theta[::-1], X[:, ::-1]


class DenseMotion(Motion):
    """The motion of a reduced model, the same on every rank."""

    def __init__(self, model: InterfaceModel):
        super().__init__(model.interfaces, PETSc.COMM_SELF)
        self.model = model
        n = model.n_dofs
        self._flat = [p.rows.reshape(-1, n) for p in model.interfaces]
        self._loads = [
            (p.rows * p.weights[:, None, None]).reshape(-1, n).T.copy() for p in model.interfaces
        ]
        self._last = None

    def vector(self) -> PETSc.Vec:
        """A vector of zeros."""
        return PETSc.Vec().createSeq(self.model.n_dofs, comm=self.comm)

    def matrix(self) -> PETSc.Mat:
        """A matrix for `jacobian`."""
        n = self.model.n_dofs
        return PETSc.Mat().createDense((n, n), comm=self.comm)

    def free(self) -> FreeMotions:
        """Rigid motions that nothing resists."""
        return self.model.free_motions()

    def place(self, kind: str, name: str) -> PETSc.Vec:
        """The row of a force or a sensor."""
        return PETSc.Vec().createWithArray(self.model.row(kind, name).copy(), comm=self.comm)

    def _strain(self, i: int, u: PETSc.Vec) -> np.ndarray:
        return self._flat[i] @ u.array_r

    def step(self, u: PETSc.Vec, states, v=None, shift_v: float = 0.0) -> list[tuple]:
        """See `Motion.step`."""
        if self.rated:
            return super().step(u, states, v, shift_v)
        # A solver asks for residual and Jacobian, and at last the step itself, at the same place.
        known = self._last
        if known is None or known[0] is not states or not np.array_equal(known[1], u.array_r):
            self._last = known = states, u.array_r.copy(), super().step(u, states)
        return known[2]

    def residual(self, u, v, a, load, states, out: PETSc.Vec) -> None:
        """M a + C v + K u + f(u, states) - load into ``out``; loads are arrays or None."""
        m = self.model
        r = m.M @ a.array_r + m.C @ v.array_r + m.K @ u.array_r
        for rows, (_, stress, _, _) in zip(self._loads, self.step(u, states, v), strict=True):
            r += rows @ stress.ravel()
        out.array[:] = r - load.array_r

    def jacobian(self, u, states, shift_v: float, shift_a: float, out: PETSc.Mat, v=None) -> None:
        """K + d f/d u + shift_v C + shift_a M into ``out``, at the velocity v."""
        m = self.model
        J = m.K + shift_v * m.C + shift_a * m.M
        for rows, points, (_, _, _, tangent) in zip(
            self._loads, m.interfaces, self.step(u, states, v, shift_v), strict=True
        ):
            moved = np.matmul(tangent, points.rows).reshape(-1, m.n_dofs)
            J += rows @ moved
        out.getDenseArray()[:] = J
        out.assemble()

    def energy(self, u, v) -> float:
        """Kinetic energy and that of K, J: what interfaces store is not in it."""
        m, x, y = self.model, u.array_r, v.array_r
        return float(0.5 * (y @ m.M @ y + x @ m.K @ x))

    def product(self, name: str, x: PETSc.Vec) -> PETSc.Vec:
        """See `Motion.product`."""
        found = x.duplicate()
        found.array[:] = getattr(self.model, name) @ x.array_r
        return found

    def elastic_modes(self, K: PETSc.Mat) -> tuple[np.ndarray, Callable[[int], PETSc.Vec]]:
        """See `Motion.elastic_modes`."""
        try:
            shift, inverse, X = inverted_modes(K.getDenseArray(), self.model.M, 1.0)
        except scipy.linalg.LinAlgError as error:
            raise InputError(
                f"M and K at rest: expected positive (semi-)definite matrices ({error})."
            ) from error
        heavy = np.flatnonzero(inverse > _MASSLESS * inverse[0])[len(self.free()) :]

        def shape(i: int) -> PETSc.Vec:
            found = self.vector()
            found.array[:] = X[:, heavy[i]] / np.sqrt(inverse[heavy[i]])
            return found

        return 1 / inverse[heavy] - shift, shape

    def acceleration(self, force: PETSc.Vec, u: PETSc.Vec, states, step: float) -> PETSc.Vec:
        a = self.vector()
        a.array[:] = np.linalg.lstsq(self.model.M, force.array_r, rcond=None)[0]
        return a


def with_modal_damping(
    model: InterfaceModel, ratios: float | Sequence[float], rest: float = 0.0
) -> InterfaceModel:
    """The model with viscous damping of its modes at rest, C = M Phi diag(2 zeta omega) Phi^T M.

    Args:
        model: The model.
        ratios: Damping ratio of all modes, or of the first ones, rigid-body modes included.
        rest: Ratio of the modes beyond those.

    Raises:
        InputError: If a ratio is negative, or there are more of them than modes.
    """
    capable("model", model, ("M", "modes_at_rest"), "an InterfaceModel")
    n = model.n_dofs
    ratios, rest = reals("ratios", ratios, least=0.0), real("rest", rest, least=0.0)
    zeta = np.full(n, float(ratios) if ratios.ndim == 0 else rest)
    if ratios.ndim:
        if ratios.ndim > 1 or not len(ratios):
            raise wanted("ratios", ratios, "one number, or a list of them")
        if len(ratios) > n:
            raise InputError(f"ratios: {len(ratios)} of them; expected at most {n}, one per mode.")
        zeta[: len(ratios)] = ratios
    s, inverse, X = model.modes_at_rest()
    # 2 zeta omega / mu with x^T (K + s M) x = 1, mu = x^T M x = 1 / (omega^2 + s).
    omega = np.sqrt(np.maximum(1.0 - s * inverse, 0.0))
    # A direction without mass moves with the others' forces; damping of it has no meaning.
    heavy = inverse > 1e-14 * inverse[0]
    weight = np.divide(2 * zeta * omega, np.abs(inverse) ** 1.5, out=np.zeros(n), where=heavy)
    MX = model.M @ X
    return replace(model, C=(MX * weight) @ MX.T)


def with_rayleigh_damping(
    model: InterfaceModel, mass: float = 0.0, stiffness: float = 0.0
) -> InterfaceModel:
    """The model with C = mass M + stiffness K, K that of small vibrations at rest.

    Args:
        model: The model.
        mass: Factor of the mass, 1/s.
        stiffness: Factor of the stiffness, s.

    Raises:
        InputError: If a factor is negative or not finite.
    """
    capable("model", model, ("M", "stiffness_at_rest"), "an InterfaceModel")
    for key, value in (("mass", mass), ("stiffness", stiffness)):
        real(key, value, least=0)
    return replace(model, C=mass * model.M + stiffness * model.stiffness_at_rest())
