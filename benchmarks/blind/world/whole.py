"""The two bodies of a rig as one structure with springs between them: what a test is made on."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from .rigs import Rig
from .solids import make_bodies
from .surfaces import locate, quadrature, rows

#: Pa/m of faces that are as one: a hundred times a plate's own E over thickness.
BONDED = 1e15
_INSIDE = -1e-6


@dataclass
class Build:
    """How a structure is built, apart from its joint; factors are relative to nominal.

    Attributes:
        E: Factor on the modulus of each body.
        rho: On the density.
        thickness: On the thickness, from the interface outwards.
        width: On the width.
        taper: Relative slope of the thickness along the structure, of each body.
        trough: Rise, m, of each body's middle line over its edges, fading out at the lap.
        notches: (body, x, half length, side of the middle line, factor): cells there have lost
            stiffness.
        heads: Factor on the mass of heads and nuts.
        masses: (x, y, body, kg) on the outer faces.
        grounds: (x, y, body, component, N/m): springs to the ground.
        tuned: (x, y, body, kg, Hz): a mass on a spring along z.
        clamp: Stiffness of the clamp, Pa/m.
    """

    E: list[float] = field(default_factory=lambda: [1.0, 1.0])
    rho: list[float] = field(default_factory=lambda: [1.0, 1.0])
    thickness: list[float] = field(default_factory=lambda: [1.0, 1.0])
    width: list[float] = field(default_factory=lambda: [1.0, 1.0])
    taper: list[float] = field(default_factory=lambda: [0.0, 0.0])
    trough: list[float] = field(default_factory=lambda: [0.0, 0.0])
    notches: list[tuple] = field(default_factory=list)
    heads: float = 1.0
    masses: list[tuple] = field(default_factory=list)
    grounds: list[tuple] = field(default_factory=list)
    tuned: list[tuple] = field(default_factory=list)
    clamp: float = BONDED


@dataclass(frozen=True)
class Interface:
    """Points of the interface with what a displacement makes there.

    Attributes:
        points: As built, (n, 2), m.
        weights: m2, (n,).
        opening: Rows for u_x, u_y, u_z of body 1 less body 0, each (n, n_dofs).
    """

    points: np.ndarray
    weights: np.ndarray
    opening: list[sparse.csr_matrix]

    def stiffness(self, k_n: np.ndarray, k_t: np.ndarray) -> sparse.csr_matrix:
        """Of springs distributed over the interface, Pa/m normal and tangential, (n,) each."""
        total = None
        for row, k in zip(self.opening, (k_t, k_t, k_n), strict=True):
            part = row.T @ sparse.diags(self.weights * k) @ row
            total = part if total is None else total + part
        return total


class Whole:
    """Meshes of a rig, and the matrices of any `Build` on them.

    Attributes:
        rig: The rig.
        bodies: Its two bodies.
        n_dofs: Unknowns of both together, body 0's first.
        points: Points of the interface as built, (n, 2), m.
    """

    def __init__(self, rig: Rig, size: float | None = None):
        self.rig = rig
        self.bodies = make_bodies(rig, size)
        self.starts = (0, self.bodies[0].n_dofs)
        self.n_dofs = sum(body.n_dofs for body in self.bodies)
        self._rule()

    def _rule(self) -> None:
        lower, upper = (body.face(0.0) for body in self.bodies)
        points, weights = quadrature(lower[0])
        _, _, inside = locate(upper[0], points)
        there = inside > _INSIDE
        for bolt in self.rig.bolts:
            away = np.hypot(points[:, 0] - bolt.x, points[:, 1] - bolt.y)
            there &= away > self.rig.hole / 2
        self.points, self._weights = points[there], weights[there]

    def shape(self, build: Build) -> None:
        """Give the meshes the shape of a build."""
        rig = self.rig
        laps = self._laps()
        for number, body in enumerate(self.bodies):
            t, w, taper = build.thickness[number], build.width[number], build.taper[number]
            rise = build.trough[number]

            def move(x, t=t, w=w, taper=taper, rise=rise):
                x, y, z = x.T
                z0 = np.clip(z, -rig.outer, rig.outer)
                scale = t * (1 + taper * (2 * x / rig.length - 1))
                half = np.abs(y - rig.middle).max()
                away = np.min([np.maximum(a - x, x - b) for a, b in laps], axis=0)
                fade = np.clip(away / 0.03, 0, 1)
                arch = rise * fade**2 * (3 - 2 * fade) * (1 - ((y - rig.middle) / half) ** 2)
                at = x, rig.middle + (y - rig.middle) * w, z0 * scale + (z - z0) + arch
                return np.stack(at, axis=1)

            body.deform(move)

    def _laps(self) -> list[tuple[float, float]]:
        """Where along x the bodies meet."""
        x = np.sort(self.points[:, 0])
        cuts = np.flatnonzero(np.diff(x) > 0.05)
        return [(part[0], part[-1]) for part in np.split(x, cuts + 1)]

    def interface(self, build: Build) -> Interface:
        """The interface in the present shape; points stay in the narrower body."""
        narrow = min(build.width)
        points = self.points.copy()
        points[:, 1] = self.rig.middle + (points[:, 1] - self.rig.middle) * narrow
        lower, upper = (
            rows(body.face(0.0), points, body.n_dofs // 3, start, self.n_dofs)
            for body, start in zip(self.bodies, self.starts, strict=True)
        )
        opening = [b - a for a, b in zip(lower, upper, strict=True)]
        return Interface(self.points, self._weights * narrow, opening)

    def at(self, places) -> list[sparse.csr_matrix]:
        """u_x, u_y, u_z at places (x, y, body) on the outer faces, each (n, n_dofs)."""
        found = [[], [], []]
        for x, y, number in places:
            body, side = self.bodies[int(number)], (-1, 1)[int(number)]
            face = body.face(side * self.rig.outer)
            start = self.starts[int(number)]
            made = rows(face, np.array([[x, y]]), body.n_dofs // 3, start, self.n_dofs)
            for component, row in zip(found, made, strict=True):
                component.append(row)
        return [sparse.csr_matrix(sparse.vstack(f)) for f in found]

    def matrices(self, build: Build) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
        """Stiffness and mass without the joint; tuned masses have an unknown each at the end."""
        rig = self.rig
        blocks = []
        for number, body in enumerate(self.bodies):
            E = np.full(len(body.centres), rig.E * build.E[number])
            for where, x, half, side, factor in build.notches:
                if where == number:
                    near = np.abs(body.centres[:, 0] - x) < half
                    E[near & (side * (body.centres[:, 1] - rig.middle) > 0)] *= factor
            heads = rig.head_mass * len(rig.bolts) * build.heads
            blocks.append(body.matrices(E, rig.rho * build.rho[number], heads))
        k = sparse.block_diag([b[0] for b in blocks], "csr")
        m = sparse.block_diag([b[1] for b in blocks], "csr")
        for x, y, body, mass in build.masses:
            for row in self.at([(x, y, body)]):
                m = m + mass * (row.T @ row)
        for x, y, body, component, stiffness in build.grounds:
            row = self.at([(x, y, body)])[component]
            k = k + stiffness * (row.T @ row)
        if rig.clamped:
            k = k + self._clamp(build.clamp)
        for place in build.tuned:
            k, m = self._tuned(k, m, place)
        return k, m

    def _clamp(self, stiffness: float):
        body = self.bodies[0]
        face = body.end(0.0)
        points, weights = quadrature(face[0])
        made = rows(face, points, body.n_dofs // 3, 0, self.n_dofs)
        return sum(row.T @ sparse.diags(weights * stiffness) @ row for row in made)

    def _tuned(self, k, m, place):
        x, y, body, mass, hz = place
        spring = mass * (2 * np.pi * hz) ** 2
        row = sparse.hstack(
            [-self.at([(x, y, body)])[2], sparse.csr_matrix((1, k.shape[0] - self.n_dofs)), [[1.0]]]
        ).tocsr()
        k = sparse.block_diag([k, [[0.0]]], "csr") + spring * (row.T @ row)
        return k, sparse.block_diag([m, [[mass]]], "csr")

    def widen(self, interface: Interface, n_dofs: int) -> Interface:
        """The interface's rows for that many unknowns."""
        more = n_dofs - self.n_dofs
        if not more:
            return interface
        opening = [
            sparse.hstack([row, sparse.csr_matrix((row.shape[0], more))]).tocsr()
            for row in interface.opening
        ]
        return Interface(interface.points, interface.weights, opening)
