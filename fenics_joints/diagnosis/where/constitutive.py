"""Where measured shapes contradict a model: the modified error in the constitutive relation.

For a mode measured at omega with the shape s (sensors P u), the functional (Ladeveze and others;
Deraemaeker, Ladeveze and Leconte, Comput. Methods Appl. Mech. Engrg. 191, 2002, 2427-2444)

    J = gamma (u - v)^T K (u - v) + (1 - gamma) omega^2 (u - w)^T M (u - w) + rho |P u - s|^2,

is made least over u, v, w under equilibrium, K v = omega^2 M w: stresses K v and inertia forces
omega^2 M w that balance exactly, a motion u that is near the sensors, and the laws between them,
which are what is doubted, violated where that costs least. With the multiplier 2 lambda,

    by v:  K lambda = gamma K (u - v),               so v = u - lambda / gamma,
    by w:  M lambda = -(1 - gamma) M (u - w),        so w = u + lambda / (1 - gamma),
    by u:  (K - omega^2 M) lambda + rho P^T P u = rho P^T s,

and equilibrium becomes (K - omega^2 M) u = (K / gamma + omega^2 M / (1 - gamma)) lambda. So two
fields are solved for at once, by one symmetric (indefinite) sparse matrix:

    [ rho P^T P    K - omega^2 M                          ] [   u    ]   [ rho P^T s ]
    [ K - omega^2 M  -(K / gamma + omega^2 M / (1 - gamma)) ] [ lambda ] = [     0     ].

It is regular if the sensors see every mode of the model at omega. A model with the measured mode
has lambda = 0. The error of stiffness is lambda^T K lambda / gamma, that of mass
omega^2 lambda^T M lambda / (1 - gamma): sums over cells, and so over regions and patches. Both
fields are linear in s, so that noise of the shapes adds its own energy to that of the true ones on
the average; it is found from a few draws by the same factorisation, and taken off.

A thin layer that the model has far too stiff shows less of its error than its neighbours do, which
bend where it does not: there the error over the region's own strain energy says more than the
energies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from petsc4py import PETSc

from fenics_joints.diagnosis.where.patches import Patches, per_property
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.structure.points import Sensors
from fenics_joints.structure.structure import Structure

__all__ = ["ConstitutiveError", "TwoFields", "check_measured", "constitutive_error"]

#: Relative error in energy that is taken as lightly as a deviation at the sensors by their noise:
#: shapes are then met to about two thirds of their noise.
_DOUBT = 1e-2
#: Energy per volume, relative to the structure's mean, that a region counts with at least.
_LITTLE = 0.25
_OPTIONS = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
    "mat_mumps_icntl_14": "60",
}
_PREFIX = "fenics_joints_constitutive_"


@dataclass(frozen=True)
class ConstitutiveError:
    """Error in the constitutive relation, by region and patch and by measured mode.

    All energies of a mode are relative to its own strain energy in the whole structure.

    Attributes:
        frequencies_hz: Measured frequencies, (m,).
        regions: Names of the regions.
        stiffness: Error of the stiffness of each region, (n_regions, m).
        inertia: Error of its mass, (n_regions, m).
        by_noise: What noise of the shapes alone adds to ``stiffness`` on average.
        strain: Strain energy of each region, (n_regions, m); columns sum to 1.
        volume: Share of each region in the volume, (n_regions,).
        patches: Names of the patches, if asked for.
        patch_stiffness: As ``stiffness`` by patch, (P, m).
        patch_by_noise: As ``by_noise`` by patch, (P, m).
        patch_strain: As ``strain`` by patch, (P, m).
        patch_volume: As ``volume`` by patch, (P,).
        deviation: Root mean square of P u - s over that of s, by mode, (m,).
    """

    frequencies_hz: np.ndarray
    regions: tuple[str, ...]
    stiffness: np.ndarray
    inertia: np.ndarray
    by_noise: np.ndarray
    strain: np.ndarray
    volume: np.ndarray
    patches: tuple[str, ...]
    patch_stiffness: np.ndarray
    patch_by_noise: np.ndarray
    patch_strain: np.ndarray
    patch_volume: np.ndarray
    deviation: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """Whole error of each mode, (m,)."""
        return self.stiffness.sum(axis=0) + self.inertia.sum(axis=0)

    @property
    def relative(self) -> np.ndarray:
        """Error of the stiffness of each region, without what noise alone would make, over its own
        strain energy, all modes together, (n_regions,); below zero where it is less than that.

        A region that is strained little, as a free end is, tells little of its law: it counts with
        a quarter of the structure's mean energy per volume at least.
        """
        return _over(self.stiffness - self.by_noise, self.strain, self.volume)

    @property
    def patch_relative(self) -> np.ndarray:
        """The same by patch, (P,)."""
        return _over(self.patch_stiffness - self.patch_by_noise, self.patch_strain,
                     self.patch_volume)  # fmt: skip

    def to_json(self) -> dict:
        """Plain lists."""
        regions = {
            "name": self.regions, "relative": self.relative, "stiffness": self.stiffness,
            "inertia": self.inertia, "by_noise": self.by_noise, "strain": self.strain,
        }  # fmt: skip
        patches = {
            "name": self.patches, "relative": self.patch_relative,
            "stiffness": self.patch_stiffness, "by_noise": self.patch_by_noise,
            "strain": self.patch_strain,
        }  # fmt: skip
        return {
            "frequencies_hz": self.frequencies_hz.tolist(),
            "total": self.total.tolist(),
            "deviation": self.deviation.tolist(),
            "regions": _rows(regions),
            "patches": _rows(patches),
        }


def _over(error: np.ndarray, strain: np.ndarray, volume: np.ndarray) -> np.ndarray:
    own = strain.sum(axis=1)
    return error.sum(axis=1) / np.maximum(own, _LITTLE * volume * own.sum())


def _rows(columns: Mapping[str, Sequence]) -> list[dict]:
    """A table's rows, of plain numbers and lists."""
    plain = [np.asarray(values).tolist() for values in columns.values()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*plain, strict=True)]


def constitutive_error(
    structure: Structure,
    given: Mapping[str, float] | None,
    shapes: np.ndarray,
    frequencies_hz: Sequence[float],
    sensors: Sensors,
    *,
    split: Patches | None = None,
    gamma: float = 0.5,
    noise: float = 0.02,
    draws: int = 8,
) -> ConstitutiveError:
    """Where the constitutive laws must be violated for a model to move as measured. Collective.

    Args:
        structure: The full model.
        given: Values of parameters that differ from their nominal value.
        shapes: Measured shapes, any scale, (n_sensors, m); nan where a sensor was missing.
        frequencies_hz: Measured frequencies, (m,).
        sensors: Where and in which direction they were measured.
        split: Patches to report as well, from `fenics_joints.diagnosis.where.patches.patches`.
        gamma: Doubt of the mass against that of the stiffness, between 0 and 1: near 1 the mass
            is doubted, near 0 the stiffness.
        noise: Standard deviation of the shapes relative to their root mean square. It sets rho:
            a deviation of this size weighs as much as an error of a hundredth of the energy.
        draws: Draws of noise from which its own error is estimated; 0 takes nothing off.

    Raises:
        InputError: If shapes, frequencies and sensors do not agree, or a value is out of range.
        ConvergenceError: If the system is singular: sensors that miss a mode at its frequency.
    """
    shapes = np.asarray(shapes, dtype=float)
    hz = np.asarray(frequencies_hz, dtype=float)
    check_measured(shapes, hz, sensors, gamma, noise)
    system = TwoFields(structure, given, sensors, gamma)
    split = _whole(structure) if split is None else split
    try:
        pairs = zip(shapes.T, 2 * np.pi * hz, strict=True)
        modes = [system.mode(s, omega, noise, split, draws) for s, omega in pairs]
    finally:
        system.destroy()
    tables = {key: np.array([mode[key] for mode in modes]).T for key in modes[0]}
    names = tuple(region.name for region in structure.regions)
    volume = structure.volumes()
    return ConstitutiveError(
        hz, regions=names, volume=volume / volume.sum(), patches=split.names,
        patch_volume=split.volume / volume.sum(), **tables,
    )  # fmt: skip


def _whole(structure: Structure) -> Patches:
    """No patches."""
    owned = structure.mesh.topology.index_map(structure.mesh.topology.dim).size_local
    return Patches(np.zeros(owned, dtype=int), (), (), np.zeros((0, 3)), np.zeros(0))


def check_measured(shapes, hz, sensors, gamma, noise) -> None:
    """See `constitutive_error`."""
    if shapes.shape != (len(sensors), len(hz)):
        raise InputError(
            f"shapes has shape {shapes.shape}: expected {(len(sensors), len(hz))}, a row for each "
            "sensor and a column for each frequency."
        )
    if not np.all(hz > 0):
        raise InputError(f"frequencies_hz = {hz.tolist()}: expected numbers above zero.")
    if not np.all(np.any(np.isfinite(shapes) & (shapes != 0), axis=0)):
        raise InputError("shapes: a mode without any motion; expected a finite value in each.")
    for name, value, high in (("gamma", gamma, 1.0), ("noise", noise, np.inf)):
        if not 0 < value < high:
            raise InputError(f"{name} = {value}: expected above 0 and below {high:g}.")


class TwoFields:
    """The two-field system of one structure, for one measured mode after another."""

    def __init__(self, structure: Structure, given, sensors: Sensors, gamma: float):
        self.structure, self.given, self.gamma, self.sensors = structure, given, gamma, sensors
        self.K, self.M = structure.stiffness(given), structure.mass(given)
        self.comm = structure.comm
        self.P = self._sensor_rows()
        self.diagonal = PETSc.Mat().createAIJ(self.K.getSizes(), nnz=1, comm=self.K.comm)
        self.diagonal.setDiagonal(self.K.createVecRight())
        self.diagonal.assemble()

    def destroy(self) -> None:
        for matrix in (self.K, self.M, self.P, self.diagonal):
            matrix.destroy()

    def _sensor_rows(self) -> PETSc.Mat:
        """Displacement at the sensors by the DOFs, held ones left out; all rows on rank 0."""
        structure, sensors = self.structure, self.sensors
        rows, gdim = structure.rows(sensors.points, "sensor"), structure.gdim
        imap = structure.V.dofmap.index_map
        local = len(sensors) if self.comm.rank == 0 else 0
        P = PETSc.Mat().createAIJ(
            [(local, len(sensors)), self.K.getSizes()[1]], comm=self.K.comm,
            nnz=(rows.nodes.shape[1] * gdim if len(rows.nodes) else 81,) * 2,
        )  # fmt: skip
        P.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        for i, nodes, N in zip(rows.index, rows.nodes, rows.values, strict=True):
            direction = sensors.directions[i, :gdim]
            blocks = imap.local_to_global(nodes)
            columns = (blocks[:, None] * gdim + np.arange(gdim)).ravel().astype(PETSc.IntType)
            local_dofs = (nodes[:, None] * gdim + np.arange(gdim)).ravel()
            free = ~structure.held_dofs[local_dofs]
            P.setValues([int(i)], columns, np.outer(N, direction).ravel() * free)
        P.assemble()
        return P

    def mode(self, shape, omega: float, noise: float, split: Patches, draws: int) -> dict:
        """Energies by region and patch, and the deviation at the sensors, of a measured mode."""
        there = np.isfinite(shape)
        s = np.where(there, shape, 0.0)
        s = s / np.sqrt(np.mean(s[there] ** 2))
        rng = np.random.default_rng(len(s))
        loads = [s, *(noise * there * rng.standard_normal((draws, len(s))))]
        fields = self.solve(loads, there, omega, self.trust(there, omega, noise))
        u, lam = fields[0]
        motion, error = self._energies(u, omega, split), self._energies(lam, omega, split)
        drawn = [self._energies(field, omega, split) for _, field in fields[1:]]
        chance = [sum(k) / draws for k in zip(*drawn, strict=True)] or [0 * e for e in error]
        off = (self._read(u) - s)[there]
        self._release(fields)
        whole = motion[0].sum()
        stiff, heavy = 1 / (self.gamma * whole), 1 / ((1 - self.gamma) * whole)
        return {
            "stiffness": stiff * error[0],
            "inertia": heavy * error[1],
            "by_noise": stiff * chance[0],
            "strain": motion[0] / whole,
            "patch_stiffness": stiff * error[2],
            "patch_by_noise": stiff * chance[2],
            "patch_strain": motion[2] / whole,
            "deviation": float(np.sqrt(np.mean(off**2))),
        }

    def _release(self, fields: Sequence[tuple]) -> None:
        for vector in (v for pair in fields for v in pair):
            vector.destroy()

    def trust(self, there, omega, noise) -> float:
        """rho: noise at all sensors weighs as a hundredth of the energy of a motion like s.

        That energy is omega^2 times the modal mass, which is the structure's mass for a motion of
        root mean square 1.
        """
        mass = self.structure.total_mass(self.given)
        return _DOUBT * omega**2 * mass / (noise**2 * float(there.sum()))

    def solve(self, loads, there, omega: float, rho: float) -> list[tuple]:
        """(u, lambda) for each s of ``loads``: vectors laid out like the rows of K."""
        W, whole = self._matrix(there, omega, rho)
        ksp = self._factorised(whole)
        load, solution = whole.createVecRight(), whole.createVecRight()
        right, image = self.P.createVecLeft(), self.P.createVecRight()
        n, found = image.getLocalSize(), []
        for s in loads:
            right.array[:] = rho * s if self.comm.rank == 0 else []
            W.multTranspose(right, image)
            load.array[:n], load.array[n:] = image.array_r, 0.0
            ksp.solve(load, solution)
            self._check(ksp, whole, load, solution)
            pair = image.duplicate(), image.duplicate()
            pair[0].array[:], pair[1].array[:] = solution.array_r[:n], solution.array_r[n:]
            found.append(pair)
        for owned in (ksp, W, whole, load, solution, right, image):
            owned.destroy()
        return found

    def _matrix(self, there, omega: float, rho: float) -> tuple[PETSc.Mat, PETSc.Mat]:
        """The sensors' rows, zero where one was missing, and the matrix of both fields."""
        W = self.P.duplicate(copy=True)
        kept = self.P.createVecLeft()
        kept.array[:] = there if self.comm.rank == 0 else []
        W.diagonalScale(kept, None)
        PtP = self.P.transposeMatMult(W)
        PtP.scale(rho)
        # The Cholesky of several ranks needs every entry of the diagonal to be stored, zero or not.
        any_pattern = PETSc.Mat.Structure.UNKNOWN_NONZERO_PATTERN
        PtP.axpy(1.0, self.diagonal, any_pattern)
        A, B = self.K.duplicate(copy=True), self.K.duplicate(copy=True)
        A.axpy(-(omega**2), self.M, any_pattern)
        B.scale(-1 / self.gamma)
        B.axpy(-(omega**2) / (1 - self.gamma), self.M, any_pattern)
        whole = PETSc.Mat().createNest([[PtP, A], [A, B]], comm=self.K.comm)
        whole.assemble()
        whole.convert("aij")
        whole.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        for owned in (kept, PtP, A, B):
            owned.destroy()
        return W, whole

    def _factorised(self, A: PETSc.Mat) -> PETSc.KSP:
        """A direct solver; our options stand back behind the command line's."""
        options = PETSc.Options(_PREFIX)
        ours = {key: value for key, value in _OPTIONS.items() if not options.hasName(key)}
        for key, value in ours.items():
            options.setValue(key, value)
        ksp = PETSc.KSP().create(A.comm)
        try:
            ksp.setOptionsPrefix(_PREFIX)
            ksp.setOperators(A)
            ksp.setFromOptions()
            ksp.setUp()
        except PETSc.Error as error:
            raise ConvergenceError("the two fields could not be solved for", str(error)) from error
        finally:
            for key in ours:
                options.delValue(key)
        return ksp

    @staticmethod
    def _check(ksp: PETSc.KSP, A: PETSc.Mat, load: PETSc.Vec, solution: PETSc.Vec) -> None:
        residual = load.duplicate()
        A.mult(solution, residual)
        residual.axpy(-1.0, load)
        size = residual.norm() / max(load.norm(), 1e-300)
        residual.destroy()
        if ksp.getConvergedReason() < 0 or not size < 1e-4:
            raise ConvergenceError(
                "the two fields could not be solved for: do the sensors see every mode of the "
                "model near the measured frequency?", f"relative residual {size:.1e}",
            )  # fmt: skip

    def _read(self, u: PETSc.Vec) -> np.ndarray:
        """Motion at the sensors, (n_sensors,), equal on all ranks."""
        out = self.P.createVecLeft()
        self.P.mult(u, out)
        found = self.comm.bcast(out.array_r.copy(), root=0)
        out.destroy()
        return found

    def _energies(self, x: PETSc.Vec, omega: float, split: Patches):
        """x^T K x and omega^2 x^T M x by region, and x^T K x by patch."""
        structure = self.structure
        gradient = structure.cell_gradient(x, omega**2, self.given)
        # Stiffness is of the first degree in all moduli together, mass in the density.
        stiff = per_property(structure, gradient, "E") + per_property(structure, gradient, "G")
        heavy = -per_property(structure, gradient, "rho")
        by_region = np.zeros((2, len(structure.regions)))
        for number, (_, cells) in enumerate(structure.field.regions):
            cells = cells[cells < len(stiff)]
            by_region[:, number] = stiff[cells].sum(), heavy[cells].sum()
        by_patch = split.sums(structure, stiff) if len(split) else np.zeros(0)
        return (*self.comm.allreduce(by_region), by_patch)
