"""What a test on a specimen would show without noise: frequencies, damping and shapes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import linear_sum_assignment

from .effects import Sensing, apply
from .eigen import lowest_modes
from .joint import Joint, bolt_force, series
from .kept import keep, kept
from .levels import gapping, slip
from .pressure import pressures
from .rigs import RIGS
from .specimen import Spec
from .whole import BONDED, Build, Whole

#: Shift of the eigensolver, Hz: about the first frequency.
_SHIFT = {"lap_plates": 100.0, "c_beam": 60.0, "lap_beam": 10.0}
#: Stiffness at rest of a joint that slips or opens but is as one otherwise, Pa/m.
_AT_REST = {"lap_plates": 5e13, "c_beam": 2e14, "lap_beam": 2e14}
#: Share of the largest pressure that holds everywhere: form errors and adhesion; without it the
#: faces between the bolts would be open before any test.
_EVERYWHERE = 0.1
#: Steps at most to a frequency that moves no more, and to an amplitude within 1 % of the force's.
_STEPS, _SETTLED, _LOOSE = 200, 1e-6, 1e-2
#: Relative swing of a frequency that is put up with after all steps.
_SWINGS = 1e-5
#: Joints whose modes are in the basis, beside that at rest.
_SOFTER = (0.1, 0.01)
#: Forces of a level test, N, least and most that are tried, and from one to the next.
_LEAST, _MOST, _UP = 0.01, 1e6, 1.5
#: The shaker's force grows with this power of the mode's frequency.
_DRIVEN = 1.0


@dataclass(frozen=True)
class Answer:
    """Frequencies, Hz, (n, m), damping ratios (n, m), and shapes at the sensors (n_s, m)."""

    frequencies: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray


@dataclass(frozen=True)
class _State:
    """Modes that the test sees: Hz, mass-normalised shapes (n_dofs, m), joint's share of energy."""

    hz: np.ndarray
    shapes: np.ndarray
    share: np.ndarray


@cache
def _whole(geometry: str) -> Whole:
    return Whole(RIGS[geometry])


@cache
def _pressure(geometry: str) -> np.ndarray:
    return pressures(_whole(geometry))


class _Specimen:
    """The structure of a spec with its joint, ready to be tested."""

    def __init__(self, spec: Spec):
        self.spec, self.rig = spec, RIGS[spec.geometry]
        self.whole, self.pressure = _whole(spec.geometry), _pressure(spec.geometry)
        self.build, self.joint, self.sensing = self._nuisances(), Joint(), Sensing()
        peak = self.pressure.sum(axis=0).max() * bolt_force(self.rig, max(self.rig.torques))
        tuned = any(e["name"] == "cable" for e in spec.effects)
        hz = nominal_hz(spec.geometry) if tuned else None
        for effect in spec.effects:
            apply(self.rig, effect, self.build, self.joint, self.sensing, hz, peak)
        self.whole.shape(self.build)
        self.k, self.m = self.whole.matrices(self.build)
        self.interface = self.whole.widen(self.whole.interface(self.build), self.k.shape[0])

    def _nuisances(self) -> Build:
        rig, own = self.rig, self.spec.nuisance
        build = Build()
        for key in ("E", "rho", "thickness"):
            setattr(build, key, list(own.get(key, (1.0, 1.0))))
        build.heads = own.get("heads", 1.0)
        (x, y, body), kg = rig.accelerometer
        x, kg = x + own.get("place", 0.0), kg * own.get("accelerometer", 1.0)
        build.masses.append((x, y, body, kg))
        return build

    def springs(self, torque: float):
        return self.joint.stiffness(self.rig, self.whole.points, self.pressure, torque)

    def modes(self, k_n, k_t, E: float = 1.0):
        """All lowest modes with a joint, and the joint's matrix."""
        joint = self.interface.stiffness(k_n, k_t)
        n = self.rig.search + len(self.build.tuned)
        hz, shapes = lowest_modes(E * self.k + joint, self.m, n, _SHIFT[self.rig.name])
        return hz, shapes, joint

    def seen(self, hz, shapes, joint, like: np.ndarray, weight) -> _State:
        """The modes most like those of a known state, in its order."""
        first = 0 if self.rig.clamped else 6
        n = self.whole.n_dofs
        match = np.abs(like.T @ (weight @ shapes[:n, first:])) ** 2
        _, columns = linear_sum_assignment(-match)
        pick = first + columns
        omega = 2 * np.pi * hz[pick]
        share = np.einsum("ij,ij->j", shapes[:, pick], joint @ shapes[:, pick]) / omega**2
        return _State(hz[pick], shapes[:, pick], share)


@cache
def _nominal(geometry: str):
    """The modes that the sensors see of the structure as drawn, and its mass matrix."""
    specimen = _Specimen(Spec(geometry))
    rig, n = specimen.rig, len(specimen.whole.points)
    file = kept("modes", specimen.whole, specimen.m.data.round(15).tobytes())
    if file.is_file():
        with np.load(file) as data:
            return _State(data["hz"], data["shapes"], np.zeros(len(data["hz"]))), specimen.m
    hz, shapes, joint = specimen.modes(np.full(n, BONDED), np.full(n, BONDED))
    seen = specimen.whole.at(rig.sensors)[2] @ shapes
    total = specimen.m.sum() / 3
    visible = np.sqrt(np.mean(seen**2, axis=0) * total) > 0.5
    visible[: 0 if rig.clamped else 6] = False
    pick = np.flatnonzero(visible)[: rig.n_modes]
    if len(pick) < rig.n_modes:
        raise RuntimeError(f"{geometry}: {len(pick)} of {rig.n_modes} modes are seen")
    keep(file, hz=hz[pick], shapes=shapes[:, pick])
    return _State(hz[pick], shapes[:, pick], np.zeros(len(pick))), specimen.m


def nominal_hz(geometry: str) -> np.ndarray:
    """Frequencies of the structure as drawn, Hz, (m,)."""
    return _nominal(geometry)[0].hz


def answer(spec: Spec) -> Answer:
    """What the test on a specimen shows, without noise."""
    nominal, weight = _nominal(spec.geometry)
    specimen = _Specimen(spec)
    if spec.test == "level" and (specimen.sensing.opens or specimen.sensing.slip is not None):
        hz, damping, state = _by_level(specimen, nominal, weight)
    else:
        hz, damping, state = _by_torque(specimen, nominal, weight)
    return _as_seen(specimen, hz, damping, state)


def _by_torque(specimen: _Specimen, nominal, weight):
    spec, rig, sensing = specimen.spec, specimen.rig, specimen.sensing
    torques = np.array(rig.torques) * np.array(spec.scatter or np.ones(len(rig.torques)))
    if spec.test == "level":
        torques = np.full(len(spec.levels), torques[-1])
    warm = sensing.E[0] * sensing.E[1] ** np.linspace(0, 1, len(torques))
    states, before, like = {}, np.empty(0), nominal.shapes
    for row in reversed(range(len(torques))):
        key = np.concatenate([[warm[row]], *specimen.springs(torques[row])])
        if np.array_equal(key, before):
            states[row] = states[row + 1]
            continue
        modes = specimen.modes(*np.split(key[1:], 2), key[0])
        states[row] = specimen.seen(*modes, like, weight)
        like, before = states[row].shapes[: specimen.whole.n_dofs], key
    hz = np.array([states[r].hz for r in range(len(torques))])
    share = np.array([states[r].share for r in range(len(torques))])
    damping = np.array(spec.damping) + share / 2 * _loss(sensing, hz)
    return hz, damping, states[range(len(torques))[spec.shapes_row]]


def _loss(sensing: Sensing, hz: np.ndarray) -> np.ndarray:
    return sensing.eta + sensing.eta_viscous * hz / 1000.0


# -- levels ----------------------------------------------------------------------------------------


class UnsettledError(RuntimeError):
    """Slip and amplitude swing for ever, as where two amplitudes are possible."""


class _Small:
    """A specimen in a basis of its modes with the joint at rest and with softer ones."""

    def __init__(self, specimen: _Specimen, nominal, weight):
        self.specimen, rig, sensing = specimen, specimen.rig, specimen.sensing
        torque = max(rig.torques) * (specimen.spec.scatter or [1.0])[-1]
        self.k_n, self.k_t = specimen.springs(torque)
        rest = _AT_REST[rig.name]
        if sensing.slip is not None:
            self.k_t = series(self.k_t, rest)
        if sensing.opens:
            self.k_n = series(self.k_n, rest)
        p = specimen.pressure.sum(axis=0) * bolt_force(rig, torque)
        self.p = p + _EVERYWHERE * p.max()
        shapes = []
        for soft in (1.0, *_SOFTER):
            k_n = self.k_n * (soft if sensing.opens else 1.0)
            k_t = self.k_t * (soft if sensing.slip is not None else 1.0)
            hz, found, joint = specimen.modes(k_n, k_t)
            if soft == 1.0:
                self.rest = specimen.seen(hz, found, joint, nominal.shapes, weight)
            shapes.append(found)
        self._project(np.hstack(shapes))

    def enrich(self, found) -> None:
        """Add the modes with the joint as the mode leaves it that has fallen most.

        Args:
            found: What `mode` gave for each.
        """
        fall = np.array([mode[0] for mode in found]) / self.rest.hz
        _, _, phi, q = found[int(np.argmin(fall))]
        k_n, k_t, _ = self.springs(phi, q)
        _, more, _ = self.specimen.modes(k_n, k_t)
        self._project(np.hstack([self.basis, more]))

    def springs(self, phi, q: float):
        """Equivalent stiffness k_n and k_t at an amplitude, Pa/m, and energy lost in a cycle, J."""
        sensing, k_n, k_t, lost = self.specimen.sensing, self.k_n, self.k_t, 0.0
        u = [row @ phi * q for row in self.rows]
        if sensing.slip is not None:
            k_t, loss = slip(k_t, np.hypot(u[0], u[1]), sensing.slip * self.p)
            lost = float(loss @ self.weights)
        if sensing.opens:
            k_n = gapping(k_n, np.abs(u[2]), self.p)
        return k_n, k_t, lost

    def _project(self, v) -> None:
        specimen = self.specimen
        values, vectors = np.linalg.eigh(v.T @ (specimen.m @ v))
        keep = values > 1e-9 * values.max()
        v = v @ (vectors[:, keep] / np.sqrt(values[keep]))
        self.basis, self.k = v, v.T @ (specimen.k @ v)
        self.rows = [row @ v for row in specimen.interface.opening]
        self.weights = specimen.interface.weights
        seen = specimen.whole.at(specimen.rig.sensors)[2]
        seen = seen @ self.rest.shapes[: specimen.whole.n_dofs]
        self.drive = np.sqrt(np.mean(seen**2, axis=0))
        self.start = v.T @ (specimen.m @ self.rest.shapes)

    def mode(self, j: int, level: float, damping: float, E: float = 1.0, near=None):
        """Hz, damping ratio, shape and amplitude of mode j driven at resonance.

        Args:
            j: The mode.
            level: Force, N, that drives the first mode, where that moves as its root mean square
                over the sensors; a higher mode gets more, as of a tester who wants to see it move.
            damping: Its ratio at rest.
            E: Factor on all moduli.
            near: What this method gave at a lower level, to start from.
        """
        hz0 = self.rest.hz
        force = level * (hz0[j] / hz0[0]) ** _DRIVEN
        hz, zeta, phi, q = near or (hz0[j], damping, self.start[:, j], None)
        omega, k_n, k_t = 2 * np.pi * hz, self.k_n, self.k_t
        for step in range(_STEPS):
            driven = force * self.drive[j] / (2 * zeta * omega**2)
            # Part of the way, in the logarithm: whole steps may swing between stick and slip.
            part = max(0.5 * 0.97**step, 0.05)
            q = driven if q is None else q * (driven / q) ** part
            now_n, now_t, lost = self.springs(phi, q)
            k_n, k_t = k_n * (now_n / k_n) ** part, k_t * (now_t / k_t) ** part
            values, vectors = self.solve(k_n, k_t, E)
            at = np.argmax(np.abs(phi @ vectors))
            new, phi = np.sqrt(values[at]), vectors[:, at]
            zeta = damping + lost / (2 * np.pi * new**2 * q**2)
            done = abs(new / omega - 1) < _SETTLED and abs(driven / q - 1) < _LOOSE
            omega = new
            if done:
                return omega / (2 * np.pi), zeta, phi, q
        if abs(new / omega - 1) < _SWINGS and abs(driven / q - 1) < 10 * _LOOSE:
            return omega / (2 * np.pi), zeta, phi, q
        raise UnsettledError(f"{self.specimen.rig.name}: mode {j} at {level:g} N does not settle")

    def solve(self, k_n, k_t, E: float = 1.0):
        """All eigenvalues and vectors in the basis, with a joint."""
        k = E * self.k
        for row, stiffness in zip(self.rows, (k_t, k_t, k_n), strict=True):
            k = k + row.T @ ((self.weights * stiffness)[:, None] * row)
        return np.linalg.eigh(k)


def _by_level(specimen: _Specimen, nominal, weight):
    spec, sensing = specimen.spec, specimen.sensing
    small = _Small(specimen, nominal, weight)
    warm = sensing.E[0] * sensing.E[1] ** np.linspace(0, 1, len(spec.levels))
    rest = np.array(spec.damping) + small.rest.share / 2 * _loss(sensing, small.rest.hz)
    small.enrich([small.mode(j, spec.levels[-1], zeta) for j, zeta in enumerate(rest)])
    found, near = [], [None] * len(rest)
    for level, E in zip(spec.levels, warm, strict=True):
        near = [
            small.mode(j, level, zeta, E, start)
            for j, (zeta, start) in enumerate(zip(rest, near, strict=True))
        ]
        found.append(near)
    hz = np.array([[mode[0] for mode in row] for row in found])
    damping = np.array([[mode[1] for mode in row] for row in found])
    shapes = small.basis @ np.array([mode[2] for mode in found[spec.shapes_row]]).T
    return hz, damping, _State(hz[spec.shapes_row], shapes, small.rest.share)


def calibrate_levels(spec: Spec, drop: float, ratios) -> list[float]:
    """Forces, N, in these ratios, such that the most affected mode falls by ``drop`` at the last.

    By less if the test would jump from one amplitude to another before that.

    Args:
        spec: With a cause that acts by level.
        drop: Relative drop of the frequency.
        ratios: Of the forces; the last is the largest.
    """
    nominal, weight = _nominal(spec.geometry)
    small = _Small(_Specimen(spec), nominal, weight)
    near = [None] * len(spec.damping)
    level = _LEAST
    # Upwards from next to nothing, so that each mode is followed.
    while level < _MOST:
        try:
            near = [small.mode(j, level, z, 1.0, near[j]) for j, z in enumerate(spec.damping)]
        except UnsettledError:
            break
        if np.max(1 - np.array([mode[0] for mode in near]) / small.rest.hz) >= drop:
            break
        level *= _UP
    # A little below, as the levels are approached in other steps.
    top = level / _UP
    return [float(f"{top * ratio / ratios[-1]:.3g}") for ratio in ratios]


# -- the test --------------------------------------------------------------------------------------


def _as_seen(specimen: _Specimen, hz, damping, state: _State) -> Answer:
    rig, sensing = specimen.rig, specimen.sensing
    places = [
        (x + sensing.shifts.get(i, 0.0), y, body) for i, (x, y, body) in enumerate(rig.sensors)
    ]
    gains = np.array([sensing.gains.get(i, 1.0) for i in range(len(places))])
    rows = specimen.whole.at(places)[2]
    shapes = gains[:, None] * (rows @ state.shapes[: specimen.whole.n_dofs])
    shapes = shapes / np.sqrt(np.mean(shapes**2, axis=0))
    hz, damping = hz.copy(), damping.copy()
    for j in sensing.swaps:
        for values in (hz, damping):
            values[:, [j, j + 1]] = values[:, [j + 1, j]]
    j = specimen.spec.nuisance.get("whole_swap")
    if j is not None:
        for values in (hz, damping, shapes):
            values[:, [j, j + 1]] = values[:, [j + 1, j]]
    return Answer(hz, damping, shapes)
