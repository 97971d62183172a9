"""D and the oracle's answer for cases of the world, from the world's own predictions.

Frequencies and shapes of each effect are computed at a few sizes of the structure as drawn, and
interpolated. A joint's stiffness goes with a power of the torque, so that one curve by size serves
all torques. Every state that was solved is kept in ``cache/oracle``.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmarks.blind import seal
from benchmarks.blind.oracle import Curve, Whitened, posterior, separability
from benchmarks.blind.score import NONE

_CACHE = Path(__file__).resolve().parent / "cache" / "oracle"
#: Places between the computed sizes, and between the values of a second parameter.
_ALONG, _ACROSS = 24, 9
_SCATTER = 0.15
_REST = 0.5  # of ln damping at rest


@cache
def _world_digest() -> str:
    return seal.source_digest("benchmarks/blind/world")


# -- solved states ---------------------------------------------------------------------------------


def _clean(spec) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """ln frequencies, ln damping and shapes of a specimen, kept once they were computed."""
    from benchmarks.blind import world

    text = json.dumps([_world_digest(), vars(spec)], sort_keys=True)
    path = _CACHE / f"{spec.geometry}_{hashlib.sha256(text.encode()).hexdigest()[:20]}.npz"
    if path.exists():
        with np.load(path) as kept:
            return kept["log_f"], kept["log_damping"], kept["shapes"]
    found = world.clean(spec)
    result = np.log(found.frequencies), np.log(found.damping), found.shapes
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    np.savez(part, log_f=result[0], log_damping=result[1], shapes=result[2])
    part.replace(path)
    return result


@dataclass(frozen=True)
class _Sheet:
    """An effect at one place by its size u, in logarithms, and a second parameter v.

    Attributes:
        us, vs: Where it is computed, (k,) and (l,).
        params: Parameters of the world at (u, v).
        span: Range of u that the generator draws from, at the highest torque.
        power: Of the torque, by v: what u is at another torque.
    """

    name: str
    region: str
    us: np.ndarray
    vs: np.ndarray
    params: Callable[[float, float], dict]
    span: tuple[float, float]
    power: Callable[[float], float] = lambda v: 0.0


class Signatures:
    """What the effects of a geometry show on the structure as drawn.

    Args:
        geometry: One of the world's.
        say: Told what is solved.
    """

    def __init__(self, geometry: str, say: Callable[[str], None]):
        from benchmarks.blind.world.rigs import RIGS

        self.geometry, self.rig, self.say = geometry, RIGS[geometry], say
        self.m, self.n_s = self.rig.n_modes, len(self.rig.sensors)

    def state(self, effects: Sequence[Mapping] = (), nuisance: Mapping | None = None) -> np.ndarray:
        """ln f (m,) and shapes, aligned, (n_s m,) at the highest torque, one after the other."""
        from benchmarks.blind.world import Spec

        spec = Spec(
            self.geometry,
            "level",
            list(effects),
            dict(nuisance or {}),
            damping=[2.5e-3] * self.m,
            shapes_row=0,
            levels=[1.0],
        )
        log_f, _, shapes = _clean(spec)
        if effects or nuisance:
            shapes = shapes * np.sign(np.sum(shapes * self.shapes, axis=0))
        return np.concatenate([log_f[0], shapes.ravel()])

    @cached_property
    def base(self) -> np.ndarray:
        """The state without effects."""
        return self.state()

    @property
    def shapes(self) -> np.ndarray:
        """Its shapes, (n_s, m)."""
        return self.base[self.m :].reshape(self.n_s, self.m)

    @cached_property
    def nuisances(self) -> np.ndarray:
        """Change of the state per standard deviation of each tolerance, (m + n_s m, p)."""
        from benchmarks.blind.world.cases import _PLACE, _TOLERANCE

        self.say(f"oracle: tolerances of {self.geometry}")
        steps = []
        for key in ("E", "rho", "thickness"):
            for body in (0, 1):
                pair = [1.0, 1.0]
                pair[body] = float(np.exp(_TOLERANCE[key]))
                steps.append({key: pair})
        steps += [{key: float(np.exp(_TOLERANCE[key]))} for key in ("heads", "accelerometer")]
        steps.append({"place": _PLACE if self.geometry != "lap_beam" else 2e-3})
        return np.array([self.state(nuisance=step) - self.base for step in steps]).T

    @cached_property
    def grids(self) -> list[tuple[_Sheet, np.ndarray]]:
        """Every sheet with its states, (k, l, m + n_s m)."""
        found = []
        for sheet in sheets_of(self.geometry):
            self.say(f"oracle: {sheet.name} of {self.geometry}, {sheet.region}")
            states = [
                [
                    self.state(
                        [
                            {
                                "name": sheet.name,
                                "region": sheet.region,
                                "params": sheet.params(float(u), float(v)),
                            }
                        ]
                    )
                    for v in sheet.vs
                ]
                for u in sheet.us
            ]
            found.append((sheet, np.array(states)))
        return found

    @cached_property
    def slopes(self) -> np.ndarray:
        """Slope of the shapes along x at the sensors, 1/m, (n_s, m).

        Every other sensor is moved at a time: those that stay say how the shape was scaled.
        """
        step, found = 2e-3, np.zeros((self.n_s, self.m))
        for parity in (0, 1):
            moved = np.arange(self.n_s) % 2 == parity
            effects = [
                {"name": "sensor_place", "region": f"sensor {i + 1}", "params": {"m": step}}
                for i in np.flatnonzero(moved)
            ]
            shapes = self.state(effects)[self.m :].reshape(self.n_s, self.m)
            still = self.shapes[~moved]
            scale = np.sum(still**2, axis=0) / np.sum(still * shapes[~moved], axis=0)
            found[moved] = (scale * shapes - self.shapes)[moved] / step
        return found


def sheets_of(geometry: str) -> list[_Sheet]:
    """What is computed of a geometry, by the ranges that the generator draws from."""
    from benchmarks.blind import world
    from benchmarks.blind.world.effects import _SOFT, _TOTAL
    from benchmarks.blind.world.rigs import RIGS

    rig, soft, total = RIGS[geometry], np.log(_SOFT[geometry]), _TOTAL[geometry]
    least = float(np.log(min(rig.torques) / max(rig.torques)))
    half, one = (lambda v: 0.5), np.zeros(1)
    wide = np.linspace(soft[0] + least / 2, soft[1], 9)
    graded = soft + np.log(30)
    lost = np.log([0.004, 0.08])

    def soft_both(u, v):
        return {"k_n": np.exp(u + v), "k_t": np.exp(u), "beta": 0.5}

    sheets = [
        _Sheet(
            "tangential",
            "joint",
            wide,
            one,
            lambda u, v: {"k": np.exp(u), "beta": 0.5},
            tuple(soft),
            half,
        ),
        _Sheet(
            "normal_and_tangential",
            "joint",
            wide,
            np.log([0.5, 1.4, 4.0]),
            soft_both,
            tuple(soft),
            half,
        ),
        _Sheet(
            "graded",
            "joint",
            np.linspace(graded[0] + least, graded[1], 8),
            np.array([0.4, 0.7, 1.0]),
            lambda u, v: {"k": np.exp(u), "beta": v},
            tuple(graded),
            lambda v: v,
        ),
        _Sheet(
            "lost_contact",
            "joint",
            np.linspace(lost[0], lost[1] - least, 10),
            one,
            lambda u, v: {"share": np.exp(u)},
            tuple(lost),
            lambda v: -1.0,
        ),
    ]
    if len(rig.bolts) > 1:
        places = {bolt.x: f"bolt {bolt.label}" for bolt in reversed(rig.bolts)}
        span = np.log(np.array([0.1, 6.0]) * _SOFT[geometry][0])
        sheets += [
            _Sheet(
                "loose_bolt",
                label,
                np.linspace(*span, 5),
                one,
                lambda u, v: {"k": np.exp(u)},
                tuple(span),
            )
            for label in places.values()
        ]
    ranges = {
        "modulus": (0.04, 0.3),
        "density": (0.03, 0.2),
        "thickness": (0.015, 0.15),
        "width": (0.05, 0.35),
    }
    for name, (low, high) in ranges.items():
        for part in world.regions(geometry, name):
            for sign in (-1, 1):
                us = np.log([low, np.sqrt(low * high), high])
                sheets.append(
                    _Sheet(
                        name,
                        part,
                        us,
                        one,
                        lambda u, v, s=sign: {"factor": np.exp(s * np.exp(u))},
                        (us[0], us[-1]),
                    )
                )
    where = {"lap_plates": (0.22, 0.31), "c_beam": (0.31, 0.45), "lap_beam": (0.25, 0.395)}
    most = {"lap_plates": (4e-3, 0.06), "c_beam": (0.015, 0.15), "lap_beam": (2e-3, 0.02)}
    span = np.log(most[geometry])
    sheets.append(
        _Sheet(
            "accelerometer",
            "end accelerometer",
            np.linspace(*span, 3),
            np.linspace(*where[geometry], 5),
            lambda u, v: {"kg": np.exp(u), "x": v},
            tuple(span),
        )
    )
    single = {
        "washers": ("kg", (0.02 * total, 0.15 * total), 3),
        "suspension": ("N/m", (5e3 * total, 6e5 * total), 5),
        "clamp": ("k", (5e12, 1e14), 5),
    }
    for name, (key, limits, count) in single.items():
        if name in world.EFFECTS[geometry]:
            span = np.log(limits)
            sheets.append(
                _Sheet(
                    name,
                    name,
                    np.linspace(*span, count),
                    one,
                    lambda u, v, k=key: {k: np.exp(u)},
                    tuple(span),
                )
            )
    return sheets


# -- a test ----------------------------------------------------------------------------------------


class _Test:
    """How one case's test sees states: rows, missing sensors, noise.

    Data are ln f (n m), shapes (n_s m), and in a test by level ln damping (n m); entries of
    missing sensors are left out.
    """

    def __init__(self, signatures: Signatures, answer: Mapping):
        self.of, self.answer = signatures, answer
        self.level = answer["test"] == "level"
        rig = signatures.rig
        self.n, self.m, self.n_s = len(answer["conditions"]), signatures.m, signatures.n_s
        torques = np.array(rig.torques) / max(rig.torques)
        self.ln_torque = np.zeros(self.n) if self.level else np.log(torques)
        there = np.ones((self.n_s, self.m), dtype=bool)
        there[answer["missing"]] = False
        parts = [np.ones(self.n * self.m, dtype=bool), there.ravel()]
        if self.level:
            parts.append(np.ones(self.n * self.m, dtype=bool))
        self.kept = np.concatenate(parts)

    def joined(self, log_f, shapes, log_damping=None) -> np.ndarray:
        """Data from ln f (n, m), shapes (n_s, m) and ln damping (n, m)."""
        parts = [np.ravel(log_f), np.ravel(shapes)]
        if self.level:
            rest = np.log(self.answer["spec"]["damping"])
            damping = np.tile(rest, (self.n, 1)) if log_damping is None else log_damping
            parts.append(np.ravel(damping))
        return np.concatenate(parts)[self.kept]

    def rows(self, states: np.ndarray, shape_row: int = -1) -> np.ndarray:
        """Data from the states at the rows, (n, m + n_s m)."""
        return self.joined(states[:, : self.m], states[shape_row, self.m :])

    def constant(self, state: np.ndarray) -> np.ndarray:
        """Data of a state that is the same at all rows."""
        return self.rows(np.tile(state, (self.n, 1)))

    @cached_property
    def none(self) -> np.ndarray:
        """Data without effects."""
        return self.constant(self.of.base)

    @cached_property
    def white(self) -> Whitened:
        """The metric: noise, tolerances, the scales of shapes, and damping at rest."""
        f, s, d = self.answer["noise"]
        sd = self.joined(
            np.full((self.n, self.m), f),
            np.full((self.n_s, self.m), s),
            np.full((self.n, self.m), d),
        )
        columns = [self.constant(self.of.base + c) - self.none for c in self.of.nuisances.T]
        zero = np.zeros((self.n, self.m))
        for j in range(self.m):
            one = np.zeros((self.n_s, self.m))
            one[:, j] = self.of.shapes[:, j]
            columns.append(self.joined(zero, one, zero))
            if self.level:
                rest = zero.copy()
                rest[:, j] = _REST
                columns.append(self.joined(zero, 0 * one, rest))
        return Whitened(np.diag(sd**2), np.array(columns).T)

    # -- families --------------------------------------------------------------------------------

    def families(self) -> dict[str, list[Curve]]:
        """Curves of all effects that a single one can be in this test, and of none."""
        found: dict[str, list[Curve]] = {NONE: [Curve(self.none)]}
        for sheet, states in self.of.grids:
            if not (self.level and sheet.name == "lost_contact"):
                found.setdefault(sheet.name, []).extend(self._curves(sheet, states))
        found |= self._sensors() | self._swaps()
        found |= self._levels() if self.level else self._temperature()
        return found

    def _curves(self, sheet: _Sheet, states: np.ndarray) -> list[Curve]:
        by_u = PchipInterpolator(sheet.us, states, axis=0)
        us = np.linspace(*sheet.span, _ALONG)
        lone = len(sheet.vs) == 1
        vs = sheet.vs if lone else np.linspace(sheet.vs[0], sheet.vs[-1], _ACROSS)
        slope = by_u.derivative()
        points, tilts = [], []
        for v in vs:
            power = sheet.power(float(v))
            at = us[:, None] + power * self.ln_torque[None, :]
            at = np.clip(at, sheet.us[0], sheet.us[-1])
            seen, turn = (self._across(sheet, f(at), v, lone) for f in (by_u, slope))
            points.append(np.array([self.rows(rows) for rows in seen]))
            tilts.append([self._scatter(power * _SCATTER * rows) for rows in turn])
        points = np.array(points)
        beside = None if lone else np.gradient(points, axis=0) / 2
        curves = []
        for j in range(len(vs)):
            scatter = np.array(tilts[j][:-1])
            if beside is not None:
                scatter = np.concatenate([scatter, beside[j][:-1, :, None]], axis=2)
            curves.append(Curve(points[j], scatter))
        return curves

    @staticmethod
    def _across(sheet: _Sheet, values: np.ndarray, v: float, lone: bool) -> np.ndarray:
        """Values (k, n, l, .) at the second parameter v, (k, n, .)."""
        return values[:, :, 0] if lone else PchipInterpolator(sheet.vs, values, axis=2)(v)

    def _scatter(self, turn: np.ndarray) -> np.ndarray:
        """Change of the data per standard deviation of each row's preload, (., n), or of all's."""
        zero = np.zeros((self.n, self.m))
        if self.level:
            return self.joined(turn[:, : self.m], turn[-1, self.m :], zero)[:, None]
        columns = []
        for row in range(self.n):
            log_f = zero.copy()
            log_f[row] = turn[row, : self.m]
            shapes = turn[row, self.m :] * (row == self.n - 1)
            columns.append(self.joined(log_f, shapes))
        return np.array(columns).T

    def _sensors(self) -> dict[str, list[Curve]]:
        gains, shifts = [], []
        shapes, log_f = self.of.shapes, np.tile(self.of.base[: self.m], (self.n, 1))
        for i in sorted(set(range(self.n_s)) - set(self.answer["missing"])):
            for sign in (-1, 1):
                rows = [
                    (gains, [shapes[i] * np.exp(sign * g) for g in np.geomspace(0.1, 0.7, 6)]),
                    (
                        shifts,
                        [
                            shapes[i] + sign * d * self.of.slopes[i]
                            for d in np.geomspace(6e-3, 2.4e-2, 4)
                        ],
                    ),
                ]
                for curves, readings in rows:
                    points = []
                    for reading in readings:
                        changed = shapes.copy()
                        changed[i] = reading
                        points.append(self.joined(log_f, changed))
                    curves.append(Curve(np.array(points)))
        return {"sensor_gain": gains, "sensor_place": shifts}

    def _swaps(self) -> dict[str, list[Curve]]:
        curves = []
        rest = np.log(self.answer["spec"]["damping"])
        for j in range(self.m - 1):
            order = np.arange(self.m)
            order[[j, j + 1]] = j + 1, j
            log_f = np.tile(self.of.base[: self.m][order], (self.n, 1))
            damping = np.tile(rest[order], (self.n, 1))
            curves.append(Curve(self.joined(log_f, self.of.shapes, damping)))
        return {"mis_pairing": curves}

    def _temperature(self) -> dict[str, list[Curve]]:
        """All moduli together: frequencies go with their root, shapes stay."""
        place, curves, sides = np.linspace(0, 1, self.n), [], (-1, 1)
        for drift in [s * d for s in sides for d in np.geomspace(9e-4, 0.014, 6)]:
            for side in sides:
                points = []
                for size in np.geomspace(0.003, 0.045, 8):
                    log_f = self.of.base[: self.m] + ((side * size + drift * place) / 2)[:, None]
                    points.append(self.joined(log_f, self.of.shapes))
                curves.append(Curve(np.array(points)))
        return {"temperature": curves}

    def _levels(self) -> dict[str, list[Curve]]:
        """Slip and gapping at this test's forces and damping at rest, which the oracle knows."""
        sizes = {"micro_slip": [{"mu": mu} for mu in (0.15, 0.27, 0.5)], "gapping": [{}]}
        found: dict[str, list[Curve]] = {}
        for name, all_params in sizes.items():
            points = []
            for params in all_params:
                try:
                    points.append(self._at_levels(name, params))
                except RuntimeError:  # no steady state at these forces: the test was not of this
                    self.of.say(f"oracle: {name} at {params} has no steady state")
            if points:
                found[name] = [Curve(np.array(points))]
        return found

    def _at_levels(self, name: str, params: dict) -> np.ndarray:
        own = self.answer["spec"]
        effect = {"name": name, "region": "joint", "params": {"drop": 0.01, **params}}
        return self.specimen([effect], own["damping"], own["levels"])

    def specimen(self, effects, damping, levels) -> np.ndarray:
        """Data of a specimen as drawn with effects of the world, solved."""
        from benchmarks.blind.world import Spec

        row = 0 if self.level else -1
        spec = Spec(
            self.of.geometry,
            self.answer["test"],
            list(effects),
            {},
            [],
            list(damping),
            row,
            list(levels),
        )
        log_f, log_damping, shapes = _clean(spec)
        return self.joined(log_f, self._scaled(shapes), log_damping)

    def _scaled(self, shapes: np.ndarray) -> np.ndarray:
        """Shapes (n_s, m) scaled to be as near as can be to those without effects."""
        there = np.isfinite(shapes)
        given, like = np.where(there, shapes, 0.0), np.where(there, self.of.shapes, 0.0)
        return shapes * np.sum(given * like, axis=0) / np.sum(given**2, axis=0)

    def truth(self) -> np.ndarray:
        """What this case's effects show on the structure as drawn, tightened as it should be."""
        own = self.answer["spec"]
        return self.specimen(own["effects"], own["damping"], own["levels"])

    def measured(self, folder: Path) -> np.ndarray:
        """The noisy data, with modes that the whole test has swapped put right."""
        tables = [
            np.atleast_2d(np.genfromtxt(folder / name, delimiter=",", skip_header=1))[:, 1:]
            for name in ("frequencies.csv", "shapes.csv", "damping.csv")
        ]
        j = self.answer["spec"]["nuisance"].get("whole_swap")
        if j is not None:
            for table in tables:
                table[:, [j, j + 1]] = table[:, [j + 1, j]]
        hz, shapes, damping = tables
        return self.joined(np.log(hz), self._scaled(shapes), np.log(damping / 100))


class Reckoning:
    """D and the oracle's probabilities of cases, kept beside them.

    Args:
        folder: The folder of the check.
        say: Told what is solved.
    """

    def __init__(self, folder: Path, say: Callable[[str], None] = print):
        self.folder, self.say = folder, say
        self._signatures: dict[str, Signatures] = {}

    def __call__(self, name: str, answer: Mapping) -> tuple[float | None, dict[str, float]]:
        """D against all other effects and none (None of a case without effect); probabilities.

        Args:
            name: Id of the case.
            answer: The world's truth of it.
        """
        self.say(f"oracle: case {name}")
        geometry = answer["geometry"]
        of = self._signatures.setdefault(geometry, Signatures(geometry, self.say))
        test = _Test(of, answer)
        families = test.families()
        chances = posterior(test.measured(self.folder / "cases" / name), families, test.white)
        if answer["kind"] == "none":
            return None, chances
        own = {effect["name"] for effect in answer["effects"]}
        rivals = {rival: curves for rival, curves in families.items() if rival not in own}
        try:
            truth = test.truth()
        except RuntimeError:  # it settled with its errors within tolerance, and without does not
            self.say(f"oracle: case {name} has no steady state as drawn, and no D")
            return None, chances
        return separability(truth, rivals, test.white), chances
