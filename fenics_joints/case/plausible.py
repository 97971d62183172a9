"""What is unusual in a case: values outside what materials, bolts and tests have.

They are said, not refused: a rubber pad or a bridge is no mistake, but E = 69 mostly is one. All
ranges stand in `USUAL`, wide on purpose, so that only a factor that no choice explains is outside.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.case.harmonic import identifiable
from fenics_joints.case.preload import BeamBoltSection
from fenics_joints.errors import InputError
from fenics_joints.formatting import quantity
from fenics_joints.preload.threads import thread
from fenics_joints.units import factor_to_si, parameter_unit, to_si


@dataclass(frozen=True)
class Usual:
    """The usual range of a kind of quantity.

    Attributes:
        what: Of what it is, in words that go before the range.
        low: Lower end, SI.
        high: Upper end, SI.
        unit: SI unit; ``""`` for a ratio.
        zero: Whether zero is usual too: nothing of it.
    """

    what: str
    low: float
    high: float
    unit: str = ""
    zero: bool = False

    def holds(self, value: float) -> bool:
        """Whether a value is within the range."""
        return self.low <= value <= self.high or (self.zero and value == 0)


#: The ranges by kind, with where each is from.
USUAL = {
    # Ashby, Materials Selection in Mechanical Design, E against density: polymers 0.1 GPa and more,
    # diamond 1200 GPa; densities from balsa wood, 100 kg/m3, to osmium, 22,600.
    "E": Usual("solid materials have", 1e8, 1.2e12, "Pa"),
    "G": Usual("solid materials have", 3e7, 5.5e11, "Pa"),
    "rho": Usual("solid materials have", 100.0, 23e3, "kg/m3"),
    # sqrt(E/rho) on Ashby's chart: soft polymers 300 m/s, diamond 18 km/s. Of steel with E in
    # MPa it is 160 m/s.
    "speed": Usual("sound in bars of solid materials runs at", 250.0, 2e4, "m/s"),
    # Cork 0, metals 0.2 (cast iron) to 0.45 (lead, gold), polymers up to 0.48.
    "nu": Usual("solid materials have", 0.0, 0.49),
    # The papers' layers have 0.9 MPa to 6.1 GPa; none is stiffer than its parts, and one of 0.1 mm
    # with 10 kPa gives 0.1 N/mm3, a hundredth of a rubber sheet of that thickness.
    "layer": Usual("layers of joints have", 1e4, 1.2e12, "Pa"),
    # The papers' layers are 0.5 to 0.72 mm; roughness is a micrometre, a gasket some millimetres.
    "h": Usual("layers of joints have", 1e-6, 2e-2, "m"),
    # From a foil to the bed of a large machine tool.
    "length": Usual("dimensions of bolted structures are", 1e-5, 50.0, "m"),
    # One MPa in the shank is a bolt that is about to fall out; property class 12.9 breaks at 1220
    # MPa (ISO 898-1).
    "bolt stress": Usual("bolts have", 1e6, 1.22e9, "Pa"),
    # Without a thread: an M1.6 at a tenth of its strength to an M100 of class 12.9.
    "bolt force": Usual("bolts have", 50.0, 1e7, "N"),
    "bolt torque": Usual("bolts are tightened to", 0.01, 3e4, "N*m"),
    # VDI 2230, table A5: 0.04 to 0.35 in threads; dry metals up to 0.8, clean titanium or aluminium
    # on themselves to 1.3.
    "friction": Usual("coefficients of friction are", 0.03, 1.3, zero=True),
    # Bickford, Introduction to the Design and Behavior of Bolted Joints: 0.1 to 0.35 measured.
    "nut factor": Usual("nut factors are", 0.07, 0.5),
    "diameter": Usual("shanks of bolts have", 1e-3, 0.2, "m"),
    # Flatness of machined faces is below 0.1 mm; fits interfere by less.
    "gap": Usual("gaps between faces that are to touch are at most", -2e-3, 2e-3, "m"),
    # From the smallest accelerometer to a large machine's component.
    "mass": Usual("attached masses are", 1e-5, 1e4, "kg"),
    # A rubber band to a machine's foot.
    "stiffness": Usual("springs have", 1.0, 1e11, "N/m"),
    # From the elements of lapped beams: Jalali et al. 2019 has 1.7e3 and 1.5e5 N m.
    "turning": Usual("springs of laps have", 1.0, 1e9, "N*m"),
    "axial": Usual("springs of laps have", 1e3, 1e13, "N/m"),
    "damper": Usual("laps of beams have", 1e-6, 1e4, "N*m*s", zero=True),
    # A tall machine to ultrasound; accelerometers end at 50 kHz, laser vibrometers beyond.
    "frequency": Usual("modes of bolted structures are measured at", 0.1, 1e5, "Hz"),
    # Bare metal 1e-5, bolted structures 1e-4 to 5e-2 (Adams and Askenazi; the papers: below 2 %).
    "damping ratio": Usual("damping ratios of bolted structures are", 1e-6, 0.1, zero=True),
    "loss factor": Usual("loss factors of bolted structures are", 1e-6, 0.5, zero=True),
    # Ratio 0.2 at 100 Hz by mass alone is alpha = 250 1/s; at 10 Hz by stiffness alone beta = 6 ms.
    "alpha": Usual("Rayleigh's alpha is", 1e-6, 1e4, "1/s", zero=True),
    "beta": Usual("Rayleigh's beta is", 1e-12, 2e-2, "s", zero=True),
    "relaxation": Usual("relaxation times are", 1e-12, 2e-2, "s", zero=True),
    # Repeated tests agree to 1e-4; after a joint was taken apart to some per cent.
    "noise": Usual("relative scatter of measured frequencies is", 1e-5, 0.1),
    "damping noise": Usual("relative scatter of damping ratios is", 1e-4, 1.0, zero=True),
    "tolerance": Usual("relative tolerances are", 1e-6, 0.5),
    "discrepancy": Usual("relative errors of models are", 1e-6, 0.5, zero=True),
    "resolution": Usual("lines of analysers are apart by", 1e-4, 100.0, "Hz", zero=True),
    # A hammer tap by a fingernail to a hydraulic shaker.
    "level": Usual("forces of excitation are", 1e-4, 1e5, "N"),
    "stress": Usual("curves of joints have", 1.0, 1.2e12, "Pa", zero=True),
    # From faces that rest on each other to below a bolt's head at its limit.
    "contact pressure": Usual("faces of joints are pressed by", 1e3, 1e9, "Pa"),
    # ISO 1302: Ra 0.025 um, lapped, to 50 um, as cast.
    "roughness": Usual("faces of joints have Ra of", 1e-8, 1e-4, "m"),
    "face force": Usual("loads of faces are", -1e7, 1e7, "N"),
    # Small displacements: a grip that moves farther than a few per cent of a structure bends it.
    "travel": Usual("in a preload faces and obstacles are moved by", -1e-2, 1e-2, "m"),
    "per length": Usual("contacts have", 1e6, 1e17, "Pa/m"),
}

#: Kinds of a section's numbers, by table and key.
_SECTIONS = {
    "parts": {"E": "E", "G": "G", "rho": "rho", "nu": "nu"},
    "joints": {
        "E": "layer",
        "G": "layer",
        "rho": "rho",
        "nu": "nu",
        "h": "h",
        "meshed": "h",
        "k_n": "per length",
        "k_t": "per length",
        "pressure": "contact pressure",
        "roughness": "roughness",
        "k1": "turning",
        "k2": "turning",
        "k_axial": "axial",
        "c": "damper",
    },
    "bolts": {
        "friction": "friction",
        "nut_factor": "nut factor",
        "diameter": "diameter",
        "E": "E",
        "rho": "rho",
        "nu": "nu",
    },
    "contacts": {"friction": "friction", "gap": "gap"},
    "obstacles": {"friction": "friction", "gap": "gap", "radius": "length"},
    "loads": {"pressure": "contact pressure"},
    "masses": {"mass": "mass"},
    "springs": {"stiffness": "stiffness"},
    "attached": {"mass": "mass", "stiffness": "stiffness"},
}
#: Units that are forgotten, by the SI unit that is then read.
_FORGOTTEN = {
    "Pa": (("GPa", 1e9), ("MPa", 1e6)),
    "kg/m3": (("g/cm3", 1e3), ("t/mm3", 1e12)),
    "m": (("mm", 1e-3), ("um", 1e-6)),
    "kg": (("g", 1e-3),),
    "N": (("kN", 1e3),),
    "N/m": (("N/mm", 1e3), ("kN/m", 1e3)),
    "Hz": (("kHz", 1e3),),
    "": (("%", 1e-2),),
    "N*m": (("kN m", 1e3), ("N mm", 1e-3)),
}

Found = tuple[str, float, Usual]


def plausibility(case: Case) -> tuple[str, ...]:
    """What of a case's values is unusual, a sentence each; empty if nothing is.

    Each names the value, its unit and the usual range of its kind. Values that are alike in
    sections that are alike are one sentence.
    """
    alike: dict[tuple, list[str]] = {}
    for key, value, usual in _quantities(case):
        if not usual.holds(value):
            alike.setdefault((key.rpartition(".")[2], value, usual), []).append(key)
    said = [_said(keys, value, usual) for (_, value, usual), keys in alike.items()]
    return (*said, *_too_few(case))


def _said(keys: list[str], value: float, usual: Usual) -> str:
    more = f" (and {len(keys) - 1} like it)" if len(keys) > 1 else ""
    unit = usual.unit.replace("*", " ")
    low, high = (quantity(v, unit) for v in (usual.low, usual.high))
    given = f"{value:g} {unit}".rstrip()
    meant = [u for u, factor in _FORGOTTEN.get(usual.unit, ()) if usual.holds(value * factor)]
    hint = f"; was '{value:g} {meant[0]}' meant?" if len(meant) == 1 else ""
    return f"{keys[0]}{more} = {given} is unusual: {usual.what} {low} to {high}{hint}"


def _quantities(case: Case) -> Iterator[Found]:
    """All numbers of a case that have a usual range: key, value in SI and the range."""
    for table, kinds in _SECTIONS.items():
        for name, section in getattr(case, table).items():
            for key, kind in kinds.items():
                value = getattr(section, key, None)
                if value is not None:
                    yield f"{table}.{name}.{key}", value, USUAL[kind]
    for name, part in case.parts.items():
        if USUAL["E"].holds(part.E) and USUAL["rho"].holds(part.rho):
            yield f"parts.{name}: sqrt(E/rho)", math.sqrt(part.E / part.rho), USUAL["speed"]
    yield from _tolerances(case)
    yield from _starts(case)
    yield from _mesh(case)
    yield from _bolts(case)
    yield from _applied(case)
    yield from _damping(case)
    yield from _test(case)
    yield from _nonlinear(case)
    yield "diagnose.discrepancy", case.diagnose.discrepancy, USUAL["discrepancy"]


def _mesh(case: Case) -> Iterator[Found]:
    """The lengths that a mesh is made of; places of bolts, and what is zero, are none."""
    made_by = getattr(case.mesh, "made_by", None)
    kinds = {} if made_by is None else typing.get_type_hints(made_by, include_extras=True)
    names = [name for name, kind in kinds.items() if _is_length(kind)]
    if made_by is None:
        names = ["lengths", "laps", "width", "thickness"]  # of beams
    for name in names:
        given = getattr(case.mesh, name, None)
        for value in given if isinstance(given, list | tuple) else (given,):
            if isinstance(value, float) and value > 0:
                yield f"mesh.{name}", value, USUAL["length"]
    along = [getattr(case.mesh, key, None) for key in ("length", "lengths")]
    longest = max((x for given in along if given for x in np.atleast_1d(given)), default=math.inf)
    for value in np.atleast_1d(getattr(case.mesh, "thickness", None) or ()).tolist():
        if USUAL["length"].holds(value):
            words = "beams and plates are thinner than they are long,"
            yield "mesh.thickness", value, Usual(words, 0.0, float(longest), "m")


def _tolerances(case: Case) -> Iterator[Found]:
    """Tolerances of parts, and those of a section that are all zero: some of its values may be
    known exactly, but not all. Joints and attached masses may be known to a factor only."""
    for table in ("parts", "joints", "masses", "springs", "attached"):
        for name, section in getattr(case, table).items():
            given = section.tolerance
            given = given.model_dump() if hasattr(given, "model_dump") else {"": given}
            given = {key: value for key, value in given.items() if value is not None}
            for key, value in given.items():
                if not any(given.values()) or (table == "parts" and value > 0):
                    key = f"{table}.{name}.tolerance.{key}".rstrip(".")
                    yield key, value, USUAL["tolerance"]


def _starts(case: Case) -> Iterator[Found]:
    """Start values of an update with the range around the nominal model: wide for joints, narrow
    for parts."""
    nominal = case.nominal(damping=True)
    for name, given in ({} if case.update is None else case.update.start).items():
        value, unit = nominal.get(name), parameter_unit(name)
        if not value or case.update.cutoff is not None:
            continue
        factor = 3.0 if name.partition(".")[0] in case.parts else 1e4
        low, high = sorted((value / factor, value * factor))
        with suppress(InputError):  # the check of the case reports it
            words = "with this nominal model, starts are"
            yield f"update.start.{name}", to_si(given, unit), Usual(words, low, high, unit)


def _too_few(case: Case) -> list[str]:
    """A sentence where a test has fewer data than the case has unknowns."""
    data, row = case.measured, case.row()
    if row is None or data.shapes is not None or case.frfs() or case.harmonic:
        return []
    there = np.isfinite(data.frequencies_hz)
    names = () if case.update is None else case.update.parameters
    by_them = case.fitted_data() == ("frequencies",)
    if there.sum() > 1 and not (by_them and len(names) > there[row].sum()):
        return []
    wanted = f"the {len(names)} update.parameters" if names else "the unknowns of the case"
    return [
        f"test.frequencies: {there[row].sum()} measured for {wanted}; expected at least as many, "
        "and at least two: any change of the model can explain a single frequency"
    ]


def _is_length(kind) -> bool:
    """Whether a type, or what is inside it, is a number in metres."""
    demands = getattr(kind, "__metadata__", ())
    return any(getattr(demand, "unit", None) == "m" for demand in demands) or any(
        map(_is_length, typing.get_args(kind))
    )


def _bolts(case: Case) -> Iterator[Found]:
    """Forces and torques, by the stress in the thread or shank where that is known."""
    for name, bolt in case.bolts.items():
        key = f"bolts.{name}.{'torque' if bolt.force is None else 'force'}"
        area = _stressed_area(bolt)
        if area is None:
            yield key, bolt.preload(), USUAL["bolt force"]
        elif bolt.force is not None:
            yield key, bolt.force, _by_stress("bolts of its size carry", area, "N")
        else:
            factor = area * bolt.torque / bolt.preload()
            words = "bolts of its size are tightened to"
            yield key, bolt.torque, _by_stress(words, factor, "N*m")


def _applied(case: Case) -> Iterator[Found]:
    """Components of what faces and obstacles are moved and pushed by, those that are not zero."""
    tables = (
        (case.displacements, "displacements", {"value": "travel"}),
        (case.obstacles, "obstacles", {"travel": "travel", "force": "face force"}),
        (case.loads, "loads", {"force": "face force"}),
    )
    for table, name, kinds in tables:
        for own, section in table.items():
            for key, kind in kinds.items():
                for i, value in enumerate(getattr(section, key) or ()):
                    if value:
                        yield f"{name}.{own}.{key}[{i}]", value, USUAL[kind]


def _stressed_area(bolt) -> float | None:
    if bolt.thread is not None:
        return thread(bolt.thread).stress_area
    if isinstance(bolt, BeamBoltSection) and bolt.diameter is not None:
        return math.pi / 4 * bolt.diameter**2
    return None


def _by_stress(what: str, factor: float, unit: str) -> Usual:
    stress = USUAL["bolt stress"]
    return Usual(what, stress.low * factor, stress.high * factor, unit)


def _damping(case: Case) -> Iterator[Found]:
    kinds = {
        "loss_factor": "loss factor",
        "alpha": "alpha",
        "beta": "beta",
        "relaxation": "relaxation",
    }
    for name, value in (case.damping.nominal() if case.damping is not None else {}).items():
        yield name, value, USUAL[kinds.get(name.rpartition(".")[2], "damping ratio")]
    if case.harmonic is not None:
        for i, ratio in enumerate(case.harmonic.damping):
            yield f"harmonic.damping[{i}]", ratio, USUAL["damping ratio"]


def _test(case: Case) -> Iterator[Found]:
    if case.test is None:
        return
    # Without a given noise, the analyser's line spacing may say how accurate the table is.
    exact = "noise" in case.test.model_fields_set and not any(case.test.resolution)
    for key, kind in (("noise", "noise"), ("resolution", "resolution")):
        for value in getattr(case.test, key):
            if key != "noise" or value or exact:
                yield f"test.{key}", value, USUAL[kind]
    if case.test.damping_noise is not None:
        yield "test.damping_noise", case.test.damping_noise, USUAL["damping noise"]
    data = case.measured
    if data is None:
        return
    for name, column in zip(data.mode_names, data.frequencies_hz.T, strict=True):
        yield from _furthest(f"test.frequencies.{name}", column, USUAL["frequency"])
    if data.damping is not None:
        for name, column in zip(data.mode_names, data.damping.T, strict=True):
            yield from _furthest(f"test.damping.{name}", column, USUAL["damping ratio"])
    kinds = {"N*m": "bolt torque", "N": "bolt force"} if not data.by_level else {"N": "level"}
    for unit, kind in kinds.items():
        try:
            factor = factor_to_si(data.condition_unit, unit) if data.condition_unit else None
        except InputError:
            continue
        if factor is not None:
            key = f"test.{data.condition_name}"
            yield from _furthest(key, data.conditions * factor, USUAL[kind])


def _furthest(key: str, values: np.ndarray, usual: Usual) -> Iterator[Found]:
    """The least and the largest of some values, one of them if both are the same."""
    there = values[np.isfinite(values)]
    for value in sorted({float(f(there)) for f in (np.min, np.max)} if len(there) else ()):
        yield key, value, usual


def _nonlinear(case: Case) -> Iterator[Found]:
    kinds = {"Pa": "stress", "Pa/m": "per length"}
    for key, (value, unit) in identifiable(case.nonlinear).items():
        kind = "friction" if key.endswith(".friction") else kinds.get(unit)
        if kind is not None:
            yield f"nonlinear.{key}", value, USUAL[kind]
    if case.harmonic is not None:
        forces = case.harmonic.levels if case.harmonic.base is None else ()
        for i, level in enumerate(forces):
            yield f"harmonic.levels[{i}]", level, USUAL["level"]
        for value in case.harmonic.band:
            yield "harmonic.band", value, USUAL["frequency"]
