"""The causes that a case may have: how their size is drawn, and what they do to a test."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .joint import Joint
from .rigs import RIGS, Rig
from .whole import BONDED, Build

#: Names of the causes in the diagnosis' library, by our names. `@` stands for a part's name.
LIBRARY = {
    "normal_and_tangential": "joint normal and tangential compliance",
    "tangential": "joint tangential compliance",
    "graded": "joint compliance that falls with the pressure",
    "lost_contact": "contact lost at low pressure",
    "loose_bolt": "loose bolt",
    "modulus": "modulus error",
    "density": "density error",
    "thickness": "thickness error",
    "width": "width error",
    "accelerometer": "end accelerometer mass",
    "washers": "washers mass",
    "suspension": "suspension stiffness",
    "clamp": "clamp compliance",
    "sensor_place": "sensor misplaced",
    "sensor_gain": "sensor mis-scaled",
    "temperature": "temperature",
    "mis_pairing": "mode mis-pairing",
    "hysteretic": "joint hysteretic damping",
    "viscous": "joint viscous damping",
    "micro_slip": "micro-slip in the joint",
    "gapping": "gapping without slip",
}
UNKNOWN = ("curvature", "crack", "stinger", "taper", "cable")
FINAL_ONLY = ("temperature", "width", "graded")
_JOINTS = ("normal_and_tangential", "tangential", "graded", "lost_contact", "loose_bolt")


def _effects(rig: Rig) -> tuple[str, ...]:
    never = {"suspension"} if rig.clamped else {"clamp"}
    if len(rig.bolts) == 1:
        never |= {"loose_bolt"}
    return tuple(name for name in LIBRARY if name not in never)


#: Causes of each geometry. Damping comes in pairs with a joint's compliance only.
EFFECTS = {name: _effects(rig) for name, rig in RIGS.items()}


@dataclass
class Sensing:
    """What the test does to the data.

    Attributes:
        shifts: Of the sensors along x, m.
        gains: Of the sensors.
        swaps: Pairs of neighbouring modes whose frequencies are in each other's columns.
        E: Factor on every modulus by row: (common, last over first).
        eta: Loss factor of the joint, and that at 1 kHz of one that grows with the frequency.
        slip: Coefficient of friction of a joint that slips with the level, or None.
        opens: Whether it opens with the level.
    """

    shifts: dict[int, float] = field(default_factory=dict)
    gains: dict[int, float] = field(default_factory=dict)
    swaps: list[int] = field(default_factory=list)
    E: tuple[float, float] = (1.0, 1.0)
    eta: float = 0.0
    eta_viscous: float = 0.0
    slip: float | None = None
    opens: bool = False


def regions(geometry: str, name: str) -> list[str]:
    """Where a cause may act, as the nominal case says."""
    rig = RIGS[geometry]
    if name in ("modulus", "density", "thickness", "width"):
        return list(rig.parts)
    if name == "loose_bolt":
        return [f"bolt {bolt.label}" for bolt in rig.bolts]
    if name in ("sensor_place", "sensor_gain"):
        return [f"sensor {i + 1}" for i in range(len(rig.sensors))]
    places = {
        "accelerometer": "end accelerometer",
        "washers": "washers",
        "suspension": "suspension",
        "clamp": "clamp",
        "temperature": "",
        "mis_pairing": "",
    }
    return [places.get(name, "" if name in UNKNOWN else "joint")]


def number(region: str) -> int:
    """Number from 0 of a bolt or sensor, whose names are ``bolt 1`` and so on."""
    return int(region.split()[-1]) - 1


# -- sizes -----------------------------------------------------------------------------------------

#: Joint stiffness per area, Pa/m, from far more than shows to very soft, by geometry.
_SOFT = {"lap_plates": (3e10, 2e12), "c_beam": (3e11, 1e13), "lap_beam": (1e11, 5e12)}


def _log(rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sign(rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def draw(rng: np.random.Generator, geometry: str, name: str) -> dict:
    """A cause of a size drawn from its range: ``{"name", "region", "params"}``."""
    rig = RIGS[geometry]
    region = str(rng.choice(regions(geometry, name)))
    return {"name": name, "region": region, "params": _DRAW[name](rng, rig)}


def _soft(rng, rig):
    return {"k": _log(rng, *_SOFT[rig.name]), "beta": 0.5}


def _both(rng, rig):
    found = _soft(rng, rig)
    return {"k_n": found["k"] * _log(rng, 0.5, 4.0), "k_t": found["k"], "beta": 0.5}


def _end_mass(rng, rig):
    low, high = {"lap_plates": (0.22, 0.31), "c_beam": (0.31, 0.45), "lap_beam": (0.25, 0.395)}[
        rig.name
    ]
    total = {"lap_plates": (4e-3, 0.06), "c_beam": (0.015, 0.15), "lap_beam": (2e-3, 0.02)}
    return {"kg": _log(rng, *total[rig.name]), "x": float(rng.uniform(low, high))}


def _temperature(rng, rig) -> dict:
    """A hall, a chamber or the sun: some ten to eighty kelvin, and a drift during the test."""
    softer = rng.uniform(3e-4, 5.5e-4)
    offset, drift = _sign(rng) * _log(rng, 10, 80), _sign(rng) * _log(rng, 3, 25)
    return {"factor": float(1 - softer * offset), "drift": float(1 - softer * drift)}


_TOTAL = {"lap_plates": 0.86, "c_beam": 2.7, "lap_beam": 0.57}

_DRAW: dict[str, Callable] = {
    "normal_and_tangential": _both,
    "tangential": _soft,
    "graded": lambda rng, rig: {"k": 30 * _soft(rng, rig)["k"], "beta": float(rng.uniform(0.4, 1))},
    "lost_contact": lambda rng, rig: {"share": _log(rng, 0.004, 0.08)},
    "loose_bolt": lambda rng, rig: {"k": _SOFT[rig.name][0] * _log(rng, 0.1, 6.0)},
    "modulus": lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, 0.04, 0.3)))},
    "density": lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, 0.03, 0.2)))},
    "thickness": lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, 0.015, 0.15)))},
    "width": lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, 0.05, 0.35)))},
    "accelerometer": _end_mass,
    "washers": lambda rng, rig: {"kg": _TOTAL[rig.name] * _log(rng, 0.02, 0.15)},
    "suspension": lambda rng, rig: {"N/m": _TOTAL[rig.name] * _log(rng, 5e3, 6e5)},
    "clamp": lambda rng, rig: {"k": _log(rng, 5e12, 1e14)},
    "sensor_place": lambda rng, rig: {"m": _sign(rng) * _log(rng, 6e-3, 2.4e-2)},
    "sensor_gain": lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, 0.1, 0.7)))},
    "temperature": _temperature,
    "mis_pairing": lambda rng, rig: {"mode": int(rng.integers(rig.n_modes - 1))},
    "hysteretic": lambda rng, rig: {"eta": _log(rng, 0.02, 0.3)},
    "viscous": lambda rng, rig: {"eta_1kHz": _log(rng, 0.02, 0.3)},
    "micro_slip": lambda rng, rig: {
        "mu": float(rng.uniform(0.15, 0.5)),
        "drop": _log(rng, 1e-3, 3e-2),
    },
    "gapping": lambda rng, rig: {"drop": _log(rng, 1e-3, 2e-2)},
    "curvature": lambda rng, rig: {
        "body": int(rng.integers(2)),
        "m": 2 * rig.outer * _log(rng, 0.1, 0.4),
    },
    "crack": lambda rng, rig: {
        "body": int(rng.integers(2)),
        "at": float(rng.uniform(0.25, 0.85)),
        "factor": _log(rng, 0.01, 0.2),
        "both": bool(rng.integers(2)),
    },
    "stinger": lambda rng, rig: {
        "sensor": int(rng.integers(len(rig.sensors))),
        "kg": _TOTAL[rig.name] * _log(rng, 0.01, 0.04),
        "N/m": _TOTAL[rig.name]
        * (2 * np.pi * _log(rng, 200.0, 1200.0)) ** 2
        * (0.001 if rig.clamped else 0.05),
    },
    "taper": lambda rng, rig: {
        "body": int(rng.integers(2)),
        "slope": _sign(rng) * _log(rng, 0.03, 0.2),
    },
    "cable": lambda rng, rig: {
        "sensor": int(rng.integers(len(rig.sensors))),
        "kg": _TOTAL[rig.name] * _log(rng, 0.01, 0.04),
        "mode": int(rng.integers(rig.n_modes)),
        "detuned": float(np.exp(rng.normal(0, 0.1))),
    },
}


# -- what they do ----------------------------------------------------------------------------------


def apply(rig: Rig, effect: dict, build: Build, joint: Joint, sensing: Sensing, hz, peak) -> None:
    """Put a cause into the structure, its joint or its test.

    Args:
        rig: The rig.
        effect: From `draw`.
        build: Changed in place.
        joint: Changed in place.
        sensing: Changed in place.
        hz: Frequencies of the nominal structure, for what is tuned to them.
        peak: Largest pressure at the highest torque, Pa.
    """
    name, region, p = effect["name"], effect["region"], effect["params"]
    if name in ("modulus", "density", "thickness", "width"):
        key = {"modulus": "E", "density": "rho"}.get(name, name)
        getattr(build, key)[rig.parts.index(region)] *= p["factor"]
    elif name in _JOINTS:
        _to_joint(rig, name, region, p, joint, peak)
    elif name in UNKNOWN:
        _unknown(rig, name, p, build, hz)
    elif name in ("sensor_place", "sensor_gain", "mis_pairing", "temperature"):
        _to_test(name, region, p, sensing)
    elif name in ("hysteretic", "viscous", "micro_slip", "gapping"):
        _to_dynamics(name, p, sensing)
    else:
        _to_build(rig, name, p, build)


def _to_joint(rig, name, region, p, joint, peak) -> None:
    if name == "tangential":
        joint.uniform.append((np.inf, p["k"], p["beta"]))
    elif name == "normal_and_tangential":
        joint.uniform.append((p["k_n"], p["k_t"], p["beta"]))
    elif name == "graded":
        joint.graded.append((p["k"], p["beta"]))
    elif name == "lost_contact":
        joint.cutoff.append(p["share"] * peak)
    else:
        joint.loose[number(region)] = p["k"]


def _to_test(name, region, p, sensing) -> None:
    if name == "sensor_place":
        sensing.shifts[number(region)] = p["m"]
    elif name == "sensor_gain":
        sensing.gains[number(region)] = p["factor"]
    elif name == "mis_pairing":
        sensing.swaps.append(p["mode"])
    else:
        sensing.E = (p["factor"], p["drift"])


def _to_dynamics(name, p, sensing) -> None:
    if name == "hysteretic":
        sensing.eta = p["eta"]
    elif name == "viscous":
        sensing.eta_viscous = p["eta_1kHz"]
    elif name == "micro_slip":
        sensing.slip = p["mu"]
    else:
        sensing.opens = True


def _to_build(rig, name, p, build) -> None:
    if name == "accelerometer":
        build.masses.append((p["x"], rig.middle, 0 if rig.name == "c_beam" else 1, p["kg"]))
    elif name == "washers":
        build.heads *= 1 + p["kg"] / (rig.head_mass * 2 * len(rig.bolts))
    elif name == "suspension":
        places = ((0.102, 1), (0.406, 1)) if rig.name == "c_beam" else ((0.02, 0), (0.3, 1))
        build.grounds += [(x, rig.middle, body, 2, p["N/m"]) for x, body in places]
    elif name == "clamp":
        build.clamp = 1 / (1 / BONDED + 1 / p["k"])
    else:
        raise ValueError(f"{name!r}: no such cause")


def _unknown(rig, name, p, build, hz) -> None:
    if name == "curvature":
        build.trough[p["body"]] += p["m"]
    elif name == "crack":
        lengths = {"lap_plates": (0.12, 0.2), "c_beam": (0.0, 0.0), "lap_beam": (0.185, 0.235)}
        a, b = lengths[rig.name]
        span = (0.0, rig.length) if not b else ((0.0, a), (b, rig.length))[p["body"]]
        x = span[0] + p["at"] * (span[1] - span[0])
        for side in (-1, 1) if p["both"] else (1,):
            build.notches.append((p["body"], x, 0.008, side, p["factor"]))
    elif name == "taper":
        build.taper[p["body"]] += p["slope"]
    elif name == "stinger":
        x, y, body = rig.sensors[p["sensor"]]
        build.masses.append((x, y, body, p["kg"]))
        build.grounds.append((x, y, body, 2, p["N/m"]))
    else:
        place = rig.sensors[p["sensor"]]
        build.tuned.append((*place, p["kg"], float(hz[p["mode"]] * p["detuned"])))
