"""Natural frequencies and mode shapes of a structure, full or reduced."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import basix.ufl
import numpy as np
import scipy.linalg
import ufl
from dolfinx import fem
from petsc4py import PETSc

from fenics_joints.errors import (
    ConvergenceError,
    InputError,
    capable,
    items,
    member,
    real,
    wanted,
    whole,
)
from fenics_joints.files import dataframe
from fenics_joints.formatting import hertz, html_table
from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.modal.iterative import IterativeEigenSolver
from fenics_joints.structure import FormModel, Model, Sensors
from fenics_joints.structure.grids import cell_grid, pyvista, write_fields

#: The shift's frequency as a share of the structure's dilation frequency: far enough below zero
#: for a safe factorisation of a free body, near enough for fast convergence.
SHIFT_SHARE = 0.002
#: A mode below this share of the shift's frequency moves the body without straining it.
_RIGID_SHARE = 0.01
#: Or below so many round-offs of the stiffness: those of rigid bodies with joint layers of a
#: micrometre came to 3 at most, elastic modes had 400 and more.
_ROUND_OFFS = 20.0
#: Share of a mode's energy in the structure itself below which it is round-off.
NOTHING = 1e-9
#: Share of a dense problem's modes above which all are found sooner than some.
_SOME = 1 / 8


@dataclass(frozen=True, repr=False)
class Modes:
    """Modes of a structure, in ascending order, rigid-body modes first.

    Attributes:
        model: The model they belong to.
        given: The parameters that differed from their nominal values.
        eigenvalues: omega^2, (rad/s)^2, shape (n,).
        shapes: M-normalised shapes: n PETSc vectors, or an array (n_dofs, n) of a reduced model.
        n_rigid: Number of rigid-body modes.
        residuals: Relative residuals, shape (n,); None for a dense solution.
        solver: The `EigenSolver` that was used; its ``solver`` is SLEPc's. With the iterative
            method an `IterativeEigenSolver`, whose ``solver`` is PETSc's. None when dense.
        statistics: The solver's counts and times.
    """

    model: Model
    given: Mapping[str, float]
    eigenvalues: np.ndarray
    shapes: list[PETSc.Vec] | np.ndarray
    n_rigid: int
    residuals: np.ndarray | None = None
    solver: EigenSolver | IterativeEigenSolver | None = None
    statistics: Mapping[str, object] | None = None

    def __len__(self) -> int:
        return len(self.eigenvalues)

    def __repr__(self) -> str:
        highest = f"to {self.frequencies_hz[-1]:.5g} Hz" if len(self) else "none"
        return f"Modes({len(self)}, {highest}, {self.n_rigid} of a rigid body, of {self.model!r})"

    @property
    def frequencies_hz(self) -> np.ndarray:
        """Natural frequencies, Hz, shape (n,); 0 for an eigenvalue that round-off made negative."""
        return np.sqrt(np.maximum(self.eigenvalues, 0.0)) / (2 * np.pi)

    def vector(self, i: int) -> PETSc.Vec | np.ndarray:
        """Shape of mode ``i`` in the model's own unknowns: a PETSc vector, or a column of
        ``shapes`` where the model is dense."""
        return self.shapes[:, i] if self.model.is_dense else self.shapes[i]

    def shape(self, i: int) -> fem.Function | PETSc.Vec | np.ndarray:
        """Shape of mode ``i``: of solids a function on their mesh, to be evaluated or written.

        Of a model without a mesh it is the `vector`. Collective.

        Returns:
            The M-normalised displacement, kg^-1/2, a copy.

        Raises:
            InputError: If there is no such mode.
        """
        i = whole("i", i, least=-len(self), most=len(self) - 1)
        displacement = getattr(self.model, "displacement", None)
        vector = self.vector(i)
        return vector if displacement is None else displacement(vector)

    def to_pyvista(self, i: int):
        """Mode ``i`` as ``displacement`` of the model's cells, for pyvista. Collective.

        ``grid.warp_by_vector("displacement", factor=...)`` shows it.

        Returns:
            A ``pyvista.UnstructuredGrid`` in metres on rank 0, the displacement M-normalised,
            kg^-1/2; None on the other ranks.

        Raises:
            InputError: If there is no such mode, the model has no cells, or pyvista is not
                installed.
        """
        i = whole("i", i, least=-len(self), most=len(self) - 1)
        motion = getattr(self.model, "corner_motion", None)
        if motion is None:
            raise InputError(f"{self.model!r}: has no cells to look at.")
        pyvista()
        corners, (shape,) = motion([self.vector(i)])
        if not len(corners):
            return None
        flat = np.ptp(corners.reshape(-1, 3), axis=0) > 0
        tdim = 3 if flat.all() else 2
        return cell_grid(corners, tdim, {"displacement": shape})

    def _repr_html_(self) -> str:
        rows = [
            (str(i + 1), hertz(f), "rigid body" if i < self.n_rigid else "elastic")
            for i, f in enumerate(self.frequencies_hz)
        ]
        return html_table(f"{len(self)} modes", ("mode", "Hz", ""), rows)

    def to_dataframe(self):
        """A ``pandas.DataFrame`` with mode (from 1), frequency_hz and rigid_body.

        Raises:
            InputError: If pandas is not installed.
        """
        numbers = np.arange(1, len(self) + 1)
        rigid = numbers <= self.n_rigid
        return dataframe(
            {"mode": numbers, "frequency_hz": self.frequencies_hz, "rigid_body": rigid}
        )

    def at(self, sensors: Sensors) -> np.ndarray:
        """Mass-normalised shapes at sensors, kg^-1/2, shape (n_sensors, n)."""
        return self.model.observe(self.shapes, sensors)

    def visibility(self, sensors: Sensors) -> np.ndarray:
        """How much of each mode the sensors see, shape (n,).

        Root mean square of the shape at the sensors, relative to that of a rigid translation along
        them (which is 1): near 1 for a mode that moves as the sensors measure, near 0 for one that
        they miss. The motion of an attached oscillator is left out.
        """
        mass, own = self.model.total_mass(self.given), 0.0
        if hasattr(self.model, "hung_share"):
            own = self.model.hung_share(self.shapes, self.model.values(self.given))
        rest = np.maximum(1.0 - own, NOTHING)
        return np.sqrt(np.mean(self.at(sensors) ** 2, axis=0) * mass / rest)

    def gradients(self, index: Sequence[int]) -> np.ndarray:
        """Derivatives of eigenvalues by every parameter, shape (len(index), n_parameters).

        For a multiple eigenvalue they are the derivatives of these shapes' Rayleigh quotients only.
        """
        index = [int(i) for i in index]
        shapes = self.shapes[:, index] if self.model.is_dense else [self.shapes[i] for i in index]
        return self.model.pencil_gradients(shapes, self.eigenvalues[index], self.given)


def solve_modes(
    model: Model | ufl.Form,
    given: Mapping[str, float] | ufl.Form | None = None,
    *,
    bcs: Iterable[fem.DirichletBC] = (),
    n_modes: int = 20,
    shift_hz: float | None = None,
    petsc_options: Mapping[str, object] | None = None,
    solver: EigenSolver | IterativeEigenSolver | None = None,
    initial: Modes | None = None,
    tolerance: float | None = None,
    method: str = "direct",
) -> Modes:
    """Lowest modes of K(p) x = omega^2 M(p) x.

    Of two bilinear forms, on any function space: ``solve_modes(a, m, bcs=bcs, n_modes=12)``.

    Args:
        model: Any model: a structure; a reduced one or beams, which are solved densely; or a
            bilinear form, the stiffness.
        given: Values of parameters that differ from their nominal value; beside a form the mass.
        bcs: Dirichlet conditions beside forms, see `fenics_joints.structure.FormModel`.
        n_modes: Number of modes, rigid-body modes included.
        shift_hz: The factorised matrix is K + (2 pi shift_hz)^2 M; by default a five-hundredth of
            the frequency at which the whole body would breathe, which suits free and held bodies.
        petsc_options: Options of SLEPc's and PETSc's solvers, without prefix.
        solver: One from an earlier solution, to keep its ordering.
        initial: Modes of a near model, to start from.
        tolerance: Relative error of the shapes; an eigenvalue's is of the order of its square.
            By default 1e-7, with the iterative method 1e-6.
        method: ``"direct"`` factorises; ``"iterative"`` takes LOBPCG with multigrid, which needs
            much less memory, and a `Structure`.

    Raises:
        InputError: If ``n_modes`` or ``method`` is out of range, or the iterative method is asked
            of something that is no `Structure`.
        ConvergenceError: If fewer modes converged than asked for.
    """
    bcs = items("bcs", bcs, fem.DirichletBC, "Dirichlet conditions")
    if isinstance(model, ufl.Form):
        model, given = FormModel(model, given, bcs), None
    elif bcs:
        raise InputError(f"bcs: expected none beside a {type(model).__name__}, which has its own.")
    check_model(model)
    n_modes = whole("n_modes", n_modes)
    member("method", method, ("direct", "iterative"))
    if shift_hz is not None:
        real("shift_hz", shift_hz, "Hz", least=0)
    if tolerance is not None:
        real("tolerance", tolerance, above=0)
    model.values(given)
    if initial is not None and not isinstance(initial, Modes):
        raise wanted("initial", initial, "Modes of a similar model, or None")
    given = dict(given or {})
    settings = {"tol": tolerance} if tolerance is not None else {}
    settings["petsc_options"] = petsc_options
    start = None if initial is None else initial.shapes
    kind = IterativeEigenSolver if method == "iterative" else EigenSolver
    if method == "iterative" and not model.is_meshed:
        raise InputError(
            f"method = 'iterative': a {type(model).__name__} has no mesh for multigrid; expected "
            "a Structure, or method = 'direct'."
        )
    if not model.is_dense and (not isinstance(solver, kind) or solver.n != n_modes):
        solver = kind(n_modes, shift=_shift(model, given, shift_hz), **settings)
    if method == "iterative":
        return _modes(model, given, solver, solver.solve(model, given, start))
    K, M = model.stiffness(given), model.mass(given)
    if model.is_dense:
        return _solve_dense(model, given, K, M, n_modes)
    result = solver.solve(K, M, start)
    K.destroy(), M.destroy()
    return _modes(model, given, solver, result)


def refine_modes(
    model: Model, given: Mapping[str, float], solver: EigenSolver, start: np.ndarray
) -> Modes:
    """Modes of a structure near a subspace, see `EigenSolver.refine`. Collective.

    Args:
        model: A structure.
        given: Values of parameters that differ from their nominal value.
        solver: One of the structure, whose ordering is kept.
        start: This rank's rows of the subspace, (n_local, k), such as modes of a reduced model.

    Raises:
        ConvergenceError: If the matrices cannot be factorised.
    """
    K, M = model.stiffness(given), model.mass(given)
    result = solver.refine(K, M, start)
    K.destroy(), M.destroy()
    return _modes(model, dict(given), solver, result)


def eigen_solver(
    model: Model, given: Mapping[str, float], n_modes: int, tolerance: float
) -> EigenSolver:
    """The solver that `solve_modes` makes for a model at parameter values.

    Args:
        model: A structure.
        given: Values of parameters that differ from their nominal value.
        n_modes: Number of modes.
        tolerance: See `solve_modes`.
    """
    return EigenSolver(n_modes, shift=_shift(model, given, None), tol=tolerance)


def check_model(model: object) -> None:
    """Refuse an object without K(p) and M(p).

    Raises:
        InputError: If it is none.
    """
    calls = ("stiffness", "mass", "values", "is_dense")
    capable("model", model, calls, "a structure, a reduced model or beams")


def _shift(model, given, shift_hz: float | None) -> float:
    scale = model.dilation_frequency(given) if shift_hz is None else shift_hz / SHIFT_SHARE
    return -((2 * np.pi * SHIFT_SHARE * scale) ** 2)


def _modes(model, given, solver, result) -> Modes:
    shift_hz = np.sqrt(-solver.shift) / (2 * np.pi)
    n_rigid = count_rigid(result.values, shift_hz, result.round_off)
    own = result.residuals, solver, result.statistics
    return Modes(model, given, result.values, result.shapes, n_rigid, *own)


def _solve_dense(model, given, K, M, n_modes) -> Modes:
    if n_modes > len(K):
        raise InputError(
            f"n_modes = {n_modes}: expected at most {len(K)}, the size of the reduced model."
        )
    shift_hz = model.dilation_frequency(given) * SHIFT_SHARE
    every = getattr(model, "all_modes", None)  # of one that keeps them for who asks for more
    values, vectors = dense_modes(K, M, shift_hz, n_modes) if every is None else every(given)
    values, vectors = values[:n_modes], vectors[:, :n_modes]
    return Modes(model, given, values, vectors, count_rigid(values, shift_hz))


def dense_modes(
    K: np.ndarray, M: np.ndarray, shift_hz: float, n_modes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest eigenvalues, (n_modes,), and M-normalised vectors, (n, n_modes), of dense matrices.

    Raises:
        ConvergenceError: If they are not found.
    """
    shift = (2 * np.pi * shift_hz) ** 2
    return upright(*inverted_modes(K, M, shift, n_modes), shift)


def upright(
    inverse: np.ndarray, vectors: np.ndarray, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and M-normalised vectors of `inverted_modes`, or of stacks of them.

    Where a vector's mass is round-off beside its stiffness, its eigenvalue is infinite and it is 0.
    """
    none = inverse <= np.finfo(float).eps * np.max(inverse, axis=-1, keepdims=True)
    inverse = np.where(none, np.inf, inverse)
    vectors = np.where(none[..., None, :], 0.0, vectors / np.sqrt(inverse)[..., None, :])
    return np.where(none, np.inf, 1 / inverse - shift), vectors


def inverted_modes(
    K: np.ndarray, M: np.ndarray, shift: float, n_modes: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """1 / (lambda + shift), descending, and vectors with x^T (K + shift M) x = 1, as columns.

    Inverted, the wanted eigenvalues are the largest: round-off of stiff layers, of the order of the
    largest of K, would swamp the rigid-body modes otherwise. A vector without mass has 0.

    Raises:
        ConvergenceError: If they are not found.
    """
    n = len(K)
    some = None if n_modes is None or n_modes > _SOME * n else [n - n_modes, n - 1]
    try:
        inverse, vectors = scipy.linalg.eigh(
            M, K + shift * M, subset_by_index=some, check_finite=False
        )
    except scipy.linalg.LinAlgError as error:
        raise ConvergenceError(
            "the reduced eigenproblem was not solved; build the reduced model with a larger "
            "tolerance",
            str(error),
        ) from error
    return inverse[::-1][:n_modes], vectors[:, ::-1][:, :n_modes]


def count_rigid(
    eigenvalues: np.ndarray, shift_hz: float, round_off: np.ndarray | float = 0.0
) -> int:
    """Number of rigid-body modes among eigenvalues that were found with that shift.

    Args:
        eigenvalues: (rad/s)^2, shape (n,).
        shift_hz: The shift's frequency, Hz.
        round_off: Bound of each eigenvalue's round-off, see `EigenResult`.
    """
    least = np.maximum(rigid_below(shift_hz), _ROUND_OFFS * np.asarray(round_off))
    return int(np.sum(np.abs(eigenvalues) < least))


def rigid_below(shift_hz: float) -> float:
    """Eigenvalue, (rad/s)^2, below which a mode that was found with that shift is a rigid one."""
    return (2 * np.pi * _RIGID_SHARE * shift_hz) ** 2


# -- files for ParaView ------------------------------------------------------------------------


def write_shapes(modes: Modes, path: str | Path) -> list[Path]:
    """Write all elastic modes: VTX for ``.bp``, XDMF with HDF5 for ``.xdmf``. Collective.

    Every mode is a vector field ``mode_07_123.45_Hz``, M-normalised, kg^-1/2: in ParaView choose it
    in a filter "Warp By Vector". In VTX it is of the model's degree, in XDMF linear between
    vertices.

    Args:
        modes: Modes of solids.
        path: Name of the file; one that is there is replaced.

    Returns:
        The files.

    Raises:
        InputError: If the model has no mesh or no mode is elastic; for another ending, a DOLFINx
            without ADIOS2, or if a file cannot be written.
    """
    check_meshed(modes.model, path)
    elastic = range(modes.n_rigid, len(modes))
    if not elastic:
        raise InputError(
            f"{path}: all {len(modes)} modes are those of a rigid body; expected more modes."
        )
    V = modes.shape(elastic[0]).function_space
    degree = 1 if Path(path).suffix == ".xdmf" else V.ufl_element().degree
    shape = (V.mesh.geometry.dim,)
    element = basix.ufl.element("Lagrange", V.mesh.topology.cell_name(), degree, shape=shape)
    W = fem.functionspace(V.mesh, element)
    fields = []
    for i in elastic:
        field = fem.Function(W, name=f"mode_{i + 1:02d}_{modes.frequencies_hz[i]:.2f}_Hz")
        field.interpolate(modes.shape(i))
        fields.append(field)
    return write_fields(fields, path)


def check_meshed(model: object, path: str | Path) -> None:
    """Refuse a model whose modes are no fields.

    Raises:
        InputError: If it is of beams, or reduced.
    """
    if not hasattr(model, "displacement"):
        raise InputError(
            f"{path}: a {type(model).__name__} has no mesh for ParaView; expected a model of solids"
        )
