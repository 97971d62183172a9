"""What a preload leaves: pressures, gaps, slips and status of every contact, and the bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.formatting import html_table, quantity
from fenics_joints.preload.conditions import OPEN, SLIP, STICK, ContactPairs
from fenics_joints.preload.interface import Interface
from fenics_joints.preload.patch import contour_area, largest_radius, mean_within
from fenics_joints.structure.grids import facet_mesh

if TYPE_CHECKING:
    from fenics_joints.preload.solve import PreloadSolver

#: Share of the largest pressure above which a contact presses.
_PRESSES = 1e-9


@dataclass(frozen=True, repr=False)
class ContactState:
    """One contact in a preload state; arrays are equal on all ranks.

    Attributes:
        name: The contact's name.
        interface: Its pairs: positions, frames, areas, facets.
        force: Nodal forces between the bodies, N, (n, gdim): pressing, then along the tangents.
        gap: Opening, m, (n,); zero where closed.
        slip: Jump along the tangents, m, (n, gdim - 1).
        status: OPEN (0), SLIP (1) or STICK (2) at each pair, (n,).
        axisymmetric: Whether each pair is a circle, whose forces along the radius balance.
    """

    name: str
    interface: Interface
    force: np.ndarray
    gap: np.ndarray
    slip: np.ndarray
    status: np.ndarray
    axisymmetric: bool = False

    def __repr__(self) -> str:
        n, closed = len(self.status), int(self.closed.sum())
        return f"ContactState({self.name!r}, {closed} of {n} closed, {self.normal_force:.4g} N)"

    def to_pyvista(self):
        """The contact's facets for pyvista: ``pressure``, ``gap`` and ``status`` at the pairs,
        ``facet_pressure`` over the facets, in SI units.

        Returns:
            A ``pyvista.PolyData``, the same on every rank.

        Raises:
            InputError: If pyvista is not installed: ``pip install 'fenics-joints[view]'``.
        """
        at_pairs = {"pressure": self.pressure, "gap": self.gap, "status": self.status}
        return facet_mesh(
            self.interface.points,
            self.interface.facets,
            at_pairs,
            {"facet_pressure": self.facet_pressure},
        )

    @property
    def pressure(self) -> np.ndarray:
        """Contact pressure at the pairs, Pa, (n,): the nodal force over the vertex's area."""
        return np.where(self.closed, self.force[:, 0], 0.0) / self.interface.areas

    @property
    def traction(self) -> np.ndarray:
        """Tangential traction at the pairs, Pa, (n, gdim - 1)."""
        return self.force[:, 1:] / self.interface.areas[:, None]

    @property
    def facet_pressure(self) -> np.ndarray:
        """Mean pressure of each facet, Pa, (n_facets,); times `facet_area` it sums to the force."""
        shares, facets = self.interface.shares, self.interface.facets
        return np.sum(shares * self.pressure[facets], axis=1) / self.facet_area

    @property
    def facet_area(self) -> np.ndarray:
        """Area of each facet, m2, (n_facets,)."""
        return self.interface.shares.sum(axis=1)

    @property
    def normal_force(self) -> float:
        """Force with which the bodies press on one another, N: what balances a load that presses.

        The resultant along the mean normal, which is the pressures'. On a curved face these point
        to all sides, and friction there bears a part of the load, so that `pressure_force` is more
        or less. A pin that is pressed all round has pressure without a force.
        """
        pressing = self._along_axis(self.force[:, 0] @ self.interface.frames[:, 0])
        size = np.linalg.norm(pressing)
        return float(self.resultant @ pressing / size) if size > 0 else 0.0

    @property
    def pressure_force(self) -> float:
        """Integral of the pressure, N, wherever it points; on a plane face the `normal_force`."""
        return float(self.force[:, 0].sum())

    @property
    def resultant(self) -> np.ndarray:
        """Force of the lower body on the upper one, N, (gdim,)."""
        return self._along_axis(np.einsum("nk,nki->i", self.force, self.interface.frames))

    def _along_axis(self, force: np.ndarray) -> np.ndarray:
        """A force without what balances round a circle."""
        return force * [0.0, 1.0] if self.axisymmetric else force

    @property
    def closed(self) -> np.ndarray:
        """Whether each pair is closed, (n,)."""
        return self.status != OPEN

    @property
    def area(self) -> float:
        """Area, m2, in which the pressure, linear between vertices, is more than zero."""
        return self.area_above(_PRESSES * float(self.pressure.max(initial=0.0)))

    def area_above(self, limit: float) -> float:
        """Area, m2, in which the pressure, linear between vertices, is at least ``limit``, Pa."""
        if not self.pressure.any():
            return 0.0
        return contour_area(self.interface, self.pressure, limit)[0]

    def radius(self, limit: float = 1e6, centre=None) -> float:
        """Contact radius max {r : P(r) >= limit}, m, within the elements (Machines 2022, eq. 10).

        Args:
            limit: Least pressure P_lim, Pa.
            centre: The bolt's axis on the interface, m, (gdim,); the origin by default.
        """
        return largest_radius(self.interface, self.pressure, limit, centre)

    def mean_pressure(self, limit: float = 1e6, centre=None) -> float:
        """Mean pressure inside the contact radius, Pa."""
        return mean_within(self.interface, self.pressure, self.radius(limit, centre), centre)


class PreloadResult:
    """A converged preload state.

    Attributes:
        model: The model.
        solver: The solver, with its matrices.
        forces: Forces of the bolts, N, and factors of the loads.
        x: Displacements and jumps, see `fenics_joints.preload.jumps`.
        load: The load f in x.
        iterations: Newton iterations.
        balance: Resultant of the loads that the inertia of the free structure took, relative.
        reactions: K x - f: contact forces at the jumps, what the supports hold elsewhere, N.
        contacts: State of every contact that can open, by name.
        complementarity: Largest violation of g >= 0, N >= 0, g N = 0, relative to the largest
            nodal force.
    """

    def __init__(
        self,
        solver: PreloadSolver,
        pairs: ContactPairs,
        forces: Mapping[str, float],
        x: PETSc.Vec,
        load: PETSc.Vec,
        iterations: int,
        balance: float,
    ):
        self.solver, self.model, self.pairs = solver, solver.model, pairs
        self.forces, self.x, self.load = dict(forces), x, load
        self.iterations, self.balance = iterations, balance
        self.reactions = self.solver.K * x
        self.reactions.axpy(-1.0, load)
        self.contacts = self._contacts()
        self.complementarity = self._complementarity()

    def __repr__(self) -> str:
        contacts = shorten(", ".join(self.contacts), 60)
        return f"PreloadResult({self.iterations} iterations, contacts {contacts})"

    def _repr_html_(self) -> str:
        rows = [
            (
                name,
                quantity(c.normal_force, "N"),
                quantity(float(c.pressure.max(initial=0)), "Pa"),
                f"{c.area * 1e6:.0f} mm²",
                f"{int(c.closed.sum())} of {len(c.status)}",
            )
            for name, c in self.contacts.items()
        ]
        head = ("contact", "force", "peak pressure", "closed area", "closed pairs")
        return html_table(f"Preload after {self.iterations} iterations", head, rows)

    def _contacts(self) -> dict[str, ContactState]:
        jumps, states = self.model.jumps, {}
        status = self.x.duplicate()
        status.set(0.0)
        at, r = self.x.array_r, self.reactions.array_r
        status.array[self.pairs.numbers[:, 0]] = self.pairs.status(at, r)
        for c in jumps.contacts:
            numbers = jumps.numbers(c)
            jump, kind = jumps.gather(self.x, numbers), jumps.gather(status, numbers[:, 0])
            states[c.name] = ContactState(
                c.name,
                c,
                jumps.gather(self.reactions, numbers),
                jump[:, 0] + c.gap,
                jump[:, 1:],
                kind.astype(int),
                self.model.axisymmetric,
            )
        status.destroy()
        return states

    def _complementarity(self) -> float:
        worst = self.pairs.complementarity(self.x.array_r, self.reactions.array_r)
        worst = self.model.comm.allreduce(float(worst.max(initial=0.0)), op=MPI.MAX)
        largest = max((np.abs(c.force).max(initial=0.0) for c in self.contacts.values()), default=0)
        return worst / largest if largest else worst

    def __getitem__(self, name: str) -> ContactState:
        if name not in self.contacts:
            names = ", ".join(self.contacts)
            raise InputError(f"there is no contact {name!r} that can open; expected: {names}.")
        return self.contacts[name]

    @cached_property
    def displacement(self) -> fem.Function:
        """Displacement of all bodies, m."""
        return self.model.jumps.displacement(self.x)

    def shortening(self, bolt: str) -> float:
        """Shortening, m, that a pretension section needs for its force."""
        names = [b.name for b in self.model.cuts]
        if bolt not in names:
            raise InputError(
                f"{bolt!r} has no pretension section; expected: {', '.join(names) or 'none'}."
            )
        number = self.model.jumps.shortening(names.index(bolt))
        return float(self.model.jumps.gather(self.x, np.array([number]))[0])

    def _shift(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Numbers in x of the displacement of what is moved, and their directions as rows."""
        names = [m.name for m in self.model.moved]
        if name not in names:
            raise InputError(
                f"{name!r} is no displacement or obstacle; expected: {', '.join(names) or 'none'}."
            )
        i = names.index(name)
        return self.model.jumps.shift(i), self.model.jumps.frame(i)

    def motion(self, name: str) -> np.ndarray:
        """Displacement of an obstacle or of a face that is moved, m, (gdim,); 0 where it is free.

        Raises:
            InputError: If nothing that is moved has this name.
        """
        numbers, frame = self._shift(name)
        return self.model.jumps.gather(self.x, numbers) @ frame

    def reaction(self, name: str) -> np.ndarray:
        """Force on the bodies by an obstacle or by what moves a face, N, (gdim,).

        On a half section the first component is summed along the radius, all round.

        Raises:
            InputError: If nothing that is moved has this name.
        """
        numbers, frame = self._shift(name)
        held = self.model.jumps.gather(self.reactions, numbers)
        # What pushes an obstacle is a load in x, not a reaction.
        pushed = self.model.jumps.gather(self.model.unit_load(name), numbers)
        return (held + self.forces.get(name, 0.0) * pushed) @ frame

    def counts(self) -> dict[str, dict[str, int]]:
        """Number of open, slipping and sticking pairs of each contact."""
        kinds = {"open": OPEN, "slip": SLIP, "stick": STICK}
        return {
            name: {word: int(np.sum(c.status == kind)) for word, kind in kinds.items()}
            for name, c in self.contacts.items()
        }
