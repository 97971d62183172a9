"""Stiffness per area of joints whose case gives none: from pressure and roughness."""

from __future__ import annotations

import math
from statistics import fmean

from fenics_joints.case.case import Case
from fenics_joints.case.sections import JointSection
from fenics_joints.forms import combined_roughness, rough_contact_stiffness

#: Ra of faces of which nothing is said, m. Assumed: grade N7 of ISO 1302, common for faces that are
#: milled, turned or ground; drawings have half or twice as much just as often.
_RA = 1.6e-6
#: Stiffness per area of clamped metal faces, Pa/m, of which nothing is known; never solved with.
_USUAL = 1e12


def start_joints(case: Case) -> list[str]:
    """Give k_n and k_t to all joints of a case with ``law = "springs"``; a line for each failure.

    The pressure is the joint's, or the force of one bolt of ``[mesh.bolts]`` over the area of its
    ring. As the stiffness is in proportion to the pressure, that of a whole ring is F / (gamma
    h_rms), however large the ring and however the pressure is spread over it.
    """
    notes, errors = {}, []
    for name, joint in list(case.joints.items()):
        if joint.law != "springs" or joint.k_n is not None:
            continue
        pressure, where = _pressure(case, joint)
        if pressure is None:
            errors.append(f"joints.{name}: {where}")
            # So that whoever goes on to look for other errors can.
            case.joints[name] = joint.model_copy(update={"k_n": _USUAL, "k_t": _USUAL})
            continue
        ra = joint.roughness or _RA
        nu = min(max(fmean(part.nominal()["nu"] for part in case.parts.values()), 0.0), 0.499)
        k_n, k_t = rough_contact_stiffness(pressure, combined_roughness(ra), nu)
        case.joints[name] = joint.model_copy(update={"k_n": k_n, "k_t": k_t})
        assumed = "" if joint.roughness else " (assumed: the case gives none)"
        words = (
            f"k_n = {k_n:.3g} Pa/m and k_t = {k_t:.3g} Pa/m are where to start "
            f"from, within a factor of three or so: rough faces of Ra {1e6 * ra:g} um{assumed} "
            f"under {1e-6 * pressure:.3g} MPa, {where} (k_n = p / (0.5 h_rms), Persson 2007; "
            "k_t / k_n = 2 (1 - nu) / (2 - nu), Mindlin 1949)"
        )
        notes.setdefault(words, []).append(name)
    case._joint_notes = tuple(f"joints.{', '.join(of)}: {words}" for words, of in notes.items())
    return errors


def _pressure(case: Case, joint: JointSection) -> tuple[float | None, str]:
    """The pressure, Pa, and where it is from; or None and what is missing."""
    if joint.pressure is not None:
        return joint.pressure, "as given"
    bolts = getattr(case.mesh, "bolts", None)
    expected = "expected k_n and k_t; or pressure; or force, or torque and thread, in [mesh.bolts]"
    if bolts is None:
        return None, f"no stiffness and no pressure is given: {expected}"
    force = bolts.preload()
    if force is None:
        return None, f"no stiffness is given, and [mesh.bolts] has no force: {expected}"
    outer, words = bolts.extent()
    inner = bolts.inner()
    areas = [math.pi * (radius**2 - inner**2) for radius in outer]
    if min(areas) <= 0:
        return None, (
            f"the rings of [mesh.bolts] have an outer radius of {1e3 * min(outer):g} mm and a "
            f"hole of {1e3 * inner:g} mm: expected a ring"
        )
    said = f"{1e-3 * force:.3g} kN over a ring of {1e3 * inner:.3g} to {1e3 * max(outer):.3g} mm"
    return force / fmean(areas), f"{said} ({words})"
