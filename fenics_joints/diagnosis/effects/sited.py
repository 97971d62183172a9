"""Effects at a place that is a parameter, and of the shape of plates.

`fenics_joints.diagnosis.zones.sites` has the parameters that they change, which are zero in the
nominal model. Most are rarer than a property that is off by a little, and have the odds of that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fenics_joints.case import Case
from fenics_joints.diagnosis.effects.effect import (
    RARE,
    Effect,
    Found,
    Prior,
    Setting,
    Silent,
    place_prior,
)
from fenics_joints.diagnosis.effects.part import DIMENSIONS
from fenics_joints.diagnosis.effects.rig import SUPPORTS
from fenics_joints.diagnosis.zones.sites import (
    BOW,
    HUNG,
    LOSS,
    MOST_BOW,
    MOST_TAPER,
    ON,
    TAPER,
    Plate,
    Sites,
)
from fenics_joints.structure.changes import OFFSETS

ADDED = "added mass"
LOCAL_LOSS, LOCAL_GAIN = "local loss of stiffness", "local gain of stiffness"
CABLE = "cable or stinger"
RESONATOR = "attached resonator"
BOWED = "plate not flat"
TAPERED = "thickness not even"
#: Prefix of the parameters of each, which the model has only if a case asks for the effect.
_ASKS = {
    ADDED: ON,
    CABLE: ON,
    RESONATOR: ON,
    LOCAL_LOSS: LOSS,
    LOCAL_GAIN: LOSS,
    BOWED: BOW,
    TAPERED: TAPER,
}

_PLACED = (ADDED, CABLE, RESONATOR, LOCAL_LOSS, LOCAL_GAIN)
#: Effects that few structures have, so that a case has to ask for them.
_FEW = (BOWED, TAPERED, SUPPORTS)

#: Share of the stiffness of a patch that is gone: a cut half way through a beam is as soft as 2 to
#: 3 heights of it more, and at a tenth of the height hardly anything (Ostachowicz and Krawczuk, J.
#: Sound Vib. 150, 1991); of a patch some heights long that is a third, within a factor of 2.5.
#: [prior: Ostachowicz and Krawczuk 1991]
_DEPTH = Prior("depth", 0.3, np.log(2.5), "", True, (0.0, 0.95))
#: How many patches about its place it takes, of some 24 of the whole: one to four more often than
#: not. Data tell a deep loss of one from a shallow one of several only where shapes are good.
#: [prior: chosen]
_SIZE = Prior("size", 2.0, np.log(2.0), "", True, (1.0, 12.0))
#: Of a rib, a weld or a hard spot: as much again is gained as a loss takes, up to many times over.
#: [prior: chosen]
_GAIN = Prior("gain", 0.5, np.log(2.5), "", True, (1e-3, 20.0))
#: Their amount, its sign, and what they are in words. [prior: definition]
_LOCAL = {
    LOCAL_LOSS: (_DEPTH, 1.0, "A part has lost stiffness in one place: a crack, a cut."),
    LOCAL_GAIN: (_GAIN, -1.0, "A part is stiffer in one place: a rib, a weld, a hard spot."),
}
#: How far from the middle of its site something is, over how far the site reaches. [prior: chosen]
_OFFSET = 0.4
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
    f"{word} error{of}"
    for word in (*DIMENSIONS, "shear modulus")
    for of in ("", " of all parts", " of several parts")
) | {LOCAL_LOSS, LOCAL_GAIN, BOWED, TAPERED}


def looked_for(case: Case, name: str) -> bool:
    """Whether a case asks for an effect: by default for all but those of few structures, and for
    these too if it says so."""
    asked = case.diagnose.effects
    if asked is None or "all" in asked:
        return name not in _FEW or case.diagnose.rare or name in (asked or ())
    return name in asked


def needed(case: Case) -> set[str]:
    """Prefixes of the parameters that the effects at sites need which a case asks for."""
    return {prefix for name, prefix in _ASKS.items() if looked_for(case, name)}


def sited_effects(s: Setting) -> Found:
    """Effects at any place of a structure, and errors of the shape of its plates."""
    case, sites, found = s.case, s.sites, []
    if len(sites.patches) > 1:
        found += [local_change(name, sites.patches, case) for name in (LOCAL_LOSS, LOCAL_GAIN)]
    if len(sites.points) > 1:
        hz = [
            np.exp(np.mean(np.log(f[np.isfinite(f)])))
            for f in s.data.frequencies_hz.T
            if np.isfinite(f).any()
        ]
        found += [
            added_mass(sites, s.mass),
            cable(sites, s.mass),
            resonator(sites, s.mass, np.array(hz)),
        ]
    for make, plates in ((bowed, sites.bowed), (tapered, sites.tapered)):
        found += [make(plate, case, RARE / len(plates)) for plate in plates]
    yield from found
    reasons = {
        **dict.fromkeys(_PLACED, "the parts of the model have no cells"),
        BOWED: "it needs a structure that is one flat plate, elements of degree 2, and a test with "
        "sensors",
        TAPERED: "it needs an even plate with free edges, elements of degree 2, and a test with "
        "sensors",
    }
    there = {effect.name for effect in found}
    yield from (Silent(name, why) for name, why in reasons.items() if name not in there)


def _at(x: np.ndarray) -> str:
    """A place in millimetres."""
    return f"({', '.join(f'{1e3 * c + 0.0:.0f}' for c in x)}) mm"


def local_change(name: str, patches: np.ndarray, case: Case) -> Effect:
    """A patch of the parts has lost a share of its stiffness, such as by a crack, a cut or a bad
    weld, or has more of it, such as by a rib, a weld or a hard spot.

    Between two patches each has its share. The mass stays. Of several patches they are those next
    to each other along the parts.

    Args:
        name: `LOCAL_LOSS` or `LOCAL_GAIN`.
        patches: Their middles, m, (Q, 3), neighbours next to each other.
        case: The case.
    """
    depth, sign, words = _LOCAL[name]

    def apply(values, theta, condition):
        _as_meshed(values, case)
        values[f"{LOSS}.depth"] = sign * theta[depth.name]
        for key in ("place", "size"):
            values[f"{LOSS}.{key}"] = theta[key]

    def where(theta) -> str:
        return _at(patches[_nearest(theta, count)])

    count = len(patches)
    priors = depth, _SIZE, place_prior("place", count, count)
    return replace(_shaped(name, "", priors, apply, words, LOSS, RARE), where=where)


def _nearest(theta: Mapping[str, float], count: int) -> int:
    return int(np.clip(round(theta["place"]), 0, count - 1))


def _attached(
    name: str, prefix: str, sites: Sites, priors: Sequence[Prior], apply, words: str, weight: float
) -> Effect:
    """Something attached at a place about one of the sites.

    Args:
        name: Name of the effect.
        prefix: Of its parameters.
        sites: The sites.
        priors: Its parameters, besides where it is.
        apply: ``(values, theta) -> None``: puts in all but where it is.
        words: Sentence for the report.
        weight: Prior odds, of any place.
    """
    count, far = len(sites.points), sites.reach
    offsets = (Prior(way, 0.0, _OFFSET * far, "m", False, (-far, far)) for way in OFFSETS)

    def put(values, theta, condition):
        apply(values, theta)
        for key in ("place", *OFFSETS):
            values[f"{prefix}.{key}"] = theta[key]

    def where(theta) -> str:
        return _at(sites.points[_nearest(theta, count)] + [theta[way] for way in OFFSETS])

    priors = (*priors, place_prior("place", count, count), *offsets)
    rest = {"family": ON, "weight": weight * sites.share, "beside": True, "where": where}
    return Effect(name, "", priors, put, words, **rest)


def added_mass(sites: Sites, total_mass: float) -> Effect:
    """A mass that nobody modelled: a sensor, a bracket, a part forgotten.

    Args:
        sites: Where it may be.
        total_mass: The structure's, kg.
    """

    def apply(values, theta):
        values[f"{ON}.mass"] = theta["mass"]

    words = "A mass is attached that the model does not have."
    return _attached(ADDED, ON, sites, (_mass(total_mass),), apply, words, 1.0)


def cable(sites: Sites, total_mass: float) -> Effect:
    """A mass and a spring to the ground at one point: a lead, a hose, a shaker's stinger.

    Args:
        sites: Where it may be.
        total_mass: The structure's, kg.
    """

    def apply(values, theta):
        values[f"{ON}.mass"] = theta["mass"]
        for along in OFFSETS:
            values[f"{ON}.stiffness_{along}"] = theta[f"stiffness along {along}"]

    springs = (replace(_GROUND, name=f"stiffness along {along}") for along in OFFSETS)
    words = "A cable, a hose or a stinger adds stiffness and mass at one point."
    return _attached(CABLE, ON, sites, (_mass(total_mass), *springs), apply, words, RARE)


def resonator(sites: Sites, total_mass: float, measured_hz: np.ndarray) -> Effect:
    """A mass on a spring at one point: a harness between clamps, an antenna, a loose lid.

    Modes below its own frequency fall, those above it rise, and its own motions, one in each
    direction, are further modes, which the test may have seen.

    Args:
        sites: Where it may be.
        total_mass: The structure's, kg.
        measured_hz: About the frequencies of the test's modes, Hz, (m,), of those that are known.
    """
    middle = float(np.exp(np.mean(np.log(measured_hz))))

    def apply(values, theta):
        values[f"{HUNG}.mass"] = theta["mass"]
        values[f"{HUNG}.stiffness"] = theta["mass"] * (2 * np.pi * theta["frequency"]) ** 2

    spread, far = _OWN
    span = middle / far, middle * far
    also = tuple(np.outer(_ABOVE, measured_hz).ravel().tolist())
    own = Prior("frequency", middle, spread, "Hz", True, span, _FREQUENCIES, also=also)
    words = (
        "A mass on a spring is attached at one point: modes below its own frequency fall, modes "
        "above it rise."
    )
    return _attached(RESONATOR, HUNG, sites, (_mass(total_mass), own), apply, words, RARE)


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
    return _shaped(BOWED, _LONG[plate.how], (prior,), apply, words, BOW, weight)


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

    words = f"{plate.name[:1].upper()}{plate.name[1:]} is thicker at one end than at the other."
    return _shaped(TAPERED, plate.name, (_TAPER,), apply, words, TAPER, weight)


def _shaped(name, region, priors, apply, words, family, weight) -> Effect:
    """A change of a shape that the mesh has: none can be together with another."""
    rest = {"family": family, "weight": weight, "beside": True, "never_with": _SHAPES}
    return Effect(name, region, priors, apply, words, **rest)


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
