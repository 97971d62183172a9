"""A specimen and its test, and what the test would show without noise."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from .build import Build
from .deck import Observed, write_deck
from .effects import apply
from .meshing import Mesh, mesh_of
from .program import run_modes
from .rigs import RIGS, Rig

#: Standard deviations of ln, of each body.
TOLERANCE = {"E": 0.015, "rho": 0.01, "thickness": 0.007, "heads": 0.05}
_POOL, _SPREAD = 90, 70
RIGID = 6
#: Modes beyond those that are measured, among which they are looked for.
_MORE = 5
#: Modes that functions are summed over, and their lines.
_SUMMED, _LINES = 70, 300


@dataclass
class Spec:
    """What the answer follows from, all but the noise; plain data.

    Attributes:
        geometry: Name of the rig.
        torques: N m, of the rows.
        n_modes: Modes of the test.
        sensors: Places in the pool (`pool_of`), from 0.
        shapes: Whether shapes are measured, at the last row.
        effects: ``{"name", "region", "params"}`` each.
        nuisance: Factors within tolerance: E, rho, thickness by body, heads.
        scatter: True over nominal tightening of each row.
        careful: Whether the nominal model is meshed as a careful user does, and states less error.
        forces: Places in the pool where functions were measured, with all sensors; none without.
        damping: Of each mode, for the functions.
    """

    geometry: str
    torques: list[float]
    n_modes: int
    sensors: list[int]
    shapes: bool = True
    effects: list[dict[str, Any]] = field(default_factory=list)
    nuisance: dict[str, Any] = field(default_factory=dict)
    scatter: list[float] = field(default_factory=list)
    careful: bool = False
    forces: list[int] = field(default_factory=list)
    damping: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Answer:
    """Clean data.

    Attributes:
        frequencies: Hz, (n, m).
        shapes: At the sensors, of unit root mean square, (n_s, m); none where not measured.
        lines: Hz, of the functions, (l,).
        functions: m/N, of all sensors and forces at the last row, (l, n_s, n_f); none where not
            measured.
    """

    frequencies: np.ndarray
    shapes: np.ndarray
    lines: np.ndarray
    functions: np.ndarray


# -- nodes that are looked at ----------------------------------------------------------------------


@dataclass(frozen=True)
class Pool:
    """Where sensors may be, and nodes all over by which modes are followed.

    Attributes:
        observed: All their nodes, rising.
        sensors: Rows in it of the sensors' places, (_POOL,).
        normals: Outward normals there, (_POOL, 3).
    """

    observed: Observed
    sensors: np.ndarray
    normals: np.ndarray


@cache
def pool_of(name: str) -> Pool:
    """The nodes of a rig; the same on every call."""
    mesh, random = mesh_of(name), np.random.default_rng(17)
    normals = _normals(mesh)
    flat = np.flatnonzero(np.linalg.norm(normals, axis=1) > 0.99)
    flat = flat[_of_tube(name, mesh.x[flat])]
    chosen = [int(random.choice(flat))]
    away = np.full(len(flat), np.inf)
    while len(chosen) < _POOL:  # the farthest from all before it
        away = np.minimum(away, np.linalg.norm(mesh.x[flat] - mesh.x[chosen[-1]], axis=1))
        chosen.append(int(flat[np.argmax(away)]))
    rest = np.setdiff1d(np.arange(len(mesh.x)), chosen)
    nodes = np.sort(np.concatenate([chosen, random.choice(rest, _SPREAD, replace=False)]))
    return Pool(Observed(nodes), np.searchsorted(nodes, chosen), normals[chosen])


def _of_tube(name: str, x) -> np.ndarray:
    """On the pipes, sensors are on the tube's outside, else anywhere on the outside."""
    if name == "flanged_pipe":
        return np.abs(np.hypot(x[:, 0], x[:, 1]) - 0.040) < 2e-4
    if name == "t_tubes":  # not inside the tubes
        chord = (np.abs(x[:, 1]) > 0.0295) | (x[:, 2] > -1e-6) | (x[:, 2] < -0.0595)
        stem = (np.abs(x[:, 0]) > 0.0245) | (np.abs(x[:, 1]) > 0.0195)
        return np.where(x[:, 2] > 0.0101, stem, chord)
    return np.ones(len(x), dtype=bool)


def _normals(mesh: Mesh) -> np.ndarray:
    """Mean of the faces' outward normals at each node, (n, 3); short at edges."""
    total, count = np.zeros_like(mesh.x), np.zeros(len(mesh.x))
    for cells, faces in zip(mesh.cells, mesh.faces, strict=True):
        inside = _inside(mesh, cells, faces)
        a, b, c = (mesh.x[faces[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        normal *= np.sign(np.sum((a - inside) * normal, axis=1))[:, None]
        for i in range(6):
            np.add.at(total, faces[:, i], normal)
            np.add.at(count, faces[:, i], 1.0)
    return total / np.maximum(count, 1)[:, None]


def _inside(mesh: Mesh, cells, faces) -> np.ndarray:
    """Centre of the cell behind each face, (k, 3)."""
    cell_of = {}
    for row, cell in enumerate(cells[:, :4]):
        for left in range(4):
            cell_of[tuple(sorted(np.delete(cell, left).tolist()))] = row
    rows = [cell_of[tuple(sorted(face[:3].tolist()))] for face in faces]
    return mesh.x[cells[rows][:, :4]].mean(axis=1)


# -- modes -----------------------------------------------------------------------------------------


def solve(rig: Rig, build: Build, n_modes: int, tightening: float = 1.0):
    """Elastic frequencies, Hz, (m,), and displacements at the pool's nodes, (m, n, 3)."""
    mesh, observed = mesh_of(rig.name), pool_of(rig.name).observed
    deck = write_deck(rig, mesh, build, observed, RIGID + n_modes, tightening)
    hz, u = run_modes(deck, len(observed.nodes))
    return hz[RIGID:], u[RIGID:]


@cache
def drawn_hz(name: str) -> tuple[float, ...]:
    """Lowest elastic frequencies as drawn, Hz; what is tuned is tuned to them."""
    return tuple(solve(RIGS[name], Build(), 8)[0])


def build_of(spec: Spec) -> Build:
    """The specimen as built, at the highest torque."""
    build, own = Build(), spec.nuisance
    for key in ("E", "rho", "thickness"):
        for i, factor in enumerate(own.get(key, [])):
            getattr(build, key)[i] = factor
    build.heads = own.get("heads", 1.0)
    for effect in spec.effects:
        tuned = drawn_hz(spec.geometry) if effect["name"] == "resonator" else ()
        apply(RIGS[spec.geometry], effect, build, tuned)
    return build


def follow(like: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Which of the modes (m2, n, 3) is most like each of (m, n, 3), each taken once; (m,)."""
    from scipy.optimize import linear_sum_assignment

    a, b = (v.reshape(len(v), -1) for v in (like, u))
    a, b = (v / np.linalg.norm(v, axis=1)[:, None] for v in (a, b))
    return linear_sum_assignment(-((a @ b.T) ** 2))[1]


def clean(spec: Spec | dict[str, Any]) -> Answer:
    """What the test shows without noise."""
    spec = spec if isinstance(spec, Spec) else Spec(**spec)
    rig = RIGS[spec.geometry]
    whole, top = build_of(spec), max(rig.torques)
    rows, before = [], None
    scatter = spec.scatter or [1.0] * len(spec.torques)
    for i in range(len(spec.torques) - 1, -1, -1):
        build = deepcopy(whole)
        _drift(spec, build, i)
        hz, u = solve(rig, build, spec.n_modes + _MORE, scatter[i] * spec.torques[i] / top)
        if before is None:
            order = seen(spec, u)
            first = u[order]
        else:
            order = follow(before, u)
        before = u[order]
        rows.append(hz[order])
    shapes = _at_sensors(spec, first)
    hz = np.array(rows[::-1])
    lines, functions = np.zeros(0), np.zeros((0, 0, 0))
    if spec.forces:
        build = deepcopy(whole)
        _drift(spec, build, len(spec.torques) - 1)
        lines = np.linspace(0.3 * hz[-1].min(), 1.02 * hz[-1].max(), _LINES)
        functions = receptances(spec, build, lines, scatter[-1] * spec.torques[-1] / top)
    return Answer(_swapped(spec, hz), shapes, lines, functions)


def receptances(spec: Spec, build: Build, lines: np.ndarray, tightening: float) -> np.ndarray:
    """Receptances from modes, rigid ones too, m/N, (l, n_s, n_f)."""
    rig = RIGS[spec.geometry]
    pool = pool_of(spec.geometry)
    deck = write_deck(rig, mesh_of(rig.name), build, pool.observed, _SUMMED, tightening)
    hz, u = run_modes(deck, len(pool.observed.nodes))
    own = np.where(np.arange(len(hz)) < RIGID, 0.0, 2 * np.pi * hz)
    zeta = np.resize(spec.damping, len(hz))
    w = 2 * np.pi * lines[:, None]
    modal = 1 / (own**2 - w**2 + 2j * zeta * own * w)
    forces = np.einsum("msk,sk->sm", u[:, pool.sensors[spec.forces]], pool.normals[spec.forces])
    moved, gains = _faults(spec)
    read = _read(spec, u, moved) * gains[:, None]
    return np.einsum("lm,sm,fm->lsf", modal, read, forces)


def _drift(spec: Spec, build: Build, row: int) -> None:
    for effect in spec.effects:
        if effect["name"] == "temperature" and len(spec.torques) > 1:
            place = row / (len(spec.torques) - 1)
            for i in build.E:
                build.E[i] *= 1 + effect["params"]["drift"] * place


def seen(spec: Spec, u: np.ndarray) -> np.ndarray:
    """The lowest modes that the sensors see: a sixth of what moves all over, at least."""
    if not spec.shapes:
        return np.arange(spec.n_modes)
    read = np.sqrt(np.mean(_read(spec, u) ** 2, axis=0))
    there = np.flatnonzero(read > np.sqrt(np.mean(u**2, axis=(1, 2))) / 2)
    return np.sort(there[: spec.n_modes])


def _read(spec: Spec, u: np.ndarray, moved: dict[int, int] | None = None) -> np.ndarray:
    """Along the sensors' directions, (n_s, m); some read at another place of the pool."""
    pool = pool_of(spec.geometry)
    at = [(moved or {}).get(s, s) for s in spec.sensors]
    return np.einsum("msk,sk->sm", u[:, pool.sensors[at]], pool.normals[spec.sensors])


def _faults(spec: Spec) -> tuple[dict[int, int], np.ndarray]:
    """Places of the pool that sensors read in place of their own, and factors on all, (n_s,)."""
    moved, gains = {}, np.ones(len(spec.sensors))
    for effect in spec.effects:
        if effect["name"] == "sensor_place":
            moved[effect["params"]["sensor"]] = effect["params"]["reads"]
        elif effect["name"] == "sensor_gain":
            gains[spec.sensors.index(effect["params"]["sensor"])] = effect["params"]["factor"]
    return moved, gains


def _at_sensors(spec: Spec, u: np.ndarray) -> np.ndarray:
    if not spec.shapes:
        return np.zeros((0, len(u)))
    moved, gains = _faults(spec)
    shapes = _read(spec, u, moved) * gains[:, None]
    return shapes / np.sqrt(np.mean(shapes**2, axis=0))


def _swapped(spec: Spec, hz: np.ndarray) -> np.ndarray:
    """Frequencies of two neighbours in each other's columns, shapes where they were."""
    for effect in spec.effects:
        if effect["name"] == "mis_pairing":
            j = int(effect["params"]["share"] * (hz.shape[1] - 1))
            hz[:, [j, j + 1]] = hz[:, [j + 1, j]]
    return hz
