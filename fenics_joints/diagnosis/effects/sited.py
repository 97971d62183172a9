"""Effects at a place that is a parameter, and of the shape of plates.

What they change stands in `fenics_joints.diagnosis.zones.sites`: nothing of it is in the nominal
model. They are rarer than a property that is off by a little, and have the odds of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.diagnosis.effects.effect import RARE, Effect, Prior, Silent, somewhere
from fenics_joints.diagnosis.effects.part import DIMENSIONS
from fenics_joints.diagnosis.thresholds import NEGLIGIBLE
from fenics_joints.diagnosis.zones.part_cells import (
    BOW,
    LOSS,
    MOST_BOW,
    MOST_TAPER,
    TAPER,
    Plate,
)
from fenics_joints.diagnosis.zones.sites import HUNG, ON, Sites
from fenics_joints.measurements.data import TestData

__all__ = [
    "BOWED", "CABLE", "CABLE_MASS", "LOCAL_LOSS", "RESONATOR", "TAPERED", "looked_for",
    "sited_effects", "wanted",
]  # fmt: skip

LOCAL_LOSS = "local loss of stiffness"
CABLE = "cable or stinger"
RESONATOR = "attached resonator"
BOWED = "plate not flat"
TAPERED = "thickness not even"
#: What each asks of the sites.
_ASKS = {LOCAL_LOSS: LOSS, CABLE: ON, RESONATOR: ON, BOWED: BOW, TAPERED: TAPER}

#: Share of the stiffness of a patch that is gone: a cut half way through a beam is as soft as 2 to
#: 3 heights of it more, and at a tenth of the height hardly anything (Ostachowicz and Krawczuk, J.
#: Sound Vib. 150, 1991); of a patch some heights long that is a third, within a factor of 2.5.
#: [prior: Ostachowicz and Krawczuk 1991]
_DEPTH = Prior("depth", 0.3, np.log(2.5), "", True, (0.0, 0.95))
#: How many patches about its place it takes, of some 24 of the whole: one to four more often than
#: not. Data tell a deep loss of one from a shallow one of several only where shapes are good.
#: [prior: chosen]
_SIZE = Prior("size", 2.0, np.log(2.0), "", True, (1.0, 12.0))
#: Mass of a cable, harness, antenna or sensor over the structure's: 1 %, within a factor of 3. An
#: accelerometer and its lead weigh 5 to 30 g; harnesses of spacecraft come to 10 % and more
#: (Babuska et al., J. Spacecraft Rockets 47, 2010). [prior: data sheets; Babuska et al. 2010]
CABLE_MASS = (0.01, np.log(3.0), (0.0, 0.5))
#: Stiffness to the ground, N/m: a taut lead has some 1e2, a steel stinger of 2 mm bends with 1e3 to
#: 1e4 and pushes with 1e6: within a factor of 30 either way, along each axis
#: by itself: a stinger pushes along itself alone. [prior: beam theory; spread chosen]
_GROUND = Prior("stiffness", 1e4, np.log(30.0), "N/m", True, (1.0, 1e8))
#: Its own frequency, over the middle of the test's band: as often above it as below, within a
#: factor of 3. [prior: chosen]
_OWN = (np.log(3.0), 30.0)
#: Frequencies of its own at which a fit looks whether to start there; and over those of the test's
#: modes, as of one whose own motions the test sees: what bears it gives way, so that they are below
#: by a tenth at most. [numerical: chosen]
_FREQUENCIES, _ABOVE = 12, (1.02, 1.07)
#: Height of a bow over its length: sheet and plate may be 0.2 to 0.5 % off flat (EN 485-4 and EN
#: 10029), within a factor of 3 either way. [prior: EN 485-4, EN 10029]
_HEIGHT = (0.002, np.log(3.0), (1e-5, MOST_BOW))
#: Half the difference of the ends' thicknesses over their mean: as a cause far beyond the tolerance
#: of 1 % or less of rolled plate; milled or ground by hand. [prior: chosen]
_TAPER = Prior("taper", 0.0, 0.05, "", False, (-MOST_TAPER, MOST_TAPER))
#: Directions of a bow in words.
_LONG = {"along": "along its length", "across": "across its width"}
#: Effects that act through what `_as_meshed` takes for the mesh's, and each other.
_SHAPES = frozenset(
    f"{word} error{of}" for word in (*DIMENSIONS, "shear modulus")
    for of in ("", " of all parts", " of several parts")
) | {LOCAL_LOSS, BOWED, TAPERED}  # fmt: skip


def wanted(case: Case) -> set[str]:
    """Prefixes of the parameters that the effects which a case asks for need."""
    return {prefix for name, prefix in _ASKS.items() if looked_for(case, name)}


def looked_for(case: Case, name: str) -> bool:
    """Whether a case asks for an effect that few structures have, by its name or for all such."""
    asked = case.diagnose.effects
    return case.diagnose.rare if asked is None else name in asked


def sited_effects(
    case: Case, data: TestData, sites: Sites, total_mass: float
) -> tuple[list[Effect], list[Silent]]:
    """The effects that a structure's sites give rise to, and those that it cannot have.

    Args:
        case: The case.
        data: The test.
        sites: Places of the structure.
        total_mass: Its mass, kg.
    """
    found = []
    if len(sites.patches) > 1:
        found.append(local_loss(sites.patches, case))
    if len(sites.points) > 1:
        places = _named(sites.points, data.sensors)
        hz = [np.exp(np.mean(np.log(f[np.isfinite(f)])))
              for f in data.frequencies_hz.T if np.isfinite(f).any()]  # fmt: skip
        found += [cable(places, total_mass), resonator(places, total_mass, np.array(hz))]
    weight = RARE / max(len(sites.bowed), 1)
    found += [bowed(plate, case, weight) for plate in sites.bowed]
    weight = RARE / max(len(sites.tapered), 1)
    found += [tapered(plate, case, weight) for plate in sites.tapered]
    reasons = {
        LOCAL_LOSS: "the model has no cells of parts",
        CABLE: "the model has no cells of parts", RESONATOR: "the model has no cells of parts",
        BOWED: "it is of structures that are one flat plate, of elements of degree 2, and of tests "
        "with sensors",
        TAPERED: "it is of even plates that nothing joins on an edge, of elements of degree 2, and "
        "of tests with sensors",
    }  # fmt: skip
    there = {effect.name for effect in found}
    silent = [Silent(name, why) for name, why in reasons.items() if name not in there]
    return (
        [effect for effect in found if looked_for(case, effect.name)],
        [one for one in silent if looked_for(case, one.effect)],
    )


def _named(points: np.ndarray, sensors) -> tuple[str, ...]:
    """Points in words, those of sensors by their number."""
    names = []
    for x in points:
        words = _at(x)
        if sensors is not None:
            away = np.linalg.norm(sensors.points - x[: sensors.points.shape[1]], axis=1)
            nearest = int(np.argmin(away))
            others = np.delete(points, np.flatnonzero((points == x).all(axis=1)), axis=0)
            apart = np.min(np.linalg.norm(others - x, axis=1)) if len(others) else np.inf
            if away[nearest] < NEGLIGIBLE * apart:
                words = f"{words}, sensor {nearest + 1}"
        names.append(words)
    return tuple(names)


def _at(x: np.ndarray) -> str:
    """A place in millimetres."""
    return f"({', '.join(f'{1e3 * c + 0.0:.0f}' for c in x)}) mm"


def local_loss(patches: np.ndarray, case: Case) -> Effect:
    """A share of the stiffness of one patch of the parts is gone: a crack, a cut, a bad weld.

    Between two patches each has lost its share. The mass stays. Of several patches they are those
    next to each other along the parts.

    Args:
        patches: Their middles, m, (Q, 3), neighbours next to each other.
        case: The case.
    """

    def apply(values, theta, condition):
        _as_meshed(values, case)
        for key in ("depth", "place", "size"):
            values[f"{LOSS}.{key}"] = theta[key]

    count = len(patches)
    words = "A part has lost stiffness in one place: a crack, a cut, a bad weld."
    return Effect(
        LOCAL_LOSS, "", (_DEPTH, _SIZE, somewhere("place", count, count)), apply, words,
        weight=RARE, beside=True, never_with=_SHAPES, places=tuple(_at(x) for x in patches),
    )  # fmt: skip


def cable(places: Sequence[str], total_mass: float) -> Effect:
    """A mass and a spring to the ground at one point: a lead, a hose, a shaker's stinger.

    Args:
        places: The points in words, neighbours next to each other.
        total_mass: The structure's, kg.
    """

    def apply(values, theta, condition):
        values[f"{ON}.mass"], values[f"{ON}.place"] = theta["mass"], theta["place"]
        for along in "xyz":
            values[f"{ON}.stiffness_{along}"] = theta[f"stiffness along {along}"]

    count = len(places)
    springs = (replace(_GROUND, name=f"stiffness along {along}") for along in "xyz")
    priors = (_mass(total_mass), *springs, somewhere("place", count, count))
    words = "A cable, a hose or a stinger holds the structure at one point and weighs on it."
    return Effect(
        CABLE, "", priors, apply, words, family=ON, weight=RARE, beside=True, places=tuple(places)
    )


def resonator(places: Sequence[str], total_mass: float, measured_hz: np.ndarray) -> Effect:
    """A mass on a spring at one point: a harness between clamps, an antenna, a loose lid.

    Modes below its own frequency fall, those above it rise, and its own motions, one in each
    direction, are further modes, which the test may have seen.

    Args:
        places: See `cable`.
        total_mass: The structure's, kg.
        measured_hz: About the frequencies of the test's modes, Hz, (m,), of those that are known.
    """
    middle = float(np.exp(np.mean(np.log(measured_hz))))

    def apply(values, theta, condition):
        values[f"{HUNG}.mass"], values[f"{HUNG}.place"] = theta["mass"], theta["place"]
        values[f"{HUNG}.stiffness"] = theta["mass"] * (2 * np.pi * theta["frequency"]) ** 2

    spread, far = _OWN
    span = middle / far, middle * far
    also = tuple(np.outer(_ABOVE, measured_hz).ravel().tolist())
    own = Prior("frequency", middle, spread, "Hz", True, span, _FREQUENCIES, also=also)
    count = len(places)
    priors = (_mass(total_mass), own, somewhere("place", count, count))
    words = (
        "Something on a spring is attached at one point: modes below its own frequency fall as by "
        "a mass, modes above it rise."
    )
    return Effect(
        RESONATOR, "", priors, apply, words, family=ON, weight=RARE, beside=True,
        places=tuple(places),
    )  # fmt: skip


def _mass(total: float) -> Prior:
    median, spread, (low, high) = CABLE_MASS
    return Prior("mass", median * total, spread, "kg", True, (low * total, high * total))


# -- the shape of plates ---------------------------------------------------------------------------


def bowed(plate: Plate, case: Case, weight: float) -> Effect:
    """The structure is a bowed plate: its middle stands off a line through its ends.

    Args:
        plate: The structure as a plate.
        case: The case.
        weight: Prior odds.
    """
    median, spread, (low, high) = _HEIGHT
    L = plate.length
    prior = Prior("height", median * L, spread, "m", True, (low * L, high * L))

    def apply(values, theta, condition):
        _as_meshed(values, case)
        values[plate.parameter] = theta["height"]

    words = f"The structure is bowed {_LONG[plate.how]}: its middle stands off a line."
    return Effect(
        BOWED, _LONG[plate.how], (prior,), apply, words, family=BOW, weight=weight,
        beside=True, never_with=_SHAPES,
    )  # fmt: skip


def tapered(plate: Plate, case: Case, weight: float) -> Effect:
    """A plate is thicker at one end than at the other, with the mean that the model has.

    Args:
        plate: The plate.
        case: The case.
        weight: Prior odds.
    """

    def apply(values, theta, condition):
        _as_meshed(values, case)
        values[plate.parameter] = theta["taper"]

    words = f"{plate.name} is thicker at one end than at the other."
    return Effect(
        TAPERED, plate.name, (_TAPER,), apply, words[:1].upper() + words[1:], family=TAPER,
        weight=weight, beside=True, never_with=_SHAPES,
    )  # fmt: skip


def _as_meshed(values: dict, case: Case) -> None:
    """Thickness, width and Poisson's ratio of the mesh, as these changes take them for: a rotation
    of the body would not be free of strain otherwise. What a tolerance has of them bending feels as
    a modulus by E t^3 w, and a scale as a density by t w."""
    for part, section in case.parts.items():
        nominal = section.nominal(width=True)
        t, w = (values.get(f"{part}.{key}", 1.0) for key in ("thickness", "width"))
        values[f"{part}.E"] = values[f"{part}.E"] * (t**3 * w)
        values[f"{part}.rho"] = values[f"{part}.rho"] * (t * w)
        for key in ("thickness", "width", "nu"):
            if f"{part}.{key}" in values:
                values[f"{part}.{key}"] = nominal[key]
