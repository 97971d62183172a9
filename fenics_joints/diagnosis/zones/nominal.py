"""The nominal model of a diagnosis: the parts bonded, unless the case says otherwise."""

from __future__ import annotations

from fenics_joints.case import Case, parameters
from fenics_joints.forms import lame_from_moduli, lame_parameters
from fenics_joints.structure.structure import Structure


def layer_thickness(structure: Structure) -> dict[str, float]:
    """Thickness, m, of every joint's layer by the joint's name. Collective."""
    return {
        region.name: structure.extent(number)
        for number, region in enumerate(structure.regions)
        if region.is_joint
    }


def bonded_values(case: Case) -> dict[str, float]:
    """Parameter values of the nominal model, with widths and elastic supports, next to rigid.

    By default the parts are bonded, nothing of the joint assumed: the layers, with the uncoupled
    law, get the constrained modulus and the shear modulus of the stiffest part. With ``[diagnose]
    joints = "given"`` they keep the case's own stiffness, as moduli of that law.
    """
    values = {
        p.name: p.value for p in parameters(case, attached=True, width=True, elastic_supports=True)
    }
    nominal = [part.nominal() for part in case.parts.values()]
    stiffest = max(nominal, key=lambda part: part["E"])
    bonded = lame_parameters(stiffest["E"], stiffest["nu"])
    for name, section in case.joints.items():
        if section.law == "generic":
            continue  # no layer: see `fenics_joints.diagnosis.zones.laps.lap_as_one`
        lmbda, mu = bonded
        if case.diagnose.joints == "given":
            if section.law == "uncoupled":
                continue
            lmbda, mu = lame_from_moduli(section.E, section.G)
        values[f"{name}.E"], values[f"{name}.G"] = lmbda + 2 * mu, mu
    return values
