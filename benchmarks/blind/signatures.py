"""D and the oracle's answer for cases of the second world, from CalculiX' own predictions.

The metric counts noise, tolerances, and the error of the nominal model as the diagnosis counts it
(`benchmarks.blind.counted`). The oracle has the case's own effect, at its own size and place, among
those that it chooses from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment

from benchmarks.blind.calculix.cases import SCATTER
from benchmarks.blind.calculix.meshing import mesh_of
from benchmarks.blind.calculix.rigs import RIGS
from benchmarks.blind.calculix.sheets import Sheet, sheets_of
from benchmarks.blind.calculix.states import States
from benchmarks.blind.counted import Errors
from benchmarks.blind.oracle import Curve, Whitened, posterior, separability
from benchmarks.blind.score import NONE
from benchmarks.blind.seal import read_json
from fenics_joints.diagnosis.evidence.entries import Neighbours
from fenics_joints.files import read_toml
from fenics_joints.measurements.data import TestData
from fenics_joints.structure import Sensors

_ALONG = 16
#: Sheets of all joints giving way.
_GIVING_WAY = ("soft_joint", "sliding_joint")


class _Geometry:
    """Everything of a rig that no case changes."""

    def __init__(self, geometry: str, say):
        self.states, self.rig = States(geometry, say), RIGS[geometry]

    @cached_property
    def sheets(self) -> list[Sheet]:
        return list(sheets_of(self.states))

    @property
    def nuisances(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Change of ln f and shapes per standard deviation of each tolerance."""
        return list(self.states.nuisances.values())


class _Test:
    """How one case's test sees states. Data are ln f (n m) and shapes (n_s m)."""

    def __init__(self, geometry: _Geometry, answer: Mapping, stated: Errors):
        self.of, self.answer, self.stated = geometry, answer, stated
        own = answer["spec"]
        self.n = len(own["torques"])
        self.m = len(answer["frequencies"][0])
        self.sensors, self.shaped = own["sensors"], own["shapes"]
        self.ln_torque = np.log(np.array(own["torques"]) / max(geometry.rig.torques))
        hz, u = geometry.states.base
        self.modes = self._told(np.log(hz), u)
        self.own_modes = self._told(*self._states[-1]) if own["effects"] else self.modes

    @cached_property
    def _states(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """The structure as drawn with this case's effects at each torque, as it should be
        tightened: ln f and shapes, in the order of the drawing's modes."""
        effects = self.answer["spec"]["effects"]
        return [
            self.of.states.of(effects, self._drift(i), float(np.exp(t)))
            for i, t in enumerate(self.ln_torque)
        ]

    def _told(self, log_f: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Of each measured mode that of a state which is most like it, (m,)."""
        measured = np.log(np.array(self.answer["frequencies"][-1]))
        cost = ((measured[:, None] - log_f[None, :]) / 0.1) ** 2
        if self.shaped:
            a, b = np.array(self.answer["shapes"]), self._read(u)
            a, b = (v / np.linalg.norm(v, axis=0) for v in (a, b))
            # Shapes decide: a test may have exchanged frequencies.
            cost = np.minimum(cost, 4.0) + 20 * (1 - (a.T @ b) ** 2)
        return linear_sum_assignment(np.minimum(cost, 50.0))[1]

    def _swapped(self) -> list[int]:
        """The first of each two modes that the test has exchanged."""
        effects = self.answer["spec"]["effects"]
        return [
            int(e["params"]["share"] * (self.m - 1)) for e in effects if e["name"] == "mis_pairing"
        ]

    def _read(self, u: np.ndarray) -> np.ndarray:
        """Along the sensors, (n_s, m), of shapes (m, n, 3)."""
        pool = self.of.states.pool
        return np.einsum("msk,sk->sm", u[:, pool.sensors[self.sensors]], pool.normals[self.sensors])

    @cached_property
    def like(self) -> np.ndarray:
        """The drawing's shapes at the sensors, of unit root mean square, (n_s, m)."""
        shapes = self._read(self.of.states.base[1][self.modes])
        return shapes / np.sqrt(np.mean(shapes**2, axis=0))

    def scaled(self, shapes: np.ndarray) -> np.ndarray:
        """Shapes (n_s, m) as near as can be to the drawing's."""
        return shapes * np.sum(shapes * self.like, axis=0) / np.sum(shapes**2, axis=0)

    def data(self, log_f: np.ndarray, u: np.ndarray, modes=None) -> np.ndarray:
        """Of ln f at the rows (n, m_all) and the shapes of the last (m_all, n, 3); of the modes
        that the drawing has for the measured ones, or others."""
        modes = self.modes if modes is None else modes
        shapes = self.scaled(self._read(u[modes])) if self.shaped else np.zeros(0)
        return np.concatenate([np.ravel(log_f[:, modes]), np.ravel(shapes)])

    def constant(self, state) -> np.ndarray:
        """Of a state that is the same at all rows."""
        return self.data(np.tile(state[0], (self.n, 1)), state[1])

    @cached_property
    def none(self) -> np.ndarray:
        """Without effects."""
        hz, u = self.of.states.base
        return self.constant((np.log(hz), u))

    @cached_property
    def white(self) -> Whitened:
        """Noise, the model's error, tolerances, and the scales of shapes."""
        hz, u = self.of.states.base
        columns = [self.constant((np.log(hz) + f, u + s)) - self.none for f, s in self.of.nuisances]
        for j in range(self.m if self.shaped else 0):
            scale = np.zeros_like(self.like)
            scale[:, j] = self.like[:, j]
            columns.append(np.concatenate([np.zeros(self.n * self.m), scale.ravel()]))
        covariance = self.stated.covariance(self._seen(), self._neighbours(), self._giving_way())
        return Whitened(covariance, np.array(columns).T)

    def _seen(self) -> TestData:
        """The test without its noise."""
        pool, noise = self.of.states.pool, self.answer["noise"]
        x = mesh_of(self.of.rig.name).x[pool.observed.nodes[pool.sensors[self.sensors]]]
        return TestData(
            self.answer["spec"]["torques"],
            self.answer["frequencies"],
            [f"mode {j + 1}" for j in range(self.m)],
            noise=noise[0],
            sensors=Sensors(x, pool.normals[self.sensors]),
            shapes=self.scaled(np.array(self.answer["shapes"])) if self.shaped else None,
            shape_noise=noise[1],
        )

    def _neighbours(self) -> Neighbours:
        hz, u = self.of.states.base
        return Neighbours(np.log(hz), self._read(u), self.modes)

    def _giving_way(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """What all joints do that give way, at the stiffest that is computed."""
        found = []
        for sheet in self.of.sheets:
            if sheet.name in _GIVING_WAY:
                change = self.constant((sheet.states[0][-1], sheet.states[1][-1])) - self.none
                log_f, shapes = change[: self.m], change[self.n * self.m :]
                found.append((log_f, shapes.reshape(-1, self.m)))
        return found

    # -- families --------------------------------------------------------------------------------

    def families(self) -> dict[str, list[Curve]]:
        """Curves of all effects that a single one can be in this test, and of none."""
        found: dict[str, list[Curve]] = {NONE: [Curve(self.none)]}
        for sheet in self.of.sheets:
            found.setdefault(sheet.name, []).append(self._curve(sheet))
        if self.shaped:
            found |= self._sensors()
            found["mis_pairing"] = self._swaps()
        if self.n > 1:
            found["temperature"] = self._temperature()
        return found

    def _curve(self, sheet: Sheet) -> Curve:
        if len(sheet.us) == 1:  # a place rather than a size
            return Curve(self.constant((sheet.states[0][0], sheet.states[1][0])))
        by_f, by_u = (PchipInterpolator(sheet.us, s, axis=0) for s in sheet.states)
        points, tilts = [], []
        for u in np.linspace(*sheet.span, _ALONG):
            at = np.clip(u + sheet.power * self.ln_torque, sheet.us[0], sheet.us[-1])
            points.append(self.data(by_f(at), by_u(at[-1])))
            tilts.append(self._tilt(by_f.derivative()(at) * sheet.power * SCATTER))
        scatter = np.array(tilts[:-1]) if sheet.power else None
        return Curve(np.array(points), scatter)

    def _tilt(self, turn: np.ndarray) -> np.ndarray:
        """Change of the data per standard deviation of each row's preload, (., n)."""
        columns = []
        for row in range(self.n):
            change = np.zeros((self.n, self.m))
            change[row] = turn[row][self.modes]
            columns.append(np.concatenate([change.ravel(), np.zeros(self.none.size - change.size)]))
        return np.array(columns).T

    def _sensors(self) -> dict[str, list[Curve]]:
        gains, shifts = [], []
        log_f, u = np.log(self.of.states.base[0]), self.of.states.base[1][self.modes]
        log_f = np.tile(log_f[self.modes], (self.n, 1)).ravel()
        pool = self.of.states.pool
        raw = self._read(u)
        for i, sensor in enumerate(self.sensors):
            for sign in (-1, 1):
                rows = [self._row(raw, i, raw[i] * np.exp(sign * g)) for g in (0.15, 0.4, 0.7)]
                gains.append(Curve(np.array([np.concatenate([log_f, r]) for r in rows])))
            for other in self._near(sensor):
                moved = u[:, pool.sensors[other]] @ pool.normals[sensor]
                row = self._row(raw, i, moved)
                shifts.append(Curve(np.array([self.none, np.concatenate([log_f, row])])))
        return {"sensor_gain": gains, "sensor_place": shifts}

    def _row(self, raw, i: int, reading) -> np.ndarray:
        changed = raw.copy()
        changed[i] = reading
        return self.scaled(changed).ravel()

    def _near(self, sensor: int) -> list[int]:
        """Other places of the pool that face the same way, the nearest four."""
        pool = self.of.states.pool
        x = mesh_of(self.of.rig.name).x[pool.observed.nodes[pool.sensors]]
        away = np.linalg.norm(x - x[sensor], axis=1)
        away[pool.normals @ pool.normals[sensor] < 0.98] = np.inf
        away[sensor] = np.inf
        return [int(i) for i in np.argsort(away)[:4]]

    def _swaps(self) -> list[Curve]:
        log_f = np.log(self.of.states.base[0])[self.modes]
        curves = []
        for j in range(self.m - 1):
            order = np.arange(self.m)
            order[[j, j + 1]] = j + 1, j
            swapped = np.tile(log_f[order], (self.n, 1)).ravel()
            curves.append(Curve(np.concatenate([swapped, self.none[self.n * self.m :]])))
        return curves

    def _temperature(self) -> list[Curve]:
        """All moduli together: frequencies go with their root, shapes stay."""
        place, curves = np.linspace(0, 1, self.n), []
        rest = np.zeros(self.none.size - self.n * self.m)
        for drift in (-0.01, -0.003, 0.003, 0.01):
            for side in (-1, 1):
                points = [
                    self.none
                    + np.concatenate([np.repeat((side * s + drift * place) / 2, self.m), rest])
                    for s in np.geomspace(0.005, 0.03, 6)
                ]
                curves.append(Curve(np.array(points)))
        return curves

    # -- the case --------------------------------------------------------------------------------

    def truth(self) -> np.ndarray:
        """What this case's effects show on the structure as drawn, tightened as it should be."""
        rows, effects = self._states, self.answer["spec"]["effects"]
        shown = self.data(np.array([f for f, _ in rows]), rows[-1][1], self.own_modes)
        return self._by_test(shown, rows[-1][1][self.own_modes], effects)

    def _drift(self, row: int):
        def change(build) -> None:
            for effect in self.answer["spec"]["effects"]:
                if effect["name"] == "temperature" and self.n > 1:
                    for i in build.E:
                        build.E[i] *= 1 + effect["params"]["drift"] * row / (self.n - 1)

        return change

    def _by_test(self, shown: np.ndarray, u, effects) -> np.ndarray:
        """With what the test itself does to the data."""
        log_f, shapes = shown[: self.n * self.m].copy(), shown[self.n * self.m :]
        pool, raw = self.of.states.pool, self._read(u)
        for effect in effects:
            p = effect["params"]
            if effect["name"] == "sensor_gain":
                i = self.sensors.index(p["sensor"])
                shapes = self._row(raw, i, raw[i] * p["factor"])
            elif effect["name"] == "sensor_place":
                i, normal = self.sensors.index(p["sensor"]), pool.normals[p["sensor"]]
                shapes = self._row(raw, i, u[:, pool.sensors[p["reads"]]] @ normal)
        by_row = log_f.reshape(self.n, self.m)
        for j in self._swapped():
            by_row[:, [j, j + 1]] = by_row[:, [j + 1, j]]
        return np.concatenate([log_f, shapes])

    def measured(self, folder: Path) -> np.ndarray:
        """The noisy data."""
        table = np.genfromtxt(folder / "frequencies.csv", delimiter=",", skip_header=1)
        hz = np.atleast_2d(table)[:, -self.m :]
        if not self.shaped:
            return np.log(hz).ravel()
        shapes = np.genfromtxt(folder / "shapes.csv", delimiter=",", skip_header=1)[:, 1:]
        return np.concatenate([np.log(hz).ravel(), self.scaled(shapes).ravel()])


class Reckoning:
    """D and the oracle's probabilities of cases of this world.

    Args:
        folder: The folder of the check.
        say: Told what is solved.
    """

    def __init__(self, folder: Path, say: Callable[[str], None] = print):
        self.folder, self.say = folder, say
        self._geometries: dict[str, _Geometry] = {}

    def __call__(self, name: str, answer: Mapping) -> tuple[float | None, dict[str, float]]:
        """D against all other effects and none, and probabilities, of a case with one effect, of
        the library or not; of others none, as no score rests on theirs."""
        if answer["kind"] not in ("single", "unknown"):
            return None, {}
        self.say(f"oracle: case {name}")
        geometry = answer["geometry"]
        of = self._geometries.setdefault(geometry, _Geometry(geometry, self.say))
        place = self.folder / "cases" / name
        test = _Test(of, answer, self._errors(name))
        families = test.families()
        own, truth = answer["effects"][0]["name"], test.truth()
        families.setdefault(own, []).append(Curve(truth))
        chances = posterior(test.measured(place), families, test.white)
        rivals = {rival: curves for rival, curves in families.items() if rival != own}
        return separability(truth, rivals, test.white), chances

    def _errors(self, name: str) -> Errors:
        """What the nominal case states, as numbers, and what its diagnosis found of the mesh."""
        case = read_toml(self.folder / "cases" / name / "case.toml", "a case of the check")
        discrepancy, of_shapes = (
            float(case["diagnose"][key].removesuffix("%")) / 100
            for key in ("discrepancy", "shape_discrepancy")
        )
        found = read_json(self.folder / "diagnoses" / f"{name}.json").get("diagnosis") or {}
        mesh = found.get("model", {}).get("mesh_error", {})
        return Errors(
            discrepancy=discrepancy,
            of_shapes=of_shapes,
            mesh={int(mode.removeprefix("mode ")): error for mode, error in mesh.items()},
        )
