"""State of a contact after a preload: pressures, gaps, slips and status."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_joints.preload.conditions import OPEN
from fenics_joints.preload.patch import contour_area, largest_radius, mean_within
from fenics_joints.structure.faces import Interface
from fenics_joints.structure.grids import facet_mesh

#: Share of the largest pressure above which a contact presses: less is round-off.
PRESSES = 1e-9


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
        return self.area_above(PRESSES * float(self.pressure.max(initial=0.0)))

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
