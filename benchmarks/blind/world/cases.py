"""Blind cases: what is true of each, its noisy data in a folder, and a balanced plan of many."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from .effects import EFFECTS, FINAL_ONLY, LIBRARY, UNKNOWN, draw, number, regions
from .model import Answer, answer, calibrate_levels
from .rigs import RIGS
from .specimen import Spec

GEOMETRIES = tuple(RIGS)
#: Which is for the final check only.
FINAL_GEOMETRY = "lap_beam"
#: Relative standard deviations of frequencies, shapes and damping: quiet, usual, poor.
NOISE = ((2e-4, 0.01, 0.05), (1e-3, 0.05, 0.15), (5e-3, 0.10, 0.40))
_TOLERANCE = {"E": 0.015, "rho": 0.01, "thickness": 0.005, "heads": 0.03, "accelerometer": 0.05}
_PLACE = 5e-3  # m, standard deviation of the accelerometer's place; 2 mm on the short beam
_SCATTER = 0.15
_RATIOS = (1.0, 2.0, 4.0, 8.0)
_BY_LEVEL = ("micro_slip", "gapping")
_DAMPINGS = ("hysteretic", "viscous")
_COMPLIANCES = ("normal_and_tangential", "tangential")
_JOINTS = (*_COMPLIANCES, "graded", "lost_contact", "loose_bolt")
#: What can act on the rows of a torque test only.
_BY_TORQUE = ("lost_contact", "temperature")
_KINDS = {"none": 0.25, "single": 0.40, "pair": 0.20, "unknown": 0.15}
_NOMINAL = Path(__file__).resolve().parent.parent / "nominal"


class Truth(TypedDict):
    """What is true of a case, as plain data; never written into its folder.

    Attributes:
        geometry: Which structure.
        kind: ``none``, ``single``, ``pair`` or ``unknown``.
        seed: Of everything drawn.
        test: ``torque`` or ``level``.
        effects: For each ``name`` (ours, a key of `LIBRARY` or one of `UNKNOWN`), ``library`` (what
            the diagnosis calls it, or ``unknown``), ``region`` (or a list of those that symmetry
            makes the same to these sensors), ``size`` (the gap of all effects together, where each
            is not told apart) and ``params``.
        final_only: Whether its geometry or an effect may occur in the final check only.
        noise: Relative standard deviations of frequencies, shapes and damping.
        conditions: Of the rows.
        gap: Root mean square relative change of the frequencies by the effects alone.
        distances: The same effect in standard deviations of the noise, by kind of data: how far
            the clean data are from those of the same specimen without the effects.
        spec: All that the clean data follow from, see `clean`.
        frequencies: Clean, Hz, (n, m).
        damping: Clean ratios, (n, m).
        shapes: Clean, of unit root mean square, (n_s, m).
        missing: Sensors, from 0, whose cells are empty.
    """

    geometry: str
    kind: str
    seed: int
    test: str
    effects: list[dict[str, Any]]
    final_only: bool
    noise: list[float]
    conditions: list[float]
    gap: float
    distances: dict[str, float]
    spec: dict[str, Any]
    frequencies: list[list[float]]
    damping: list[list[float]]
    shapes: list[list[float]]
    missing: list[int]


# -- one case --------------------------------------------------------------------------------------


def generate(
    geometry: str, kind: str, effects: list[str] | None, seed: int, folder: str | Path
) -> Truth:
    """Make a case: write its nominal model and noisy data into a folder, and return the truth.

    Args:
        geometry: One of `GEOMETRIES`.
        kind: ``none``, ``single``, ``pair`` or ``unknown``.
        effects: Our names of the effects (see `EFFECTS`); None to draw them.
        seed: The same arguments make the same case.
        folder: Where to; made if need be.

    Raises:
        ValueError: No such geometry, kind or effect, or effects that do not go with the kind.
    """
    rng = np.random.default_rng([seed, 5])
    names = _names(rng, geometry, kind, effects)
    spec = _specimen(rng, geometry, names)
    noise = NOISE[int(rng.integers(len(NOISE)))]
    shown = clean(spec)
    without = clean(replace(spec, effects=[])) if names else shown
    missing = _missing(rng, spec)
    conditions = _conditions(spec)
    _write(Path(folder), rng, spec, noise, conditions, shown, missing)
    gap, distances = _distances(shown, without, noise)
    return Truth(
        geometry=geometry,
        kind=kind,
        seed=seed,
        test=spec.test,
        effects=[_named(geometry, e) | {"size": gap} for e in spec.effects],
        final_only=geometry == FINAL_GEOMETRY or not set(names).isdisjoint(FINAL_ONLY),
        noise=list(noise),
        conditions=conditions,
        gap=gap,
        distances=distances,
        spec=asdict(spec),
        frequencies=shown.frequencies.tolist(),
        damping=shown.damping.tolist(),
        shapes=shown.shapes.tolist(),
        missing=missing,
    )


def _names(rng, geometry, kind, effects) -> list[str]:
    if geometry not in RIGS or kind not in _KINDS:
        raise ValueError(f"{geometry!r}, {kind!r}: expected one of {GEOMETRIES} and {list(_KINDS)}")
    if effects is None:
        effects = _drawn(rng, geometry, kind, final=True)
    known = UNKNOWN if kind == "unknown" else EFFECTS[geometry]
    wanted = {"none": 0, "single": 1, "pair": 2, "unknown": 1}[kind]
    if len(effects) != wanted or not set(effects) <= set(known):
        raise ValueError(f"{effects}: expected {wanted} of {known} for the kind {kind!r}")
    return list(effects)


def _specimen(rng, geometry: str, names: list[str]) -> Spec:
    """Everything that is drawn about the specimen and its test, noise apart."""
    rig = RIGS[geometry]
    test = "level" if set(names) & set(_BY_LEVEL) or rng.random() < 0.15 else "torque"
    if set(names) & set(_BY_TORQUE) and not set(names) & set(_BY_LEVEL):
        test = "torque"
    nuisance: dict[str, Any] = {
        key: np.exp(_TOLERANCE[key] * rng.standard_normal(2)).tolist()
        for key in ("E", "rho", "thickness")
    }
    for key in ("heads", "accelerometer"):
        nuisance[key] = float(np.exp(_TOLERANCE[key] * rng.standard_normal()))
    place = _PLACE if geometry != "lap_beam" else 2e-3
    nuisance["place"] = float(np.clip(place * rng.standard_normal(), -2 * place, 2 * place))
    if rng.random() < 0.1 and "mis_pairing" not in names:
        nuisance["whole_swap"] = int(rng.integers(rig.n_modes - 1))
    effects = [draw(rng, geometry, name) for name in names]
    scatter = np.exp(_SCATTER * rng.standard_normal(len(rig.torques))).tolist()
    damping = np.exp(np.log(2.5e-3) + 0.5 * rng.standard_normal(rig.n_modes)).tolist()
    row = -1 if test == "torque" else 0
    spec = Spec(geometry, test, effects, nuisance, scatter, damping, row)
    if test == "torque":
        return spec
    return replace(spec, levels=_levels(rng, spec))


def _levels(rng, spec: Spec) -> list[float]:
    by_level = [e for e in spec.effects if e["name"] in _BY_LEVEL]
    if by_level:
        return calibrate_levels(spec, by_level[0]["params"]["drop"], _RATIOS)
    top = float(f"{np.exp(rng.uniform(np.log(0.5), np.log(50.0))):.2g}")
    return [float(f"{top * ratio / _RATIOS[-1]:.4g}") for ratio in _RATIOS]


def _missing(rng, spec: Spec) -> list[int]:
    """Sensors that gave nothing; not those that a cause is about."""
    n = len(RIGS[spec.geometry].sensors)
    if rng.random() > 0.3:
        return []
    about = {number(e["region"]) for e in spec.effects if e["name"].startswith("sensor_")}
    rest = sorted(set(range(n)) - about)
    return sorted(rng.choice(rest, size=int(rng.integers(1, 4)), replace=False).tolist())


def _conditions(spec: Spec) -> list[float]:
    return list(spec.levels if spec.test == "level" else RIGS[spec.geometry].torques)


def _named(geometry: str, effect: dict) -> dict[str, Any]:
    name, alike = effect["name"], _alike(geometry, effect)
    return {
        "name": name,
        "library": LIBRARY.get(name, "unknown"),
        "region": alike if len(alike) > 1 else alike[0],
        "params": effect["params"],
    }


def _alike(geometry: str, effect: dict) -> list[str]:
    """Bolts side by side are the same to sensors on the middle line."""
    if effect["name"] != "loose_bolt":
        return [effect["region"]]
    x = {f"bolt {bolt.label}": bolt.x for bolt in RIGS[geometry].bolts}
    return [label for label in x if x[label] == x[effect["region"]]]


def _distances(shown: Answer, without: Answer, noise) -> tuple[float, dict[str, float]]:
    change = np.log(shown.frequencies / without.frequencies)
    shapes = without.shapes * np.sign(np.sum(without.shapes * shown.shapes, axis=0))
    moved = {
        "frequencies": change / noise[0],
        "shapes": (shown.shapes - shapes) / noise[1],
        "damping": np.log(shown.damping / without.damping) / noise[2],
    }
    distances = {key: float(np.linalg.norm(value)) for key, value in moved.items()}
    return float(np.sqrt(np.mean(change**2))), distances


# -- files -----------------------------------------------------------------------------------------


def _write(folder: Path, rng, spec, noise, conditions, shown: Answer, missing) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    rig = RIGS[spec.geometry]
    condition, unit = ("level", "N") if spec.test == "level" else ("torque", "N·m")
    text = (_NOMINAL / f"{spec.geometry}.toml").read_text(encoding="utf-8")
    for key, value in {
        "SHAPES_AT": f"{conditions[spec.shapes_row]:g}",
        "CONDITION": condition,
        "NOISE": f"{100 * noise[0]:g} %",
        "SHAPE_NOISE": f"{100 * noise[1]:g} %",
        "DAMPING_NOISE": f"{100 * noise[2]:g} %",
    }.items():
        text = text.replace(f"${{{key}}}", value)
    (folder / "case.toml").write_text(text.replace("${NAMES}", "Some values"), encoding="utf-8")
    modes = [f"bending {j + 1}" for j in range(rig.n_modes)]
    hz = shown.frequencies * np.exp(noise[0] * rng.standard_normal(shown.frequencies.shape))
    damping = shown.damping * np.exp(noise[2] * rng.standard_normal(shown.damping.shape))
    shapes = shown.shapes + noise[1] * rng.standard_normal(shown.shapes.shape)
    # An analyst scales each shape in his own way.
    shapes = shapes * np.exp(rng.normal(0, 1, rig.n_modes)) * rng.choice([-1, 1], rig.n_modes)
    head = f"{condition} [{unit}]"
    _table(folder / "frequencies.csv", head, modes, " [Hz]", conditions, hz, ".9g")
    _table(folder / "damping.csv", head, modes, " [%]", conditions, 100 * damping, ".6g")
    shapes[missing] = np.nan
    sensors = range(1, len(rig.sensors) + 1)
    _table(folder / "shapes.csv", "sensor", modes, "", sensors, shapes, ".6g")


def _table(file: Path, head, modes, unit, first, values, form: str) -> None:
    lines = [",".join([head, *(mode + unit for mode in modes)])]
    for name, row in zip(first, values, strict=True):
        cells = ["" if np.isnan(value) else format(value, form) for value in row]
        lines.append(",".join([f"{name:g}", *cells]))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def noise_word(noise) -> str:
    """quiet, usual or poor."""
    return ("quiet", "usual", "poor")[[tuple(n) for n in NOISE].index(tuple(noise))]


def write_nominal(geometry: str, shown: Answer, folder: Path) -> None:
    """A folder with the nominal model and clean data of the structure as drawn."""
    conditions = [float(t) for t in range(1, len(shown.frequencies) + 1)]
    rng, noise = np.random.default_rng(0), (1e-9, 1e-9, 1e-9)
    _write(folder, rng, nominal_spec(geometry), noise, conditions, shown, [])


# -- for an oracle ---------------------------------------------------------------------------------


def clean(spec: Spec | dict[str, Any]) -> Answer:
    """The data of a specimen without noise; takes `Truth.spec` as it is.

    Args:
        spec: A specimen, or its dict.
    """
    return answer(spec if isinstance(spec, Spec) else Spec(**spec))


def nominal_spec(geometry: str, test: str = "torque", levels=(1.0, 2.0, 4.0, 8.0)) -> Spec:
    """A specimen exactly as drawn, without effects."""
    rig = RIGS[geometry]
    row, forces = (-1, []) if test == "torque" else (0, list(levels))
    return Spec(geometry, test, damping=[2.5e-3] * rig.n_modes, shapes_row=row, levels=forces)


def signature(
    geometry: str,
    effect: str,
    params: dict[str, Any],
    region: str | None = None,
    base: Spec | dict[str, Any] | None = None,
) -> dict[str, np.ndarray]:
    """What an effect of a size does to the clean data of a specimen.

    Args:
        geometry: One of `GEOMETRIES`.
        effect: Our name of it; or a nuisance: ``nuisance.E`` with ``{"body": 0, "factor": 1.01}``
            (also rho and thickness), ``nuisance.heads``, ``nuisance.accelerometer`` with
            ``{"factor": 1.05}``, ``nuisance.place`` with ``{"m": 1e-3}``, ``nuisance.scatter`` with
            ``{"row": 0, "factor": 1.1}``.
        params: Its parameters, as `draw` in `effects` names them.
        region: Where; the only or first region by default.
        base: Specimen it is put into; the nominal one of a torque test by default.

    Returns:
        Changes ``log_frequencies`` (n, m), ``log_damping`` (n, m), ``shapes`` (n_s, m).
    """
    base = nominal_spec(geometry) if base is None else base
    base = base if isinstance(base, Spec) else Spec(**base)
    if effect.startswith("nuisance."):
        changed = _nudged(base, effect.removeprefix("nuisance."), params)
    else:
        where = regions(geometry, effect)[0] if region is None else region
        own = {"name": effect, "region": where, "params": params}
        changed = replace(base, effects=[*base.effects, own])
    a, b = clean(base), clean(changed)
    sign = np.sign(np.sum(a.shapes * b.shapes, axis=0))
    return {
        "log_frequencies": np.log(b.frequencies / a.frequencies),
        "log_damping": np.log(b.damping / a.damping),
        "shapes": b.shapes * sign - a.shapes,
    }


def _nudged(base: Spec, key: str, params: dict[str, Any]) -> Spec:
    own = dict(base.nuisance)
    if key == "scatter":
        scatter = list(base.scatter or [1.0] * len(RIGS[base.geometry].torques))
        scatter[params["row"]] *= params["factor"]
        return replace(base, scatter=scatter)
    if key == "place":
        own[key] = own.get(key, 0.0) + params["m"]
    elif key in ("heads", "accelerometer"):
        own[key] = own.get(key, 1.0) * params["factor"]
    else:
        pair = list(own.get(key, (1.0, 1.0)))
        pair[params["body"]] *= params["factor"]
        own[key] = pair
    return replace(base, nuisance=own)


# -- many cases ------------------------------------------------------------------------------------


def _allowed(geometry: str, final: bool) -> list[str]:
    return [name for name in EFFECTS[geometry] if final or name not in FINAL_ONLY]


def _drawn(rng, geometry: str, kind: str, final: bool) -> list[str]:
    """Effects of a case of a kind."""
    if kind == "none":
        return []
    if kind == "unknown":
        return [str(rng.choice(UNKNOWN))]
    names = _allowed(geometry, final)
    alone = [name for name in names if name not in _DAMPINGS]
    if kind == "single":
        return [str(rng.choice(alone))]
    return _pair(rng, names, str(rng.choice(names)))


def _pair(rng, names: list[str], first: str) -> list[str]:
    """``first`` and another that can stand beside it."""
    if first in _DAMPINGS:
        return [str(rng.choice(_COMPLIANCES)), first]
    others = [n for n in names if n != first and n not in _DAMPINGS]
    if first in _JOINTS:
        others = [n for n in others if n not in _JOINTS]
    if first in _BY_LEVEL:
        others = [n for n in others if n not in (*_BY_LEVEL, *_BY_TORQUE, "loose_bolt")]
    if first in (*_BY_TORQUE, "loose_bolt"):
        others = [n for n in others if n not in _BY_LEVEL]
    return [first, str(rng.choice(others))]


def plan(n: int, seed: int, final: bool) -> list[tuple[str, str, list[str], int]]:
    """Arguments of `generate` for n cases, balanced over kinds, geometries and effects.

    Args:
        n: Number of cases.
        seed: Another one gives other cases.
        final: Whether the lap beam and the effects in `FINAL_ONLY` may occur.
    """
    rng = np.random.default_rng([seed, 7])
    geometries = [g for g in GEOMETRIES if final or g != FINAL_GEOMETRY]
    counts = {kind: int(round(share * n)) for kind, share in _KINDS.items()}
    counts["single"] += n - sum(counts.values())
    cases = []
    for kind, count in counts.items():
        decks: dict[str, list[str]] = {g: [] for g in geometries}
        for i in range(count):
            geometry = geometries[i % len(geometries)]
            effects = _dealt(rng, decks, geometry, kind, final)
            cases.append((geometry, kind, effects, int(rng.integers(2**31))))
    return [cases[i] for i in rng.permutation(len(cases))]


def _dealt(rng, decks, geometry, kind, final) -> list[str]:
    """Effects from a shuffled deck of a geometry, so that each comes equally often."""
    if kind == "none":
        return []
    names = _allowed(geometry, final)
    deck = decks[geometry]
    if not deck:
        full = {"single": [x for x in names if x not in _DAMPINGS], "pair": names}
        deck += rng.permutation(full.get(kind, UNKNOWN)).tolist()
    first = deck.pop()
    return _pair(rng, names, first) if kind == "pair" else [first]
