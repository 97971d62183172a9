"""Which assumption, not printed in the paper, explains its Tables 2 and 3.

The tables are the test, the contact analysis is the model. Each hypothesis frees one or more
assumptions ("facts" in the code) with the priors below. The priors were written down before any
fit, except that of "k over height", which was added after a first look. Parameters and evidence
come from `diagnosis.evidence`. Rows of the test are the forces, columns the thicknesses; the data
are ln R, or ln R and ln P. P is the mean within the printed radius, so that a wrong radius does not
count twice.

Errors of the test: the printed radii lie on steps that differ from column to column (1.05 mm at
thicknesses of 15, 25 and 30 mm, 0.91 at 20 mm, 0.53 at 35 mm; 10 and 40 mm have no common step, and
their smallest differences, 0.62 and 1.34 mm, are used). The error of a radius is its step over
sqrt(12). Pressures are known to 0.005 MPa. In addition, every cell has an independent error s / 2,
and every column an error of scale s that changes slowly with the force. s is common to all cells,
and integrated over 0.3 to 50 % with a uniform prior in ln s. A hypothesis that needs a large s does
not explain the table; "nothing missing" with a large s means "none of these".

Run: python3 investigate.py TABLES.npz [RESULT.json]. If the first file does not exist, the script
makes it by about 4500 small contact analyses (a quarter of an hour).
"""

from __future__ import annotations

import csv
import json
import sys
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from responses import (
    FAMILIES,
    HOLE,
    LEVELS,
    LOADED,
    PENALTY,
    RATIO,
    RIM,
    compute,
    curves,
    load,
    solution,
)
from rich.console import Console
from rich.table import Table as RichTable
from scipy.special import logsumexp

from fenics_joints.diagnosis import Effect, Prior
from fenics_joints.diagnosis.evidence import (
    Evidence,
    Fit,
    Hypothesis,
    PointwiseForward,
    fit,
    model_of,
)

P_LIM = 1e6
STEPS = np.array([0.62, 1.053, 0.911, 1.053, 1.053, 0.527, 1.34]) * 1e-3
SCALES = np.geomspace(0.003, 0.5, 11)
#: Scale at which the misfit is tested: the difference expected between two contact programs.
PLAIN = 0.03


def paper() -> tuple[np.ndarray, ...]:
    """Forces, N, thicknesses, m, and Tables 2 and 3, m and Pa, (n_forces, n_thicknesses)."""
    with resources.files("fenics_joints.database").joinpath("seed000.csv").open() as lines:
        rows = [r for r in csv.DictReader(lines) if r["force [N]"] and r["thickness [m]"]]
    value = {(float(r["force [N]"]), float(r["thickness [m]"])): r for r in rows if r["radius [m]"]}
    forces, thicknesses = (np.unique([k[i] for k in value]) for i in (0, 1))

    def column(name: str) -> np.ndarray:
        return np.array([[float(value[f, t][name]) for t in thicknesses] for f in forces])

    return forces, thicknesses, column("radius [m]"), column("pressure [Pa]")


FORCES, THICKNESSES, RADIUS, PRESSURE = paper()
AREA = np.pi * (RADIUS**2 - HOLE**2)

NOMINAL = {
    "force": 1.0,
    "force factor": 1.0,
    "P_lim factor": 1.0,
    "reading": 1.0,
    "thickness": 1.0,
    "loaded": 12e-3,
    "penalty": PENALTY[-1],
    "rim": RIM[-1],
    "ratio": 1.0,
    "second": np.nan,
    "washer": 12e-3,
    "washer_t": 2.5e-3,
    "crown": 1.0,
    "cell": 1e-3,
    "nu": 0.3,
    "power": 0.0,
}


def _set(values, theta, condition) -> None:
    values.update(theta)


def _by_height(values, theta, condition) -> None:
    values.update(theta, power=1.0)


def effect(name: str, *priors: Prior) -> Effect:
    return Effect(name, "", priors, _set)


#: Assumptions with their priors: median, standard deviation of the logarithm, unit, grid limits.
FACTS = {
    e.name: e
    for e in (
        effect("loaded radius", Prior("loaded", 12e-3, 0.4, "m", True, (LOADED[0], LOADED[-1]))),
        effect("thickness factor", Prior("thickness", 1.0, np.log(2), "", True, (0.5, 2.5))),
        effect(
            "soft contact",
            Prior("penalty", 1e13, np.log(10), "Pa/m", True, (PENALTY[0], PENALTY[-1])),
        ),
        # As programs set it: k = factor x E / element height, with a fixed number per thickness.
        Effect(
            "soft contact, k over height",
            "",
            (Prior("penalty", 1e13, np.log(10), "Pa/m", True, (PENALTY[0], PENALTY[-1])),),
            _by_height,
        ),
        effect("finite plates", Prior("rim", 75e-3, 0.5, "m", True, (RIM[0], RIM[-1]))),
        effect(
            "second plate scaled", Prior("ratio", 1.0, np.log(2), "", True, (RATIO[0], RATIO[-1]))
        ),
        effect("second plate fixed", Prior("second", 20e-3, np.log(2), "m", True, (8e-3, 50e-3))),
        effect(
            "washer as a body",
            Prior("washer", 15e-3, 0.4, "m", True, (12e-3, 40e-3)),
            Prior("washer_t", 3e-3, np.log(2), "m", True, (1.25e-3, 20e-3)),
        ),
        # The logarithm of this parameter runs along the axis CROWN: see `places`.
        effect("crowned plates", Prior("crown", 1.0, 1.0, "", True, (np.exp(-3.9), np.exp(3.9)))),
        effect("coarse mesh", Prior("cell", 2e-3, np.log(2), "m", True, (0.5e-3, 8e-3))),
        effect("Poisson's ratio", Prior("nu", 0.28, 0.15, "", True, (0.1, 0.4))),
        effect("P_lim in effect", Prior("P_lim factor", 1.0, 0.5, "", True, (0.3, 3.0))),
        effect("force in effect", Prior("force factor", 1.0, 0.5, "", True, (0.33, 3.0))),
        effect("reading off by part of a cell", Prior("reading", 1.0, 1.0, "", True, (0.05, 20))),
    )
}


class Forward(PointwiseForward):
    """Row of ln R, and ln P, at the seven thicknesses; derivatives by central differences."""

    def __init__(self, table, free: tuple[str, ...], both: bool):
        self.table, self.both = table, both
        self.model = model_of(free)

    def __call__(self, values: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        step, slopes = 1e-4, []
        for name in self.model.parameters:
            up, down = (self.row(values | {name: values[name] * (1 + d)}) for d in (step, -step))
            slopes.append((up - down) / (2 * step * values[name]))
        row = self.row(values)
        return row, np.array(slopes).T.reshape(len(row), len(slopes))

    def row(self, v: dict[str, float]) -> np.ndarray:
        force = v["force"] * v["force factor"]
        at = places(self.table.axes, v)
        radius, _ = self.table(P_LIM * v["P_lim factor"] / force, **at)
        # Readings at a neighbouring node or edge: an offset in steps of the paper's mesh.
        radius = np.log(np.exp(radius) + np.log(v["reading"]) * STEPS)
        if not self.both:
            return radius
        curve = self.table(LEVELS[::-1, None], **at)
        row = int(np.argmin(np.abs(FORCES - v["force"])))
        printed = np.log(RADIUS[row])
        share = [
            np.interp(x, r, s) for x, r, s in zip(printed, *np.swapaxes(curve, 1, 2), strict=True)
        ]
        return np.concatenate([radius, share + np.log(force / AREA[row])])


def places(axes, v: dict[str, float]) -> dict[str, np.ndarray]:
    """Values of a table's parameters, at the seven thicknesses."""
    t = THICKNESSES * v["thickness"]
    found = {n: np.full(7, t if n == "t" else v[n]) for n in axes}
    if "penalty" in found:
        found["penalty"] = v["penalty"] * (20e-3 / THICKNESSES) ** v["power"]
    if np.isfinite(v["second"]):
        found["ratio"] = v["second"] / t
    if "crown" in found:  # the axis is the arsinh of the crown over the force
        slope = np.sinh(np.log(v["crown"])) * 25e3 / v["force"] / v["force factor"]
        found["crown"] = np.full(7, np.arcsinh(slope))
    return found


def direct(w: Weighed) -> dict[str, float]:
    """Rms relative errors of the best fit, solved at its parameters instead of interpolated.

    Returns:
        radius: error of R.
        pressure: error of the mean pressure within our radius.
        within: the same within the printed radius.
        hole: within the printed radius, as force over pi R^2 (the hole counts as area).
        line: within the printed radius, as the mean over points evenly spaced along the radius.
    """
    family, h = w.candidate.family, w.best.hypothesis
    errors = {n: [] for n in ("radius", "pressure", "within", "hole", "line")}
    for i, force in enumerate(FORCES):
        v = h.values(w.best.z, force, NOMINAL)
        at = places(FAMILIES[family], v)
        for j in range(7):
            key = family, tuple(float(at[n][j]) for n in at)
            if key not in _SOLVED:
                _SOLVED[key] = solution(family, dict(zip(at, key[1], strict=True)))
            profile, loaded = _SOLVED[key], force * v["force factor"]
            (radius,), (share,) = curves(*profile, np.array([P_LIM * v["P_lim factor"] / loaded]))
            inside = force_within(*profile, RADIUS[i, j]) * loaded
            found = (
                radius,
                share * loaded / np.pi / (radius**2 - HOLE**2),
                inside / AREA[i, j],
                inside / np.pi / RADIUS[i, j] ** 2,
                loaded * np.interp(np.linspace(HOLE, RADIUS[i, j], 400), *profile).mean(),
            )
            for name, value in zip(errors, found, strict=True):
                printed = RADIUS if name == "radius" else PRESSURE
                errors[name].append(np.log(value / printed[i, j]))
    return {n: float(np.sqrt(np.mean(np.square(e)))) for n, e in errors.items()}


def force_within(r: np.ndarray, p: np.ndarray, radius: float) -> float:
    """Force within a radius; the pressure is linear between its points."""
    x = np.linspace(r[0], radius, 4000)
    q = np.interp(x, r, p, right=0.0)
    return float(np.sum(np.pi * np.diff(x**2) * (q[1:] + q[:-1]) / 2))


_SOLVED: dict = {}


@dataclass(frozen=True)
class Candidate:
    """A hypothesis with the table of responses that it needs."""

    name: str
    facts: tuple[str, ...]
    family: str

    def hypothesis(self) -> Hypothesis:
        def put_force(values, theta, condition):
            values["force"] = condition

        at = Effect("force", "", (), put_force, depends_on_condition=True)
        return Hypothesis((*(FACTS[f] for f in self.facts), at), name=self.name)

    def forward(self, tables, both: bool) -> Forward:
        free = tuple(p.name for f in self.facts for p in FACTS[f].priors)
        return Forward(tables[self.family], free, both)


_NEEDS = {
    "loaded radius": "loaded",
    "soft contact": "penalty",
    "soft contact, k over height": "penalty",
    "finite plates": "rim",
    "second plate scaled": "ratio",
    "second plate fixed": "ratio",
    "washer as a body": "washer",
    "crowned plates": "crown",
    "coarse mesh": "cell",
    "Poisson's ratio": "nu",
}


#: Assumptions that are not combined with each other; and assumptions that are only tried alone.
_ALONE = (
    {"second plate scaled", "second plate fixed"},
    {"P_lim in effect", "force in effect"},
    {"soft contact", "soft contact, k over height"},
)
_MINOR = {"coarse mesh", "Poisson's ratio", "reading off by part of a cell"}


def candidates(tables) -> list[Candidate]:
    """No change, loads by bodies, each assumption, and the pairs and some triples with a grid."""
    found = [Candidate("nothing missing", (), "loaded, penalty")]
    found += [Candidate(f"bodies: {f}", (), f) for f in tables if f.startswith(("washers", "bolt"))]
    names = list(FACTS)
    sets = [(a,) for a in names] + [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    soft = "soft contact, k over height"
    sets += [
        ("loaded radius", "thickness factor", soft),
        ("thickness factor", soft, "finite plates"),
        ("loaded radius", soft, "force in effect"),
        ("finite plates", soft, "force in effect"),
        ("loaded radius", "thickness factor", "soft contact"),
        ("loaded radius", "thickness factor", "finite plates"),
        ("loaded radius", "thickness factor", "P_lim in effect"),
        ("loaded radius", "thickness factor", "force in effect"),
        ("loaded radius", "soft contact", "force in effect"),
        ("loaded radius", "soft contact", "P_lim in effect"),
        ("thickness factor", "soft contact", "finite plates"),
        ("thickness factor", "soft contact", "force in effect"),
    ]
    for facts in sets:
        axes = {_NEEDS[f] for f in facts if f in _NEEDS}
        if len(facts) > 1 and (any(pair <= set(facts) for pair in _ALONE) or _MINOR & set(facts)):
            continue
        family = next((n for n in tables if axes <= set(FAMILIES[n])), None)
        if family:
            found.append(Candidate(" + ".join(facts), facts, family))
    return found


def evidence(scale: float, both: bool) -> Evidence:
    """The paper's tables with their errors at a scale of the discrepancy."""
    step = STEPS / np.sqrt(12) / RADIUS
    sds = [step]
    logs = [np.log(RADIUS)]
    if both:
        sds.append(0.005e6 / PRESSURE)
        logs.append(np.log(PRESSURE))
    sd = np.hypot(np.hstack(sds), scale / 2)
    return Evidence(FORCES, np.hstack(logs), sd, scale)


@dataclass(frozen=True)
class Weighed:
    """A candidate after all fits."""

    candidate: Candidate
    best: Fit
    scale: float
    log_evidence: float
    p_plain: float
    held_out: dict[str, float]

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean square relative errors of radii and of pressures."""
        error = self.best.log_f - evidence(1.0, self.best.log_f.shape[1] > 7).log_f
        parts = error[:, :7], error[:, 7:]
        return tuple(float(np.sqrt(np.mean(e**2))) if e.size else np.nan for e in parts)


def weigh(candidate: Candidate, tables, both: bool) -> Weighed:
    """Fit at each scale of the discrepancy, sum the evidence, hold out each row and column."""
    h, forward = candidate.hypothesis(), candidate.forward(tables, both)
    fits = [fit(h, forward, evidence(scale, both), NOMINAL) for scale in SCALES[::-1]]
    logs = np.array([f.log_evidence for f in fits])
    best, scale = fits[int(logs.argmax())], float(SCALES[::-1][logs.argmax()])
    plain = fit(h, forward, evidence(PLAIN, both), NOMINAL)
    return Weighed(
        candidate,
        best,
        scale,
        float(logsumexp(logs) - np.log(len(logs))),
        plain.p_value,
        held_out(h, forward, scale, both),
    )


def held_out(h, forward, scale: float, both: bool) -> dict[str, float]:
    """Root mean square relative error of held-out radii, by thickness and by force."""
    whole, errors = evidence(scale, both), {}
    for name, n, axis in (("thickness", 7, 1), ("force", 5, 0)):
        squares = []
        for i in range(n):
            mask = np.zeros((5, 14 if both else 7), dtype=bool)
            mask[(slice(None), slice(i, None, 7)) if axis else i] = True
            part = fit(h, forward, whole.without(mask), NOMINAL)
            off = (part.log_f - whole.log_f)[:, :7][mask[:, :7]]
            squares.append(off**2)
        errors[name] = float(np.sqrt(np.mean(np.concatenate(squares))))
    return errors


def show(title: str, weighed: list[Weighed], n: int) -> None:
    table = RichTable(title=title, title_justify="left")
    for head in ("facts", "fitted", "rms R %", "rms P %", "s %", "ln Z", "held out t, F %", "p"):
        table.add_column(head, overflow="fold")
    top = weighed[0].log_evidence
    for w in weighed[:n]:
        radius, pressure = (f"{100 * e:.1f}" for e in w.rms)
        table.add_row(
            w.candidate.name,
            fitted(w),
            radius,
            pressure,
            f"{100 * w.scale:.1f}",
            f"{w.log_evidence - top:+.1f}",
            f"{100 * w.held_out['thickness']:.1f}, {100 * w.held_out['force']:.1f}",
            f"{w.p_plain:.1g}",
        )
    Console(width=150).print(table)


def fitted(w: Weighed) -> str:
    """Fitted parameters as text."""
    rows = w.best.hypothesis.table(w.best.z, w.best.covariance)
    texts = []
    for r in rows:
        value, low, high = (f"{r[key]:.3g}" for key in ("value", "low", "high"))
        limit = " at limit" if any(r["name"] in bound for bound in w.best.at_bound) else ""
        texts.append(f"{r['name']} {value} ({low}-{high}) {r['unit']}{limit}".rstrip())
    return ", ".join(texts)


def main() -> None:
    file = Path(sys.argv[1])
    compute(file)
    tables = load(file)
    result = {}
    chosen = candidates(tables)
    for both in (False, True):
        weighed = [weigh(c, tables, both) for c in chosen]
        weighed.sort(key=lambda w: -w.log_evidence)
        title = "radii and pressures" if both else "radii alone"
        show(title, weighed, len(weighed))
        for w in weighed[:6]:
            errors = ", ".join(f"{n} {100 * e:.1f} %" for n, e in direct(w).items())
            print(f"solved at its parameters, {w.candidate.name}: {errors}", flush=True)
        result[title] = [
            {
                "facts": w.candidate.name,
                "fitted": fitted(w),
                "rms": w.rms,
                "scale": w.scale,
                "log_evidence": w.log_evidence,
                "held_out": w.held_out,
                "p": w.p_plain,
                "log_f": w.best.log_f.tolist(),
            }
            for w in weighed
        ]
        # Pressures cost more: use single assumptions and the 20 best hypotheses by the radii.
        chosen = [
            w.candidate for i, w in enumerate(weighed) if i < 20 or len(w.candidate.facts) < 2
        ]
    if len(sys.argv) > 2:
        Path(sys.argv[2]).write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
