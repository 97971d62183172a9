"""Cases of the second world: what is true of each, its folder, and a balanced plan of many."""

from __future__ import annotations

import re
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .effects import EFFECTS, LIBRARY, UNKNOWN, UNKNOWN_OF, draw
from .meshing import mesh_of
from .rigs import RIGS
from .specimen import TOLERANCE, Answer, Spec, clean, pool_of, seen
from .states import States

GEOMETRIES = tuple(RIGS)
SCATTER = 0.15
#: Relative standard deviations of frequencies, and of shapes over their root mean square.
_NOISE, _SHAPE_NOISE = (2e-4, 5e-3), (0.005, 0.10)
_MODES = (4, 12)
#: Numbers of sensors, and whether they are all over or wherever. Few layouts, since a reduced model
#: serves all tests with the same sensors.
_LAYOUTS = ((8, True), (14, True), (24, True), (40, True), (12, False))
#: The geometry of half of the cases, which nothing was developed on; and the share of cases with
#: measured functions.
NEW, _FUNCTIONS = "bracket", 0.125
#: Noise and scales of measured functions, and damping ratios.
_LINE_NOISE, _CALIBRATION, _DAMPING = 0.02, 0.02, (0.002, 0.01)
#: How a careful user meshes, and what he states then; measured by `discrepancy.py`.
CAREFUL = {"bracket": {"size": '"16 mm"', "ring_size": '"8 mm"', "discrepancy": '"1 %"'}}
_KINDS = {"none": 0.20, "single": 0.42, "pair": 0.18, "unknown": 0.20}
#: Causes that only shapes show.
_OF_SHAPES = ("sensor_place", "sensor_gain", "mis_pairing")
_OF_JOINTS = (
    "soft_joint",
    "sliding_joint",
    "small_contact",
    "soft_face",
    "loose_bolt",
    "two_loose_bolts",
)
_NOMINAL = Path(__file__).resolve().parent.parent / "nominal" / "calculix"


# -- one case --------------------------------------------------------------------------------------


def generate(
    geometry: str,
    kind: str,
    effects: list[str] | None,
    seed: int,
    folder: str | Path,
    careful: bool = False,
    functions: bool = False,
) -> dict[str, Any]:
    """Make a case: write its nominal model and noisy data into a folder, and return the truth.

    Args:
        geometry: One of `GEOMETRIES`.
        kind: ``none``, ``single``, ``pair`` or ``unknown``.
        effects: Our names of the effects; None to draw them.
        seed: The same arguments make the same case.
        folder: Where to; made if need be.
        careful: Whether the nominal model is a careful user's.
        functions: Whether functions are measured too.

    Returns:
        Keys as `Truth` of the first world; ``sensors`` are places in the pool.

    Raises:
        ValueError: No such geometry, kind or effect, or effects that do not go with the kind.
        CalculixError: If CalculiX is missing or fails.
    """
    rng = np.random.default_rng([seed, 11])
    names = _names(rng, geometry, kind, effects)
    spec = _specimen(rng, geometry, names)
    spec.careful = careful
    if functions:
        _measure_functions(rng, spec)
    noise = [_log(rng, *_NOISE), _log(rng, *_SHAPE_NOISE)]
    shown = clean(spec)
    _write(Path(folder), rng, spec, noise, shown)
    gap = _gap(spec, shown) if names else 0.0
    return {
        "geometry": geometry,
        "kind": kind,
        "seed": seed,
        "test": "torque",
        "effects": [_named(spec, e, shown) | {"size": gap} for e in spec.effects],
        "final_only": False,
        "noise": noise,
        "conditions": list(spec.torques),
        "gap": gap,
        "spec": asdict(spec),
        "frequencies": shown.frequencies.tolist(),
        "shapes": shown.shapes.tolist(),
        "missing": [],
    }


def _log(rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _names(rng, geometry, kind, effects) -> list[str]:
    if geometry not in RIGS or kind not in _KINDS:
        raise ValueError(f"{geometry!r}, {kind!r}: expected one of {GEOMETRIES} and {list(_KINDS)}")
    known = UNKNOWN_OF[geometry] if kind == "unknown" else EFFECTS[geometry]
    wanted = {"none": 0, "single": 1, "pair": 2, "unknown": 1}[kind]
    if effects is None:
        effects = [str(x) for x in rng.choice(known, size=wanted, replace=False)]
    if len(effects) != wanted or not set(effects) <= set(known):
        raise ValueError(f"{effects}: expected {wanted} of {known} for the kind {kind!r}")
    return list(effects)


def _specimen(rng, geometry: str, names: list[str]) -> Spec:
    """Everything that is drawn about the specimen and its test, noise apart."""
    rig = RIGS[geometry]
    nuisance: dict[str, Any] = {
        key: np.exp(TOLERANCE[key] * rng.standard_normal(len(rig.bodies))).tolist()
        for key in ("E", "rho", "thickness")
    }
    nuisance["heads"] = float(np.exp(TOLERANCE["heads"] * rng.standard_normal()))
    rows = 3 if "temperature" in names or rng.random() < 0.3 else 1
    torques = list(rig.torques)[-rows:]
    sensors = _layout(geometry, *_LAYOUTS[int(rng.integers(len(_LAYOUTS)))])
    shapes = bool(set(names) & set(_OF_SHAPES)) or rng.random() < 0.8
    scatter = np.exp(SCATTER * rng.standard_normal(rows)).tolist()
    effects = [draw(rng, geometry, name) for name in names]
    for effect in effects:
        _of_test(rng, geometry, effect, sensors)
    n_modes = int(rng.integers(_MODES[0], _MODES[1] + 1))
    return Spec(geometry, torques, n_modes, sensors, shapes, effects, nuisance, scatter)


def _measure_functions(rng, spec: Spec) -> None:
    """Two of the sensors are hit, and all answer."""
    spec.forces = sorted(int(i) for i in rng.choice(spec.sensors, size=2, replace=False))
    spec.damping = np.exp(rng.uniform(*np.log(_DAMPING), size=20)).tolist()


def _layout(geometry: str, count: int, all_over: bool) -> list[int]:
    """Places of the pool, whose first ones are far apart."""
    if all_over:
        return list(range(count))
    size = len(pool_of(geometry).sensors)
    chosen = np.random.default_rng(23).choice(size, count, replace=False)
    return sorted(int(i) for i in chosen)


def _of_test(rng, geometry: str, effect: dict, sensors: list[int]) -> None:
    """Causes that hang on the test: which sensor, and what it reads instead."""
    if effect["name"] not in ("sensor_place", "sensor_gain"):
        return
    sensor = int(rng.choice(sensors))
    effect["params"]["sensor"] = sensor
    effect["region"] = f"sensor {sensors.index(sensor) + 1}"
    if effect["name"] == "sensor_place":
        pool, x = pool_of(geometry), mesh_of(geometry).x
        places = x[pool.observed.nodes[pool.sensors]]
        same = pool.normals @ pool.normals[sensor] > 0.98
        away = np.linalg.norm(places - places[sensor], axis=1)
        away[~same | (away < 1e-6)] = np.inf
        effect["params"]["reads"] = int(np.argmin(np.abs(away - effect["params"]["m"])))


def _named(spec: Spec, effect: dict, shown: Answer) -> dict[str, Any]:
    name, params = effect["name"], dict(effect["params"])
    region = effect["region"]
    if name == "two_loose_bolts":
        first, second = params["bolts"]
        region = f"bolt {first + 1}, bolt {second + 1}"
    if name == "mis_pairing":
        j = int(params["share"] * (shown.frequencies.shape[1] - 1)) + 1
        region = f"mode {j}, mode {j + 1}"
    library = LIBRARY[name][0] if name in LIBRARY else "unknown"
    return {"name": name, "library": library, "region": region, "params": params}


def _gap(spec: Spec, shown: Answer) -> float:
    """Root mean square relative change by the effects alone, at the highest torque; without them
    the specimen is the drawing and its tolerances to first order."""
    states, own = States(spec.geometry), spec.nuisance
    log_f = np.log(states.base[0])
    for (key, i), (by_f, _) in states.nuisances.items():
        factor = own["heads"] if key == "heads" else own[key][i]
        log_f = log_f + by_f * np.log(factor) / TOLERANCE[key]
    without = log_f[seen(spec, states.base[1])]
    n = min(len(without), shown.frequencies.shape[1])
    change = np.log(shown.frequencies[-1, :n]) - without[:n]
    return float(np.sqrt(np.mean(change**2)))


# -- files -----------------------------------------------------------------------------------------


def _write(folder: Path, rng, spec: Spec, noise, shown: Answer) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    m = shown.frequencies.shape[1]
    modes = [f"mode {j + 1}" for j in range(m)]
    hz = shown.frequencies * np.exp(noise[0] * rng.standard_normal(shown.frequencies.shape))
    by_torque = len(spec.torques) > 1
    head, first = ("torque [N·m]", spec.torques) if by_torque else (None, [None])
    _table(folder / "frequencies.csv", head, modes, " [Hz]", first, hz, ".9g")
    lines = ['frequencies = "frequencies.csv"', f'noise = "{100 * noise[0]:.3g} %"']
    lines += ['condition = "torque"'] if by_torque else []
    if spec.shapes:
        shapes = shown.shapes + noise[1] * rng.standard_normal(shown.shapes.shape)
        # An analyst scales each shape in his own way.
        shapes = shapes * np.exp(rng.normal(0, 1, m)) * rng.choice([-1, 1], m)
        sensors = range(1, len(spec.sensors) + 1)
        _table(folder / "shapes.csv", "sensor", modes, "", sensors, shapes, ".6g")
        lines += [
            'shapes = "shapes.csv"',
            f'shape_noise = "{100 * noise[1]:.3g} %"',
            "",
            *_sees(spec),
        ]
    if spec.forces:
        lines += ["", *_write_functions(folder, rng, spec, shown)]
    model = CAREFUL[spec.geometry] if spec.careful else {}
    text = nominal_case(spec.geometry, lines, **model)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    copy_drawing(spec.geometry, folder)


def nominal_case(geometry: str, test: list[str], **mesh: str) -> str:
    """The nominal case with a test; the mesh may be given other sizes."""
    text = (_NOMINAL / f"{geometry}.toml").read_text(encoding="utf-8")
    for key, value in mesh.items():
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    return text.replace("${NAMES}", "Some values").replace("${TEST}", "\n".join(test))


def copy_drawing(geometry: str, folder: Path) -> None:
    """The STEP file of the nominal geometry."""
    shutil.copy(_NOMINAL / f"{geometry}.step", folder)


def write_nominal(geometry: str, shown: Answer, folder: Path, careful: bool = False) -> None:
    """A folder with the nominal model and clean data of the structure as drawn."""
    spec = nominal_spec(geometry)
    spec.careful = careful
    _write(folder, np.random.default_rng(0), spec, (1e-9, 1e-9), shown)


def _write_functions(folder: Path, rng, spec: Spec, shown: Answer) -> list[str]:
    """A table of the functions, and what a case says of them."""
    _, n, m = shape = shown.functions.shape
    scale = np.exp(_CALIBRATION * rng.standard_normal(n))[:, None]
    scale = scale * np.exp(_CALIBRATION * rng.standard_normal(m))
    noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    values = shown.functions * scale * (1 + _LINE_NOISE / np.sqrt(2) * noise)
    at = [spec.sensors.index(force) + 1 for force in spec.forces]
    heads, columns = ["frequency [Hz]"], [shown.lines]
    for i in range(n):
        for j in range(m):
            heads += [f"{i + 1}/{at[j]} {part} [m/N]" for part in ("re", "im")]
            columns += [values[:, i, j].real, values[:, i, j].imag]
    rows = np.column_stack(columns)
    lines = [",".join(heads), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
    (folder / "functions.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    places, ways = _of_sensors(spec)
    return [
        "[test.frfs]",
        'files = ["functions.csv"]',
        f'noise = "{100 * _LINE_NOISE:g} %"',
        f'calibration = "{100 * _CALIBRATION:g} %"',
        "points = { " + ", ".join(f"{i + 1} = [{p}]" for i, p in enumerate(places)) + " }",
        "directions = { " + ", ".join(f"{i + 1} = [{w}]" for i, w in enumerate(ways)) + " }",
    ]


def _of_sensors(spec: Spec) -> tuple[list[str], list[str]]:
    """Places and directions of the sensors, as a case writes them."""
    pool = pool_of(spec.geometry)
    x = mesh_of(spec.geometry).x[pool.observed.nodes[pool.sensors[spec.sensors]]].copy()
    if spec.geometry == "flanged_pipe":  # the middle of the wall, which chords of the circle have
        x[:, :2] *= 0.037 / np.hypot(*x[:, :2].T)[:, None]
    n = pool.normals[spec.sensors]
    places = [", ".join(f'"{1e3 * v:.5g} mm"' for v in row) for row in x]
    return places, [", ".join(f"{v + 0:.5g}" for v in np.round(row, 5)) for row in n]


def _sees(spec: Spec) -> list[str]:
    places, ways = _of_sensors(spec)
    return [
        "[test.sees]",
        "points = [",
        *(f"  [{row}]," for row in places),
        "]",
        "directions = [",
        *(f"  [{row}]," for row in ways),
        "]",
    ]


def _table(file: Path, head, modes, unit, first, values, form: str) -> None:
    """A table; without a head for its first column it has none."""
    lines = [",".join([*([head] if head else []), *(mode + unit for mode in modes)])]
    for name, row in zip(first, values, strict=True):
        start = [f"{name:g}"] if head else []
        lines.append(",".join([*start, *(format(value, form) for value in row)]))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def noise_word(noise) -> str:
    """quiet, usual or poor, by the frequencies' noise."""
    return "quiet" if noise[0] < 5e-4 else "usual" if noise[0] < 2e-3 else "poor"


def nominal_spec(geometry: str, n_modes: int = 10, sensors: int = 30) -> Spec:
    """A specimen exactly as drawn, without effects, at the highest torque."""
    return Spec(geometry, [max(RIGS[geometry].torques)], n_modes, list(range(sensors)))


# -- many cases ------------------------------------------------------------------------------------


def plan(n: int, seed: int, final: bool) -> list[tuple[str, str, list[str], int, bool, bool]]:
    """Arguments of `generate` but the folder for n cases, balanced over kinds, geometries and
    effects: half of them of the new geometry, half of these with a careful nominal model.

    Args:
        n: Number of cases.
        seed: Another one gives other cases.
        final: Of no consequence here: nothing is kept back.
    """
    rng = np.random.default_rng([seed, 13])
    others = [g for g in GEOMETRIES if g != NEW]
    counts = {kind: int(round(share * n)) for kind, share in _KINDS.items()}
    counts["single"] += n - sum(counts.values())
    cases, start = [], int(rng.integers(2 * len(others)))
    for kind, count in counts.items():
        decks: dict[str, list[str]] = {g: [] for g in GEOMETRIES}
        for i in range(count):
            half, odd = divmod(start + i, 2)
            geometry = NEW if odd else others[half % len(others)]
            effects = _dealt(rng, decks, geometry, kind)
            careful = geometry in CAREFUL and bool(half % 2)
            functions = bool(rng.random() < _FUNCTIONS)
            cases.append((geometry, kind, effects, int(rng.integers(2**31)), careful, functions))
    return [cases[i] for i in rng.permutation(len(cases))]


def _dealt(rng, decks, geometry, kind) -> list[str]:
    """Effects from a shuffled deck of a geometry, so that each comes equally often."""
    if kind == "none":
        return []
    deck = decks[geometry]
    if not deck:
        names = UNKNOWN_OF[geometry] if kind == "unknown" else EFFECTS[geometry]
        deck += [str(name) for name in rng.permutation(names)]
    first = deck.pop()
    if kind != "pair":
        return [first]
    joint = first in _OF_JOINTS
    others = [
        name for name in EFFECTS[geometry] if name != first and not (joint and name in _OF_JOINTS)
    ]
    return [first, str(rng.choice(others))]


assert set(UNKNOWN).isdisjoint(LIBRARY)
