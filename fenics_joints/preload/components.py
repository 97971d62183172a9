"""What presses parts together: contacts between their faces, bolts and loads.

Plain data; `fenics_joints.preload.model` turns it into equations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fenics_joints.errors import InputError, direction, flag, real, reals, text, wanted, whole

__all__ = ["BeamBolt", "Contact", "PretensionSection", "Traction", "WasherForce"]

Gap = float | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Contact:
    """Two matching faces of different bodies that may touch.

    Attributes:
        name: Unique name.
        lower: Facet group of one body; the normal points out of it.
        upper: Facet group of the other body, vertex to vertex with the first.
        friction: Coulomb's coefficient; 0 for none, infinity for faces that never slide while
            they touch.
        gap: Initial gap, m, beyond that of the mesh: a number or a function of positions, shape
            (n, gdim), that returns shape (n,). Negative for an interference fit.
        bonded: Whether the faces are glued: neither sliding nor opening.
        tolerance: Farthest distance, m, between two vertices that are one pair; by default a
            thousandth of the shortest edge. A larger one pairs faces across a meshed gap.
    """

    name: str
    lower: str
    upper: str
    friction: float = 0.0
    gap: Gap = 0.0
    bonded: bool = False
    tolerance: float | None = None

    def __post_init__(self):
        _check_faces(self, "contact")
        flag(f"{self.name}.bonded", self.bonded)
        if not isinstance(self.friction, float) or self.friction != np.inf:
            real(f"{self.name}.friction", self.friction, least=0)
        if not callable(self.gap):
            real(f"{self.name}.gap", self.gap, "m")
        if self.tolerance is not None:
            real(f"{self.name}.tolerance", self.tolerance, "m", above=0)


@dataclass(frozen=True)
class _Bolt:
    """What all bolts have: a name, two faces and the force between them."""

    name: str
    lower: str
    upper: str
    force: float

    def __post_init__(self):
        _check_faces(self, "bolt")
        real(f"{self.name}.force", self.force, "N", least=0)
        axis = getattr(self, "axis", None)
        if axis is not None:
            direction(f"{self.name}.axis", axis)


def _check_faces(pair: Contact | _Bolt, what: str) -> None:
    text(f"{what}.name", pair.name)
    text(f"{pair.name}.lower", pair.lower)
    text(f"{pair.name}.upper", pair.upper)
    if pair.lower == pair.upper:
        raise InputError(
            f"{pair.name}: lower and upper are both {pair.lower!r}; expected two faces."
        )


@dataclass(frozen=True)
class WasherForce(_Bolt):
    """A bolt as two opposed forces, spread evenly over the faces under its washers.

    Attributes:
        name: Unique name; also that of its force, N.
        lower: Facet group pressed along ``axis``.
        upper: Facet group pressed against ``axis``.
        force: Bolt force, N.
        axis: Direction of the bolt's axis, from ``lower`` to ``upper``, shape (gdim,); by default
            the last direction of space.
    """

    axis: tuple[float, ...] | None = None


@dataclass(frozen=True)
class PretensionSection(_Bolt):
    """A solid bolt, cut through its shank: the force is given and the shortening solved for.

    The two faces of the cut stay flat and parallel and move apart by the shortening along the
    axis (the overlap of the shortened halves).

    Attributes:
        name: Unique name; also that of its force, N.
        lower: Facet group on the lower half's side of the cut.
        upper: Facet group on the upper half's side, vertex to vertex with ``lower``.
        force: Bolt force, N.
        axis: Direction of the bolt's axis, shape (gdim,); by default the last direction of space.
    """

    axis: tuple[float, ...] | None = None


@dataclass(frozen=True)
class BeamBolt(_Bolt):
    """A bolt as a beam between rigid spiders under its washers (Fronk et al. 2019, section 3.2).

    In the preload the force is given, so the beam resists bending, shear and twist alone; about
    that state it is a whole beam with its mass.

    Attributes:
        name: Unique name; also that of its force, N.
        lower: Facet group that the lower spider holds.
        upper: Facet group that the upper spider holds.
        force: Bolt force, N.
        diameter: Diameter of the shank, m.
        E: Young's modulus, Pa.
        nu: Poisson's ratio.
        rho: Density, kg/m3.
        head_mass: Mass, kg, of what sits on each end (head or nut, washer), at the spider's centre.
        n_elements: Elements along the beam.
    """

    diameter: float
    E: float = 210e9
    nu: float = 0.3
    rho: float = 7850.0
    head_mass: float = 0.0
    n_elements: int = 25

    def __post_init__(self):
        super().__post_init__()
        name = self.name
        real(f"{name}.diameter", self.diameter, "m", above=0)
        real(f"{name}.E", self.E, "Pa", above=0)
        if not -1 < real(f"{name}.nu", self.nu) < 0.5:
            raise wanted(f"{name}.nu", self.nu, "-1 < nu < 0.5")
        real(f"{name}.rho", self.rho, "kg/m3", least=0)
        real(f"{name}.head_mass", self.head_mass, "kg", least=0)
        whole(f"{name}.n_elements", self.n_elements)


@dataclass(frozen=True)
class Traction:
    """A load spread evenly over a face.

    Attributes:
        name: Unique name.
        facets: Facet group.
        force: Total force, N (in plane strain N per metre of depth), shape (gdim,).
        profile: Optional function of positions, shape (n, gdim) to (n,), that the load follows
            instead of being even; its integral is scaled to the force.
    """

    name: str
    facets: str
    force: tuple[float, ...]
    profile: Callable[[np.ndarray], np.ndarray] | None = None

    def __post_init__(self):
        text("load.name", self.name)
        text(f"{self.name}.facets", self.facets)
        if len(reals(f"{self.name}.force", self.force, (None,), "N")) not in (2, 3):
            raise wanted(f"{self.name}.force", self.force, "2 or 3 components, N")
        if self.profile is not None and not callable(self.profile):
            raise wanted(f"{self.name}.profile", self.profile, "a function of positions")
