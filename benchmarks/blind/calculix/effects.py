"""The causes of the second world: their sizes, where they act, and what they do to a specimen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .build import Build
from .rigs import RIGS, Rig

#: What the diagnosis calls the causes that its library has, by our names; patterns.
LIBRARY: dict[str, tuple[str, ...]] = {
    "soft_joint": (
        "joint normal and tangential compliance",
        "joint compliance that falls with the pressure",
        "joint compliance graded from zone to zone",
    ),
    "sliding_joint": (
        "joint tangential compliance",
        "joint tangential compliance that falls with the pressure",
    ),
    "small_contact": (
        "contact area smaller than modelled",
        "contact lost at low pressure",
        "compliance away from the bolts only",
    ),
    "loose_bolt": ("loose bolt", "compliance at one bolt", "compliance at one joint"),
    "two_loose_bolts": ("two loose bolts",),
    "soft_face": ("compliance at one joint", "joint compliance graded from joint to joint"),
    "modulus": ("modulus error",),
    "shear_modulus": ("shear modulus error",),
    "density": ("density error",),
    "thickness": ("thickness error",),
    "harness": ("harness mass", "cable or stinger"),
    "bolts": ("bolts mass", "mass error"),
    "stinger": ("cable or stinger",),
    "resonator": ("attached resonator",),
    "local_loss": ("local loss of stiffness",),
    "taper": ("thickness not even",),
    "temperature": ("temperature",),
    "sensor_place": ("sensor misplaced",),
    "sensor_gain": ("sensor mis scaled",),
    "mis_pairing": ("mode mis pairing",),
}
#: Kinds that the library does not have.
UNKNOWN = (
    "rolled",
    "oval",
    "bent",
    "leaning",
    "lining",
    "partly_filled",
    "gasket",
    "shifted_holes",
    "holes",
    "hard_spot",
    "residual_stress",
)
#: N/m per m2, from what hardly shows to soft, and of a bolt that does not press.
_SOFT, _LOOSE = (3e11, 1.5e13), (1e8, 1e11)
#: Where the harness may hang, as the nominal case says it too.
HARNESS = {
    "t_tubes": (0.0, 0.02, 0.3),
    "flanged_pipe": (0.0, 0.04, 0.1),
    "screw_box": (0.06, 0.03, 0.081),
    "bracket": (-0.05, 0.02, 0.15),
}
#: kg of the whole.
MASS = {"t_tubes": 2.76, "flanged_pipe": 4.96, "screw_box": 2.9, "bracket": 6.2}


def _unknown(rig: Rig) -> tuple[str, ...]:
    """Plates are not oval, tubes have no face to be hot in the middle of."""
    never = {"residual_stress"}
    if rig.name == "screw_box":
        never = {"oval", "leaning", "partly_filled"}
    elif not any(body.hollow for body in rig.bodies):
        never |= {"oval", "partly_filled"}
    return tuple(name for name in UNKNOWN if name not in never)


def _effects(rig: Rig) -> tuple[str, ...]:
    plates = rig.name == "screw_box"
    never = {"taper", "thickness"} if not plates else set()
    if len(rig.interfaces) == 1:
        never |= {"soft_face"}
    return tuple(name for name in LIBRARY if name not in never)


EFFECTS = {name: _effects(rig) for name, rig in RIGS.items()}
UNKNOWN_OF = {name: _unknown(rig) for name, rig in RIGS.items()}


def regions(geometry: str, name: str) -> list[str]:
    """Where a cause may act, as the nominal case says; bolts count from 1."""
    rig = RIGS[geometry]
    if name in ("modulus", "shear_modulus", "density", "thickness"):
        return [body.name for body in rig.bodies]
    if name == "taper":
        return ["base", "lid"]
    if name == "loose_bolt":
        return [f"bolt {i + 1}" for i in range(len(rig.bolts))]
    if name == "soft_face":
        return [f"joint {i + 1}" for i in range(len(rig.interfaces))]
    return ["joint" if name in ("soft_joint", "sliding_joint", "small_contact") else ""]


def touching(geometry: str, region: str) -> tuple[str, ...]:
    """The two bodies of "joint 3", counted from 1, of several; none for any other region."""
    faces = RIGS[geometry].interfaces
    number = region.removeprefix("joint ")
    if len(faces) == 1 or not number.isdigit():
        return ()
    return tuple(RIGS[geometry].bodies[i].name for i in faces[int(number) - 1].bodies)


# -- sizes -----------------------------------------------------------------------------------------


def _log(rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _sign(rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _factor(low: float, high: float) -> Callable:
    return lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, low, high)))}


def _somewhere(rng, rig: Rig) -> list[float]:
    """A place on the outside, away from the bolts: a node of the mesh."""
    from .meshing import mesh_of

    mesh = mesh_of(rig.name)
    surface = np.unique(np.concatenate([f.ravel() for f in mesh.faces]))
    away = np.min(
        [np.linalg.norm(mesh.x[surface] - np.array(b), axis=1) for b in rig.bolts], axis=0
    )
    chosen = surface[away > 3 * rig.pad]
    return mesh.x[chosen[int(rng.integers(len(chosen)))]].tolist()


def _place(key: str, low: float, high: float) -> Callable:
    return lambda rng, rig: {"at": _somewhere(rng, rig), key: MASS[rig.name] * _log(rng, low, high)}


def _two(rng, rig) -> dict:
    chosen = rng.choice(len(rig.bolts), size=2, replace=False)
    return {"bolts": sorted(int(i) for i in chosen), "k": _log(rng, *_LOOSE)}


def _body(key: str, draw: Callable) -> Callable:
    return lambda rng, rig: {"body": int(rng.integers(len(rig.bodies))), key: draw(rng)}


_DRAW: dict[str, Callable] = {
    "soft_joint": lambda rng, rig: {"k": _log(rng, *_SOFT), "beta": float(rng.uniform(0.3, 0.8))},
    "sliding_joint": lambda rng, rig: {
        "k": _log(rng, _SOFT[0] / 3, _SOFT[1] / 3),
        "beta": float(rng.uniform(0.3, 0.8)),
    },
    "small_contact": lambda rng, rig: {"factor": float(rng.uniform(0.35, 0.75))},
    "loose_bolt": lambda rng, rig: {"k": _log(rng, *_LOOSE)},
    "two_loose_bolts": _two,
    "soft_face": lambda rng, rig: {"k": _log(rng, *_SOFT), "beta": float(rng.uniform(0.3, 0.8))},
    "modulus": _factor(0.04, 0.25),
    "shear_modulus": _factor(0.05, 0.15),
    "density": _factor(0.03, 0.2),
    "thickness": _factor(0.03, 0.15),
    "harness": lambda rng, rig: {"kg": MASS[rig.name] * _log(rng, 0.01, 0.08)},
    "bolts": lambda rng, rig: {"factor": _log(rng, 1.5, 5.0)},
    "stinger": lambda rng, rig: {
        **_place("kg", 0.003, 0.02)(rng, rig),
        "k": _log(rng, 1e5, 3e6),
        "axis": int(rng.integers(3)),
    },
    "resonator": lambda rng, rig: {
        **_place("kg", 0.005, 0.04)(rng, rig),
        "mode": int(rng.integers(5)),
        "detuned": float(np.exp(rng.normal(0, 0.15))),
    },
    "local_loss": lambda rng, rig: {
        "at": _somewhere(rng, rig),
        "radius": _log(rng, 0.012, 0.03),
        "factor": _log(rng, 0.02, 0.3),
    },
    "taper": lambda rng, rig: {"slope": _sign(rng) * _log(rng, 0.05, 0.3)},
    "temperature": lambda rng, rig: {
        "factor": float(np.exp(_sign(rng) * _log(rng, 0.005, 0.03))),
        "drift": float(_sign(rng) * _log(rng, 0.001, 0.01)),
    },
    "sensor_place": lambda rng, rig: {"m": _log(rng, 0.008, 0.03)},
    "sensor_gain": lambda rng, rig: {"factor": float(np.exp(_sign(rng) * _log(rng, 0.15, 0.7)))},
    "mis_pairing": lambda rng, rig: {"share": float(rng.uniform())},
    # -- kinds that the library does not have --
    "rolled": _body("factor", lambda rng: float(np.exp(_sign(rng) * _log(rng, 0.08, 0.3)))),
    "oval": _body("share", lambda rng: _sign(rng) * _log(rng, 0.02, 0.08)),
    "bent": _body("m", lambda rng: _sign(rng) * _log(rng, 0.003, 0.015)),
    "leaning": _body("rad", lambda rng: _sign(rng) * _log(rng, 0.02, 0.08)),
    "lining": lambda rng, rig: {
        "body": int(rng.integers(len(rig.bodies))),
        "kg": MASS[rig.name] * _log(rng, 0.03, 0.15),
        "low": 0.0,
        "high": float(rng.uniform(0.3, 0.7)),
    },
    "partly_filled": lambda rng, rig: {
        "body": int(rng.integers(len(rig.bodies))),
        "kg": MASS[rig.name] * _log(rng, 0.05, 0.25),
        "low": float(rng.uniform(0.4, 0.7)),
        "high": 1.0,
    },
    "gasket": lambda rng, rig: {"k_n": _log(rng, 1e11, 3e12), "ratio": _log(rng, 0.05, 0.3)},
    "shifted_holes": lambda rng, rig: {
        "x": _sign(rng) * _log(rng, 0.002, 0.006) * (1 if rig.name != "flanged_pipe" else 0.5),
        "y": 0.0 if rig.name == "screw_box" else _sign(rng) * _log(rng, 0.001, 0.004),
    },
    "holes": lambda rng, rig: {
        "at": [_somewhere(rng, rig) for _ in range(int(rng.integers(3, 7)))],
        "radius": _log(rng, 0.009, 0.014),
    },
    "hard_spot": lambda rng, rig: {
        "at": _somewhere(rng, rig),
        "radius": _log(rng, 0.03, 0.06),
        "factor": _log(rng, 1.6, 4.0),
    },
    "residual_stress": lambda rng, rig: {
        "body": int(rng.choice([0, 3])),
        "strain": _sign(rng) * _log(rng, 1e-3, 4e-3),
    },
}


def draw(rng: np.random.Generator, geometry: str, name: str) -> dict:
    """A cause of a size drawn from its range: ``{"name", "region", "params"}``."""
    region = str(rng.choice(regions(geometry, name)))
    return {"name": name, "region": region, "params": _DRAW[name](rng, RIGS[geometry])}


# -- what they do ----------------------------------------------------------------------------------


def apply(rig: Rig, effect: dict, build: Build, hz) -> None:
    """Put a cause into a specimen; those of the test alone are in `cases`.

    Args:
        rig: The rig.
        effect: From `draw`.
        build: Changed in place.
        hz: Elastic frequencies as drawn, Hz.
    """
    name, p = effect["name"], effect["params"]
    bodies = {body.name: i for i, body in enumerate(rig.bodies)}
    if name in _MATERIAL:
        own = getattr(build, _MATERIAL[name])
        number = bodies[effect["region"]]
        own[number] = own.get(number, 1.0) * p["factor"]
    elif name in _JOINT:
        _JOINT[name](build.joint, p, effect["region"])
    elif name in _BY_BODY:
        key, value = _BY_BODY[name]
        getattr(build, key)[p["body"]] = p[value]
    elif name in _ELSE:
        _ELSE[name](rig, build, p, hz)
    elif name == "taper":
        build.taper[bodies[effect["region"]]] = p["slope"]


_MATERIAL = {"modulus": "E", "shear_modulus": "G", "density": "rho", "thickness": "thickness"}
_BY_BODY = {
    "rolled": ("rolled", "factor"),
    "oval": ("oval", "share"),
    "bent": ("bow", "m"),
    "leaning": ("lean", "rad"),
    "residual_stress": ("warm", "strain"),
}


def _soft(joint, p, region) -> None:
    joint.k_n, joint.k_t, joint.beta = p["k"], p["k"], p["beta"]


def _sliding(joint, p, region) -> None:
    joint.k_t, joint.beta = p["k"], p["beta"]


def _soft_face(joint, p, region) -> None:
    _soft(joint, p, region)
    joint.faces = [int(region.split()[-1]) - 1]


def _small(joint, p, region) -> None:
    joint.radius = p["factor"]


def _loose(joint, p, region) -> None:
    joint.loose += p.get("bolts", [int(region.split()[-1]) - 1] if region else [])
    joint.rest = p["k"]


def _gasket(joint, p, region) -> None:
    joint.gasket, joint.gasket_mass = (p["k_n"], p["k_n"] * p["ratio"]), 2.5


def _shifted(joint, p, region) -> None:
    joint.shift = (p["x"], p["y"])


_JOINT = {
    "soft_joint": _soft,
    "sliding_joint": _sliding,
    "soft_face": _soft_face,
    "small_contact": _small,
    "loose_bolt": _loose,
    "two_loose_bolts": _loose,
    "gasket": _gasket,
    "shifted_holes": _shifted,
}


def _stinger(rig, build, p, hz) -> None:
    build.masses.append((p["at"], p["kg"]))
    build.springs.append((p["at"], p["axis"], p["k"]))


def _resonator(rig, build, p, hz) -> None:
    build.tuned.append((p["at"], p["kg"], float(hz[p["mode"]] * p["detuned"])))


def _lining(rig, build, p, hz) -> None:
    build.lining.append((p["body"], p["kg"], p["low"], p["high"]))


def _bolts(rig, build, p, hz) -> None:
    build.heads *= p["factor"]


def _temperature(rig, build, p, hz) -> None:
    for i in range(len(rig.bodies)):
        build.E[i] = build.E.get(i, 1.0) * p["factor"]


_ELSE: dict[str, Callable] = {
    "stinger": _stinger,
    "resonator": _resonator,
    "lining": _lining,
    "partly_filled": _lining,
    "bolts": _bolts,
    "temperature": _temperature,
    "harness": lambda rig, build, p, hz: build.masses.append((HARNESS[rig.name], p["kg"])),
    "local_loss": lambda rig, build, p, hz: build.patches.append(
        (p["at"], p["radius"], p["factor"], 1.0)
    ),
    "hard_spot": lambda rig, build, p, hz: build.patches.append(
        (p["at"], p["radius"], p["factor"], 1.0)
    ),
    "holes": lambda rig, build, p, hz: build.patches.extend(
        (at, p["radius"], 1e-3, 1e-6) for at in p["at"]
    ),
}
