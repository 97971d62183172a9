"""At which sizes, and where, each effect of the second world is computed for D and the oracle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from .effects import _LOOSE, _SOFT, MASS, regions
from .states import States

_BETA = 0.55  # the middle of those drawn
#: Sizes of parts' errors that are drawn: least and largest of ln.
_PARTS = {"modulus": (0.04, 0.25), "shear_modulus": (0.05, 0.15), "density": (0.03, 0.2)}
_PLATES = _PARTS | {"thickness": (0.03, 0.15)}
_PLACES = 8


@dataclass(frozen=True)
class Sheet:
    """An effect at one place by its size.

    Attributes:
        name: The effect.
        us: Sizes at which it is computed, rising, (k,).
        states: ln f (k, m) and shapes (k, m, n, 3).
        span: Range of sizes that is drawn from.
        power: By which ln of the torque over the highest moves the size.
    """

    name: str
    us: np.ndarray
    states: tuple[np.ndarray, np.ndarray]
    span: tuple[float, float]
    power: float = 0.0


def _sheet(name: str, us, solve: Callable, span=None, power: float = 0.0) -> Sheet:
    found = [solve(float(u)) for u in us]
    states = np.array([f for f, _ in found]), np.array([u for _, u in found])
    span = (float(us[0]), float(us[-1])) if span is None else span
    return Sheet(name, np.asarray(us), states, span, power)


def _from_none(states: States, name: str, low: float, high: float, solve: Callable) -> Sheet:
    """Solved at the largest size alone, and known at none: nearly straight in between."""
    log_f, shapes = solve(high)
    base = np.log(states.base[0]), states.base[1]
    both = np.array([base[0], log_f]), np.array([base[1], shapes])
    return Sheet(name, np.array([0.0, high]), both, (low, high))


def sheets_of(states: States) -> Iterator[Sheet]:
    """Every sheet of a rig."""
    yield from _joints(states)
    yield from _bolts(states)
    yield from _parts(states)
    yield from _attached(states)


def _effect(name, region="", **params) -> list[dict]:
    return [{"name": name, "region": region, "params": params}]


def _joints(states: States):
    rig = states.rig
    least = _BETA * np.log(min(rig.torques) / max(rig.torques))
    for name, low, high in (("soft_joint", *_SOFT), ("sliding_joint", _SOFT[0] / 3, _SOFT[1] / 3)):
        span = (float(np.log(low)), float(np.log(high)))
        yield _sheet(
            name,
            np.linspace(span[0] + least, span[1], 4),
            lambda u, n=name: states.of(_effect(n, k=np.exp(u), beta=_BETA)),
            span,
            _BETA,
        )
    yield _sheet(
        "small_contact", (0.35, 0.55, 0.75), lambda u: states.of(_effect("small_contact", factor=u))
    )
    if len(rig.interfaces) > 1:
        span = (float(np.log(_SOFT[0])), float(np.log(_SOFT[1])))
        for region in regions(rig.name, "soft_face"):
            yield _sheet(
                "soft_face",
                np.linspace(span[0] + least, span[1], 3),
                lambda u, r=region: states.of(_effect("soft_face", r, k=np.exp(u), beta=_BETA)),
                span,
                _BETA,
            )


def _bolts(states: States):
    """Single bolts on faces that rest hardly; of two that are loose, few are solved.

    Where there are many, the changes of two are added up: they are far apart for most.
    """
    count, middle = len(states.rig.bolts), float(np.sqrt(_LOOSE[0] * _LOOSE[1]))
    single = []
    for i in range(count):
        one = _sheet(
            "loose_bolt",
            np.log([middle]),
            lambda u, i=i: states.of(_effect("loose_bolt", f"bolt {i + 1}", k=np.exp(u))),
        )
        single.append(one)
        yield one
    log_f, shapes = np.log(states.base[0]), states.base[1]
    for i, j in combinations(range(count), 2):
        if count <= 4:
            own = _effect("two_loose_bolts", bolts=[i, j], k=middle)
            yield _sheet("two_loose_bolts", [0.0], lambda u, own=own: states.of(own))
            continue
        a, b = single[i].states, single[j].states
        yield Sheet(
            "two_loose_bolts",
            np.zeros(1),
            (a[0][:1] + b[0][:1] - log_f, a[1][:1] + b[1][:1] - shapes),
            (0.0, 0.0),
        )


def _parts(states: States):
    plates = all(body.normal is not None for body in states.rig.bodies)
    for name, (low, high) in (_PLATES if plates else _PARTS).items():
        for region in regions(states.geometry, name):
            for sign in (-1, 1):
                yield _from_none(
                    states,
                    name,
                    low,
                    high,
                    lambda u, n=name, r=region, s=sign: states.of(
                        _effect(n, r, factor=float(np.exp(s * u)))
                    ),
                )
    if plates:
        for region in regions(states.geometry, "taper"):
            for sign in (-1, 1):
                yield _from_none(
                    states,
                    "taper",
                    0.05,
                    0.3,
                    lambda u, r=region, s=sign: states.of(_effect("taper", r, slope=s * u)),
                )
    yield _from_none(states, "bolts", 0.5, 4.0, lambda u: states.of(_effect("bolts", factor=1 + u)))


def _attached(states: States):
    """Masses, springs and resonators by the drawing's modes; soft patches solved at some places."""
    mass, harness = MASS[states.geometry], states.harness()
    spread = states.pool.sensors
    sizes = np.log([0.01, 0.03, 0.08])
    yield _sheet("harness", sizes, lambda u: states.attached(masses=[(harness, mass * np.exp(u))]))
    for node in spread[:30]:
        for axis in range(3):
            yield _sheet(
                "stinger",
                np.log([1e5, 5e5, 3e6]),
                lambda u, n=node, a=axis: states.attached(
                    masses=[(n, 0.008 * mass)], springs=[(n, a, np.exp(u))]
                ),
            )
        for hz in states.base[0][:5]:
            yield _sheet(
                "resonator",
                np.log([0.005, 0.014, 0.04]),
                lambda u, n=node, f=hz: states.attached(tuned=[(n, mass * np.exp(u), f)]),
            )
    places = _places(states)
    for at in places:
        yield _from_none(
            states,
            "local_loss",
            0.003,
            0.03,
            lambda u, at=at: states.of(_effect("local_loss", at=at, radius=u, factor=0.08)),
        )


def _places(states: States) -> list[list[float]]:
    from .meshing import mesh_of

    x = mesh_of(states.geometry).x[states.pool.observed.nodes[states.pool.sensors]]
    bolts = np.array(states.rig.bolts)
    far = [
        i for i in range(len(x)) if np.linalg.norm(x[i] - bolts, axis=1).min() > 3 * states.rig.pad
    ]
    return [x[i].tolist() for i in far[:_PLACES]]
