"""D and the oracle's answer for cases of the second world, from CalculiX' own predictions.

The metric counts noise, tolerances, and the error that the nominal case states of its model: the
same that the diagnosis counts, half of its variance in frequencies and in shapes common.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.optimize import linear_sum_assignment

from benchmarks.blind.calculix.cases import SCATTER
from benchmarks.blind.calculix.rigs import RIGS
from benchmarks.blind.calculix.sheets import Sheet, sheets_of
from benchmarks.blind.calculix.states import States
from benchmarks.blind.oracle import Curve, Whitened, posterior, separability
from benchmarks.blind.score import NONE
from fenics_joints.files import read_toml

__all__ = ["Reckoning"]

_ALONG = 16
_CHANGING = 0.5  # of the variance of the model's error, from torque to torque


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

    def __init__(self, geometry: _Geometry, answer: Mapping, stated: Mapping):
        self.of, self.answer, self.stated = geometry, answer, stated
        own = answer["spec"]
        self.n = len(own["torques"])
        self.m = len(answer["frequencies"][0])
        self.sensors, self.shaped = own["sensors"], own["shapes"]
        self.ln_torque = np.log(np.array(own["torques"]) / max(geometry.rig.torques))
        self.modes = self._modes()

    def _modes(self) -> np.ndarray:
        """Of each measured mode the drawing's that it is most like, (m,)."""
        hz, u = self.of.states.base
        clean = np.log(np.array(self.answer["frequencies"][-1]))
        cost = ((clean[:, None] - np.log(hz)[None, :]) / 0.1) ** 2
        if self.shaped:
            a, b = np.array(self.answer["shapes"]), self._read(u)
            a, b = (v / np.linalg.norm(v, axis=0) for v in (a, b))
            cost = cost + 4 * (1 - (a.T @ b) ** 2)
        return linear_sum_assignment(np.minimum(cost, 50.0))[1]

    def _read(self, u: np.ndarray) -> np.ndarray:
        """Along the sensors, (n_s, m), of shapes (m, n, 3)."""
        pool = self.of.states.pool
        return np.einsum(
            "msk,sk->sm", u[:, pool.sensors[self.sensors]], pool.normals[self.sensors]
        )

    @cached_property
    def like(self) -> np.ndarray:
        """The drawing's shapes at the sensors, of unit root mean square, (n_s, m)."""
        shapes = self._read(self.of.states.base[1][self.modes])
        return shapes / np.sqrt(np.mean(shapes**2, axis=0))

    def scaled(self, shapes: np.ndarray) -> np.ndarray:
        """Shapes (n_s, m) as near as can be to the drawing's."""
        return shapes * np.sum(shapes * self.like, axis=0) / np.sum(shapes**2, axis=0)

    def data(self, log_f: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Of ln f at the rows (n, m_all) and the shapes of the last (m_all, n, 3)."""
        shapes = self.scaled(self._read(u[self.modes])) if self.shaped else np.zeros(0)
        return np.concatenate([np.ravel(log_f[:, self.modes]), np.ravel(shapes)])

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
        """Noise, the model's error as stated, tolerances, and the scales of shapes."""
        noise = self.answer["noise"]
        n_shape = self.none.size - self.n * self.m
        error, of_shapes = self.stated["discrepancy"], self.stated["shape_discrepancy"]
        sd = np.concatenate([
            np.full(self.n * self.m, np.hypot(noise[0], np.sqrt(_CHANGING) * error)),
            np.full(n_shape, np.hypot(noise[1], of_shapes)),
        ])  # fmt: skip
        hz, u = self.of.states.base
        columns = [
            self.constant((np.log(hz) + f, u + s)) - self.none for f, s in self.of.nuisances
        ]
        for j in range(self.m):
            common = np.zeros((self.n, self.m))
            common[:, j] = np.sqrt(1 - _CHANGING) * error
            columns.append(np.concatenate([common.ravel(), np.zeros(n_shape)]))
            if n_shape:
                scale = np.zeros_like(self.like)
                scale[:, j] = self.like[:, j]
                columns.append(np.concatenate([0 * common.ravel(), scale.ravel()]))
        return Whitened(np.diag(sd**2), np.array(columns).T)

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
            columns.append(
                np.concatenate([change.ravel(), np.zeros(self.none.size - change.size)])
            )
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
        from benchmarks.blind.calculix.meshing import mesh_of

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
        effects = self.answer["spec"]["effects"]
        rows = [
            self.of.states.of(effects, self._drift(i), float(np.exp(t)))
            for i, t in enumerate(self.ln_torque)
        ]
        shown = self.data(np.array([f for f, _ in rows]), rows[-1][1])
        return self._by_test(shown, rows[-1][1], effects)

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
        pool, raw = self.of.states.pool, self._read(u[self.modes])
        for effect in effects:
            p = effect["params"]
            if effect["name"] == "sensor_gain":
                i = self.sensors.index(p["sensor"])
                shapes = self._row(raw, i, raw[i] * p["factor"])
            elif effect["name"] == "sensor_place":
                i, normal = self.sensors.index(p["sensor"]), pool.normals[p["sensor"]]
                shapes = self._row(raw, i, u[self.modes][:, pool.sensors[p["reads"]]] @ normal)
            elif effect["name"] == "mis_pairing":
                j = int(p["share"] * (self.m - 1))
                by_row = log_f.reshape(self.n, self.m)
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
        """D against all other effects and none (None of a case without effect); probabilities."""
        self.say(f"oracle: case {name}")
        geometry = answer["geometry"]
        of = self._geometries.setdefault(geometry, _Geometry(geometry, self.say))
        place = self.folder / "cases" / name
        test = _Test(of, answer, _stated(place))
        families = test.families()
        chances = posterior(test.measured(place), families, test.white)
        if answer["kind"] == "none":
            return None, chances
        own = {effect["name"] for effect in answer["effects"]}
        rivals = {rival: curves for rival, curves in families.items() if rival not in own}
        return separability(test.truth(), rivals, test.white), chances


def _stated(folder: Path) -> dict[str, float]:
    """The model's errors that the nominal case states, as numbers."""
    section = read_toml(folder / "case.toml", "a case of the check")["diagnose"]
    return {
        key: float(section[key].removesuffix("%")) / 100
        for key in ("discrepancy", "shape_discrepancy")
    }
