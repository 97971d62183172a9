"""How far a structure gives way under a steady force at a point, as a function of its parameters.

Modes are a poor basis for that, as the point itself gives way locally. So the basis is of static
responses to the very forces, at samples of the parameters. By the principle of least potential
energy the compliance that such a basis has is never too large, and too small by the square of what
the basis lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from petsc4py import PETSc

from fenics_joints.modal.eigensolver import EigenSolver
from fenics_joints.reduction.adaptive import Points
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.many import ManyValues, change, own_values
from fenics_joints.reduction.reduced import ReducedStructure
from fenics_joints.reduction.snapshots import orthonormal
from fenics_joints.structure import Sensors, Structure
from fenics_joints.structure.sparse import combination, vectors_like

#: Share of the largest energy below which a combination of the responses is round-off.
_DEPENDENT = 1e-12


class StaticSolver:
    """Static responses of the full model to a unit force at each sensor. Collective.

    Args:
        full: A structure that is held.
        sensors: Where the forces act, and along what.
    """

    def __init__(self, full: Structure, sensors: Sensors):
        self.full, self.sensors, self.loads = full, sensors, full.loads(sensors)
        self._solver = EigenSolver(1, shift=0.0)

    def __call__(self, values: Mapping[str, float]) -> tuple[np.ndarray, list[PETSc.Vec]]:
        """ln of the displacement at each force along it, m/N, (n,), and the responses.

        Args:
            values: Parameter values.

        Raises:
            ConvergenceError: If the structure is not held.
        """
        K, M = self.full.stiffness(values), self.full.mass(values)
        self._solver.factorise(K, M)
        moved = self._solver.inverse(self.loads)
        responses = vectors_like(K.createVecRight(), moved.T)
        K.destroy(), M.destroy()
        given_way = self.full.comm.allreduce(np.sum(self.loads * moved, axis=0))
        return np.log(given_way), responses

    def destroy(self) -> None:
        """Free the factorisation. Collective."""
        self._solver.destroy()


class StaticModel:
    """The same from a reduced model, by any parameter values, without other ranks.

    Args:
        model: A model whose ``sensor_rows`` are those of the forces.
        basis: The full model's vectors of its basis; None of one that is not reduced.
    """

    def __init__(self, model: ArrayModel, basis: list[PETSc.Vec] | None = None):
        self.model, self.basis = model, basis

    @classmethod
    def made(
        cls,
        solver: StaticSolver,
        samples: Points,
        travel: Mapping | None = None,
        tolerance: float = 1e-3,
        fresh: Callable[[int], Points] | None = None,
        rounds: int = 4,
    ) -> StaticModel:
        """From responses at samples, and at fresh points where those do not do. Collective.

        Args:
            solver: Of the full model.
            samples: Parameter values of the responses.
            travel: See `ReducedStructure`.
            tolerance: Error of ln of a compliance that is good enough.
            fresh: Gives points of a round to look at; None to look at none.
            rounds: How often more are taken in.
        """
        responses = [vector for values in samples for vector in solver(values)[1]]
        for turn in range(rounds):
            basis = orthonormal(solver.full, responses, samples[0], _DEPENDENT)
            reduced = ReducedStructure(solver.full, basis, travel)
            found = cls(reduced.arrays(), basis)
            found.model.sensor_rows = solver.full.observe(basis, solver.sensors)
            if fresh is None or turn == rounds - 1:
                break
            points = fresh(turn)
            exact, more = zip(*(solver(values) for values in points), strict=True)
            off = np.array([found.log_compliance(values) for values in points]) - exact
            if np.max(np.abs(off)) <= tolerance:
                break
            responses += [vector for vectors in more for vector in vectors]
        return found

    def log_compliance(self, values: Mapping[str, float | np.ndarray]) -> np.ndarray:
        """ln of the displacement at each force along it, m/N, (n,); (b, n) of values (b,)."""
        at = self.model.sensor_rows
        return np.log(np.einsum("sn,...ns->...s", at, self._moved(values, at)))

    def log_slopes(
        self, index: int, values: ManyValues, low: ManyValues, high: ManyValues, width: float
    ) -> np.ndarray:
        """Derivatives of one along directions in the parameters, (b, p): with K u = r and the
        compliance r^T u, that is - u^T dK u / r^T u.

        Args:
            index: Which.
            values: Parameter values, each (b,).
            low: See `fenics_joints.reduction.many.change`.
            high: Likewise.
            width: Likewise.
        """
        row, n = self.model.sensor_rows[index], len(next(iter(values.values())))
        moved = self._moved(values, row[None])[..., 0]
        low, high = (own_values(self.model, each) for each in (low, high))
        count = len(next(iter(low.values()))) // n
        along = change(self.model, low, high, width, count)
        stiff, _ = self.model.pencil.squares(moved.T)
        return -np.einsum("bt,btp->bp", stiff, along.theta) / (moved @ row)[:, None]

    def _moved(self, values, rows: np.ndarray) -> np.ndarray:
        """Responses to forces of these rows, (k, n): (n, k), or (b, n, k)."""
        K, _ = self.model.pencil.matrices(own_values(self.model, values))
        return np.linalg.solve(K, np.broadcast_to(rows.T, (*K.shape[:-2], *rows.T.shape)))

    def response(self, values: Mapping[str, float], index: int):
        """The response to a force in the full model's unknowns, as a vector of its kind."""
        y = np.linalg.solve(self.model.stiffness(values), self.model.sensor_rows[index])
        return y if self.basis is None else combination(self.basis, y)
