"""Solved states of the second world, each kept in a file once CalculiX has found it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import cached_property

import numpy as np

from .build import Build
from .deck import nearest, write_deck
from .effects import HARNESS, apply
from .meshing import CACHE, mesh_of
from .program import run_modes
from .rigs import RIGS
from .ritz import with_attached
from .specimen import RIGID, TOLERANCE, drawn_hz, follow, pool_of

#: Elastic modes that are solved for: of the drawing, in whose span what is attached is put, and of
#: other states, the measured ones and some more to follow them by.
_SPAN, _SOLVED = 30, 15


class States:
    """States of a rig at the highest torque, their modes in the order of the drawing's.

    Args:
        geometry: Name of the rig.
        say: Told what is solved.
    """

    def __init__(self, geometry: str, say: Callable[[str], None] = print):
        self.geometry, self.rig, self.say = geometry, RIGS[geometry], say
        self.pool = pool_of(geometry)

    @cached_property
    def base(self) -> tuple[np.ndarray, np.ndarray]:
        """As drawn: frequencies, Hz, (m,), and shapes (m, n, 3), rigid motions left out."""
        hz, u = self._all
        return hz[RIGID : RIGID + _SOLVED], u[RIGID : RIGID + _SOLVED]

    @cached_property
    def _all(self) -> tuple[np.ndarray, np.ndarray]:
        return self._kept(Build(), n_modes=_SPAN)

    @cached_property
    def nuisances(self) -> dict[tuple[str, int], tuple[np.ndarray, np.ndarray]]:
        """Change of ln f and shapes per standard deviation of each tolerance, by what and of which
        body."""
        plates = any(body.normal is not None for body in self.rig.bodies)
        keys = ("E", "rho", "thickness") if plates else ("E", "rho")
        found = {}
        of_bodies = [(key, i) for key in keys for i in range(len(self.rig.bodies))]
        for key, i in (*of_bodies, ("heads", 0)):
            factor = float(np.exp(TOLERANCE[key]))

            def change(build, key=key, i=i, factor=factor):
                if key == "heads":
                    build.heads = factor
                else:
                    getattr(build, key)[i] = factor

            log_f, u = self.of([], change)
            found[key, i] = log_f - np.log(self.base[0]), u - self.base[1]
        return found

    def of(
        self,
        effects: Sequence[Mapping],
        change: Callable[[Build], None] | None = None,
        tightening: float = 1.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """ln f and shapes of a state by effects of the world, or by a change of the drawing."""
        build = Build()
        tuned = drawn_hz(self.geometry) if any(e["name"] == "resonator" for e in effects) else ()
        for effect in effects:
            apply(self.rig, deepcopy(dict(effect)), build, tuned)
        if change is not None:
            change(build)
        hz, u = self._kept(build, tightening)
        return self._aligned(hz[RIGID:], u[RIGID:])

    def attached(self, **things) -> tuple[np.ndarray, np.ndarray]:
        """ln f and shapes with things attached at places of the pool, from the drawing's modes."""
        hz, u = with_attached(*self._all, **things)
        return self._aligned(hz[RIGID:], u[RIGID:])

    def harness(self) -> int:
        """The node among those observed that is nearest to the harness."""
        mesh = mesh_of(self.geometry)
        place = mesh.x[nearest(mesh, HARNESS[self.geometry])]
        away = np.linalg.norm(mesh.x[self.pool.observed.nodes] - place, axis=1)
        return int(np.argmin(away))

    def _aligned(self, hz, u) -> tuple[np.ndarray, np.ndarray]:
        like = self.base[1][: min(len(hz), _SOLVED)]
        order = follow(like, u)
        u = u[order]
        sign = np.sign(np.sum(like * u, axis=(1, 2)))
        return np.log(hz[order]), u * sign[:, None, None]

    def _kept(self, build: Build, tightening: float = 1.0, n_modes: int = _SOLVED):
        mesh, observed = mesh_of(self.geometry), self.pool.observed
        deck = write_deck(self.rig, mesh, build, observed, RIGID + n_modes, tightening)
        key = hashlib.sha256(deck.encode()).hexdigest()[:24]
        path = CACHE / "states" / f"{self.geometry}_{key}.npz"
        if path.exists():
            with np.load(path) as kept:
                return kept["hz"], kept["u"]
        self.say(f"CalculiX: a state of {self.geometry}")
        hz, u = run_modes(deck, len(observed.nodes))
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, hz=hz, u=u.astype(np.float32))
        part.replace(path)
        return hz, u
