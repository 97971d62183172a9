"""What is unusual in a case: values outside what materials, bolts and tests have.

They are said, not refused: a rubber pad or a bridge is no mistake, but E = 69 mostly is one. The
ranges stand in `usual`; a section's field names its own by its type.
"""

from __future__ import annotations

import math
import typing
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress

import numpy as np

from fenics_joints.case.case import Case
from fenics_joints.case.preload import BeamBoltSection
from fenics_joints.case.usual import USUAL, Usual
from fenics_joints.case.values import CaseSection
from fenics_joints.errors import InputError
from fenics_joints.formatting import quantity
from fenics_joints.preload.threads import thread
from fenics_joints.units import factor_to_si, parameter_unit, to_si

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

    Each names the value, its unit and the usual range of its kind. Equal values of one key in
    several sections make one sentence.
    """
    alike: dict[tuple, list[str]] = {}
    for key, value, usual in _quantities(case):
        if not usual.holds(value):
            alike.setdefault((key.rpartition(".")[2], value, usual), []).append(key)
    said = [_said(keys, value, usual) for (_, value, usual), keys in alike.items()]
    return (*said, *_too_few(case))


def _said(keys: list[str], value: float, usual: Usual) -> str:
    more = f" (and {len(keys) - 1} more with this value)" if len(keys) > 1 else ""
    unit = usual.unit.replace("*", " ")
    low, high = (quantity(v, unit) for v in (usual.low, usual.high))
    given = f"{value:g} {unit}".rstrip()
    meant = [u for u, factor in _FORGOTTEN.get(usual.unit, ()) if usual.holds(value * factor)]
    hint = f"; was '{value:g} {meant[0]}' meant?" if len(meant) == 1 else ""
    return f"{keys[0]}{more} = {given} is unusual: {usual.what} {low} to {high}{hint}"


def _quantities(case: Case) -> Iterator[Found]:
    """All numbers of a case that have a usual range: key, value in SI and the range."""
    yield from _annotated("", case)
    for name, part in case.parts.items():
        if USUAL["E"].holds(part.E) and USUAL["rho"].holds(part.rho):
            yield f"parts.{name}: sqrt(E/rho)", math.sqrt(part.E / part.rho), USUAL["speed"]
    yield from _tolerances(case)
    yield from _starts(case)
    yield from _mesh(case)
    yield from _bolts(case)
    yield from _test(case)
    if case.harmonic is not None and case.harmonic.base is None:
        for i, level in enumerate(case.harmonic.levels):
            yield f"harmonic.levels[{i}]", level, USUAL["level"]


def _annotated(key: str, value: object, ranges: Sequence[Usual] = ()) -> Iterator[Found]:
    """The numbers whose type names a range, in a section and those inside."""
    if isinstance(value, CaseSection):
        for name, field in type(value).model_fields.items():
            inside = list(_ranges_in([*field.metadata, field.annotation]))
            yield from _annotated(f"{key}.{name}".lstrip("."), getattr(value, name), inside)
    elif isinstance(value, dict):
        for name, item in value.items():
            yield from _annotated(f"{key}.{name}", item, ranges)
    elif isinstance(value, list | tuple):
        pair = len(ranges) == len(value) > 1
        for i, item in enumerate(value):
            yield from _annotated(f"{key}[{i}]", item, ranges[i : i + 1] if pair else ranges)
    elif ranges and isinstance(value, float):
        yield key, value, ranges[0]


def _ranges_in(kinds: Iterable[object]) -> Iterator[Usual]:
    """The ranges that types name, and those inside them."""
    for kind in kinds:
        if isinstance(kind, Usual):
            yield kind
        else:
            yield from _ranges_in((*getattr(kind, "__metadata__", ()), *typing.get_args(kind)))


def _mesh(case: Case) -> Iterator[Found]:
    """Thickness against the largest length."""
    along = [getattr(case.mesh, key, None) for key in ("length", "lengths")]
    longest = max((x for given in along if given for x in np.atleast_1d(given)), default=math.inf)
    for value in np.atleast_1d(getattr(case.mesh, "thickness", None) or ()).tolist():
        if USUAL["length"].holds(value):
            words = "the thickness of beams and plates is less than their length,"
            yield "mesh.thickness", value, Usual(words, 0.0, float(longest), "m")


def _tolerances(case: Case) -> Iterator[Found]:
    """Tolerances of parts, and zero ones of a section whose tolerances are all zero: some values
    may be known exactly, but not all. Joints and attached masses may be known to a factor only."""
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
            words = "with this baseline model, starts are"
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


def _stressed_area(bolt) -> float | None:
    if bolt.thread is not None:
        return thread(bolt.thread).stress_area
    if isinstance(bolt, BeamBoltSection) and bolt.diameter is not None:
        return math.pi / 4 * bolt.diameter**2
    return None


def _by_stress(what: str, factor: float, unit: str) -> Usual:
    stress = USUAL["bolt stress"]
    return Usual(what, stress.low * factor, stress.high * factor, unit)


def _test(case: Case) -> Iterator[Found]:
    if case.test is None:
        return
    # Without a given noise, the analyser's line spacing may say how accurate the table is.
    exact = "noise" in case.test.model_fields_set and not any(case.test.resolution)
    for value in case.test.noise:
        if value or exact:
            yield "test.noise", value, USUAL["noise"]
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
