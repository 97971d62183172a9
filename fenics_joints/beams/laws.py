"""Scalars in which the matrices of beams and joint elements are linear, as laws of regions.

A beam is one region with its stiffness and the first of its mass terms, and one region without
stiffness for each further mass term: a region of `reduction.affine` has a single scalar of
mass, and that of a Timoshenko beam depends on Poisson's ratio and on the height in nine.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fenics_joints.beams.element import bending_number
from fenics_joints.errors import InputError
from fenics_joints.reduction.files import register
from fenics_joints.structure.laws import Law

#: Properties of a beam's region: E, Pa; nu; rho, kg/m3; stretch and width, actual over nominal
#: height and breadth; height, breadth and length of the element, m; shear coefficient; offset of
#: the neutral axis over the height, in the stiffness and in the mass.
SECTION = (
    "E",
    "nu",
    "rho",
    "stretch",
    "width",
    "height",
    "breadth",
    "length",
    "shear",
    "offset",
    "mass_offset",
)
_POSITIVE = {
    "E": "Pa",
    "stretch": "",
    "width": "",
    "height": "m",
    "breadth": "m",
    "length": "m",
    "shear": "",
}


def _positive(where: str, key: str, value, unit: str) -> None:
    """Also for many values at a time, as sampling asks for."""
    if isinstance(value, float) and 0 < value < np.inf:
        return
    good = np.isfinite(value) & (np.asarray(value) > 0)
    if not np.all(good):
        bad = np.atleast_1d(value)[~np.atleast_1d(good)][0]
        raise InputError(
            f"{where}.{key} = {bad:g} is out of range: expected {key} > 0 {unit}".rstrip() + "."
        )


def _check_section(where: str, q) -> None:
    for key, unit in _POSITIVE.items():
        _positive(where, key, q[key], unit)
    alone = isinstance(q["nu"], float) and isinstance(q["rho"], float)
    if alone and -1 < q["nu"] < 0.5 and q["rho"] >= 0:
        return
    if not np.all(q["rho"] >= 0):
        rho = np.min(q["rho"])
        raise InputError(f"{where}.rho = {rho:g} is out of range: expected rho >= 0 kg/m3.")
    nu = np.atleast_1d(q["nu"])
    bad = nu[~((nu > -1) & (nu < 0.5))]
    if len(bad):
        raise InputError(f"{where}.nu = {bad[0]:g} is out of range: expected -1 < nu < 0.5.")


def _section(q):
    """Height, m, area, m2, and phi."""
    height = q["height"] * q["stretch"]
    phi = bending_number(q["nu"], height, q["length"], q["shear"])
    return height, height * q["breadth"] * q["width"], phi


def _beam_stiffness(q) -> np.ndarray:
    height, area, phi = _section(q)
    EA, arm = q["E"] * area, q["offset"] * height
    EI = EA * height**2 / 12
    return np.array([EA, EA * arm, EA * arm**2 + EI, EI / (1 + phi)])


def _beam_mass(number: int) -> Callable:
    """The factor of a matrix of `mass_matrices`."""

    def heavy(q):
        height, area, phi = _section(q)
        if number < 3:
            return q["rho"] * area * (q["mass_offset"] * height) ** number
        by_phi, across = (number - 3) % 3, height**2 / 12 if number > 5 else 1.0
        return q["rho"] * area * across * phi**by_phi / (1 + phi) ** 2

    return heavy


def _no_stiffness(q) -> np.ndarray:
    return np.zeros((0, *np.shape(q["E"])))


def _none(*arguments):
    raise NotImplementedError("laws of beams have matrices, no forms")


def _law(name, properties, terms, check, heavy) -> Law:
    return Law(name, properties, _none, terms, (), check, inertia=_none, inertia_term=heavy)


def _check_lapped(where: str, q) -> None:
    _check_section(where, q)
    _positive(where.partition(".")[0], "axial", q["axial"], "")


def _check_axial(where: str, q) -> None:
    joint = where.rpartition(".")[0] or where
    _positive(joint, "axial", q["axial"], "")
    # Without any, what is left is a lap that slides.
    if not np.all(np.asarray(q["k_axial"]) == 0):
        _positive(joint, "k_axial", q["k_axial"], "N/m")


def _joint_law(name: str, key: str, unit: str) -> Law:
    def check(where, q):
        _positive(where.rpartition(".")[0] or where, key, q[key], unit)

    return _law(name, (key,), lambda q: np.array([q[key]]), check, lambda q: 0.0 * q[key])


#: A beam by itself.
BEAM = _law("offset beam", SECTION, _beam_stiffness, _check_section, _beam_mass(0))
#: A beam in a lap: the joint elements have its stiffness, all but the axial one.
LAPPED = _law(
    "lapped beam",
    (*SECTION, "axial"),
    lambda q: q["axial"] * _beam_stiffness(q)[:1],
    _check_lapped,
    _beam_mass(0),
)
#: The further terms of a beam's mass.
BEAM_MASSES = tuple(
    _law(f"beam mass {i}", SECTION, _no_stiffness, _check_section, _beam_mass(i))
    for i in range(1, 9)
)
#: Generic joint elements (Jalali et al. 2019, eq. 2): k1, k2 in N m, k_axial in N/m.
SLAP = _joint_law("slap", "k1", "N m")
SLIP = _joint_law("slip", "k2", "N m")
AXIAL = _law(
    "axial",
    ("k_axial", "axial"),
    lambda q: np.array([q["k_axial"] * q["axial"]]),
    _check_axial,
    lambda q: 0.0 * q["k_axial"],
)

register(BEAM, LAPPED, *BEAM_MASSES, SLAP, SLIP, AXIAL)
