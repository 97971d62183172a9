"""The material laws a structure can hold, each built on the pure functions of `forms`.

A `Law` adds to these functions the names of the properties, the range where they make sense, and
the scalars in which the stiffness is linear. A parametric reduced
model needs only these scalars to be exact in the properties (`fenics_joints.reduction.reduced`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import ufl

from fenics_joints import forms
from fenics_joints.errors import InputError

Properties = Mapping[str, object]


def _mass(u, v, q: Properties, dx) -> ufl.Form:
    return forms.mass(u, v, q["rho"], dx, stretch=q["stretch"])


def _wide_mass(u, v, q: Properties, dx) -> ufl.Form:
    return forms.mass(u, v, q["rho"], dx, stretch=q["stretch"], width=q["width"])


def _transition_mass(u, v, q: Properties, dx) -> ufl.Form:
    return forms.transition_mass(u, v, q["rho"], dx, thickness=q["h"], meshed=q["meshed"])


def _axisymmetric_mass(u, v, q: Properties, dx) -> ufl.Form:
    return forms.axisymmetric_mass(u, v, q["rho"], dx, radius=_radius(dx), stretch=q["stretch"])


@dataclass(frozen=True, eq=False)
class Law:
    """A linear material law with properties that may vary from cell to cell.

    Attributes:
        name: Name in case files and messages.
        properties: Names of the properties, in the order of the property field.
        stiffness: ``(u, v, q, normal, dx) -> Form`` with ``q`` the properties by name; that of a
            law with a ``width`` takes its direction ``across`` besides.
        stiffness_terms: ``q -> (n,)`` scalars theta_i(q) such that the stiffness is
            sum theta_i(q) K_i with K_i independent of q; works on numpy arrays, complex too.
        samples: As many property sets as there are scalars, for which these are independent.
        check: ``(name, q) -> None``; raises InputError when the properties make no sense.
        ratio_limit: E / G must stay below this, if the law couples them.
        inertia: ``(u, v, q, dx) -> Form``, the consistent mass.
        inertia_term: ``q -> rho(q)``, the scalar in which the mass is linear.
        is_joint: Whether it holds a thin layer between parts.
        units: SI units of properties that are its own (`fenics_joints.structure.joint_law`).
        bounds: Bounds of these for updating, where it has any.
        digest: Of such a law's numbers, for results that are kept.
        along: ``(law, normal) -> Law``, such a law with its check for a layer of that normal.
        at_jump: ``normal -> [(3, 3), ...]``, of such a law of the displacement jump: the traction
            by the jump at each sample.
    """

    name: str
    properties: tuple[str, ...]
    stiffness: Callable
    stiffness_terms: Callable[[Properties], np.ndarray]
    samples: tuple[Properties, ...]
    check: Callable[[str, Properties], None]
    ratio_limit: float | None = None
    inertia: Callable = _mass
    inertia_term: Callable[[Properties], float] = lambda q: q["rho"] * q["stretch"]
    is_joint: bool = False
    units: Mapping[str, str] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    digest: str = ""
    along: Callable[[Law, tuple[float, ...]], Law] | None = None
    at_jump: Callable[[np.ndarray], list[np.ndarray]] | None = None


def _radius(dx):
    return ufl.SpatialCoordinate(dx.ufl_domain())[0]


_EXPECTED = {
    "E": "E > 0 (Pa)",
    "G": "G > 0 (Pa)",
    "nu": "-1 < nu < 0.5",
    "rho": "rho >= 0 (kg/m3)",
    "stretch": "stretch > 0",
    "width": "width > 0",
    "h": "h > 0 (m)",
    "meshed": "meshed > 0 (m)",
    "k_n": "k_n >= 0 (Pa/m)",
    "k_t": "k_t >= 0 (Pa/m)",
}
_MAY_BE_ZERO = ("rho", "k_n", "k_t")


def _require(where: str, key: str, value, good, expected: str) -> None:
    if not good.all():
        shown = np.asarray(value).flat[int(np.argmin(np.broadcast_to(good, np.shape(value))))]
        raise InputError(f"{where}.{key} = {shown:g} is out of range: expected {expected}.")


def _check(where: str, q: Properties) -> None:
    for key, value in q.items():
        value = np.asarray(value)
        if key == "nu":
            good = (value > -1) & (value < 0.5)
        else:
            good = value >= 0 if key in _MAY_BE_ZERO else value > 0
        _require(where, key, value, good, _EXPECTED[key])


def _check_isotropic(where: str, q: Properties) -> None:
    _check(where, q)
    E, G = np.asarray(q["E"]), np.asarray(q["G"])
    _require(
        where, "E", E, E < 3 * G, f"E < 3 G (G = {np.max(G):g} Pa) in an isotropic layer (nu < 0.5)"
    )


def _with_stretch(moduli, q: Properties) -> np.ndarray:
    """Every modulus times s, 1 and 1/s: in-plane, mixed and through-thickness gradients."""
    s = q["stretch"]
    return np.array([m * f for m in moduli for f in (s, 1.0, 1 / s)])


def _solid_stiffness(u, v, q, normal, dx):
    return forms.elasticity(u, v, q["E"], q["nu"], dx, normal=normal, stretch=q["stretch"])


def _wide_stiffness(u, v, q, normal, dx, *, across):
    more = {"normal": normal, "stretch": q["stretch"], "across": across, "width": q["width"]}
    return forms.elasticity(u, v, q["E"], q["nu"], dx, **more)


def _transition_stiffness(u, v, q, normal, dx):
    more = {"normal": normal, "thickness": q["h"], "meshed": q["meshed"]}
    return forms.transition_layer(u, v, q["E"], q["nu"], dx, **more)


def _transition_terms(q: Properties) -> np.ndarray:
    return SOLID.stiffness_terms({**q, "stretch": q["h"] / q["meshed"]})


def _support_stiffness(u, v, q, normal, ds):
    return forms.spring_interface(u, v, normal, q["k_n"], q["k_t"], ds)


def _spring_stiffness(u, v, q, normal, dx):
    E, G = q["k_n"] * q["meshed"], q["k_t"] * q["meshed"]
    return forms.uncoupled_layer(u, v, normal, E, G, dx)


def _spring_mass(u, v, q, dx):
    return forms.mass(u, v, q["rho"], dx)


def _wide_terms(q: Properties) -> np.ndarray:
    """Both Lamé parameters times s w over the stretches of the two gradients that meet."""
    s, w = q["stretch"], q["width"]
    factors = (s * w, w, s, w / s, s / w, 1.0)
    return np.array([m * f for m in forms.lame_parameters(q["E"], q["nu"]) for f in factors])


def _axisymmetric_stiffness(u, v, q, normal, dx):
    more = {"radius": _radius(dx), "normal": normal, "stretch": q["stretch"]}
    return forms.axisymmetric_elasticity(u, v, q["E"], q["nu"], dx, **more)


def _isotropic_stiffness(u, v, q, normal, dx):
    return forms.isotropic_layer(u, v, q["E"], q["G"], dx, normal=normal, stretch=q["stretch"])


def _uncoupled_stiffness(u, v, q, normal, dx):
    return forms.uncoupled_layer(u, v, normal, q["E"], q["G"], dx, stretch=q["stretch"])


def _constrained_stiffness(u, v, q, normal, dx):
    return forms.constrained_layer(u, v, normal, q["E"], q["G"], dx, stretch=q["stretch"])


def _uncoupled_terms(q: Properties) -> np.ndarray:
    E, G, s = q["E"], q["G"], q["stretch"]
    return np.array([E / s, G / s, G * np.ones_like(s), G * s])


def _constrained_terms(q: Properties) -> np.ndarray:
    lmbda, mu = forms.lame_from_moduli(q["E"], q["G"])
    return _uncoupled_terms({"E": lmbda + 2 * mu, "G": mu, "stretch": q["stretch"]})


def _samples(*bases: dict) -> tuple[dict, ...]:
    """Each base at three stretches."""
    return tuple({**base, "rho": 1.0, "stretch": s} for base in bases for s in (0.5, 1.0, 2.0))


#: Properties of a layer that has a normal modulus alone.
_UNCOUPLED_SAMPLES = ({"E": 1.0, "G": 0.0, "rho": 1.0, "stretch": 1.0},)

SOLID = Law(
    "solid",
    ("E", "nu", "rho", "stretch"),
    _solid_stiffness,
    lambda q: _with_stretch(forms.lame_parameters(q["E"], q["nu"]), q),
    _samples({"E": 2.0, "nu": 0.0}, {"E": 2.0, "nu": 0.3}),
    _check,
)

#: A solid whose width is a property too: twice as many scalars, so only where it is wanted.
WIDE_SOLID = Law(
    "wide solid",
    (*SOLID.properties, "width"),
    _wide_stiffness,
    _wide_terms,
    tuple(
        {"E": 2.0, "nu": nu, "rho": 1.0, "stretch": s, "width": w}
        for nu in (0.0, 0.3)
        for s, w in ((1.0, 1.0), (2.0, 1.0), (0.5, 1.0), (1.0, 2.0), (1.0, 0.5), (2.0, 2.0))
    ),
    _check,
    inertia=_wide_mass,
    inertia_term=lambda q: q["rho"] * q["stretch"] * q["width"],
)

#: The transition-interface material (Machines 2022): a joint whose thickness h, m, is a property.
TRANSITION = Law(
    "transition",
    ("E", "nu", "rho", "h", "meshed"),
    _transition_stiffness,
    _transition_terms,
    tuple(
        {"E": 2.0, "nu": nu, "rho": 1.0, "h": h, "meshed": 1.0}
        for nu in (0.0, 0.3)
        for h in (0.5, 1.0, 2.0)
    ),
    _check,
    inertia=_transition_mass,
    inertia_term=lambda q: q["rho"] * q["h"] / q["meshed"],
    is_joint=True,
)

#: Springs of zero thickness: a joint by its stiffness per area, on a layer as thick as meshed.
SPRINGS = Law(
    "springs",
    ("k_n", "k_t", "rho", "meshed"),
    _spring_stiffness,
    lambda q: np.array([q["k_n"] * q["meshed"], q["k_t"] * q["meshed"]]),
    (
        {"k_n": 1.0, "k_t": 0.0, "rho": 1.0, "meshed": 1.0},
        {"k_n": 0.0, "k_t": 1.0, "rho": 1.0, "meshed": 1.0},
    ),
    _check,
    inertia=_spring_mass,
    inertia_term=lambda q: q["rho"],
    is_joint=True,
)

# Stretched along its axis a body of revolution has the same scalars as any solid.
AXISYMMETRIC_SOLID = replace(SOLID, stiffness=_axisymmetric_stiffness, inertia=_axisymmetric_mass)

_LAYER_PROPERTIES = ("E", "G", "rho", "stretch")

LAYER_LAWS = {
    law.name: law
    for law in (
        Law(
            "isotropic",
            _LAYER_PROPERTIES,
            _isotropic_stiffness,
            lambda q: _with_stretch(forms.lame_from_moduli(q["E"], q["G"]), q),
            _samples({"E": 2.0, "G": 1.0}, {"E": 2.6, "G": 1.0}),
            _check_isotropic,
            3.0,
            is_joint=True,
        ),
        Law(
            "uncoupled",
            _LAYER_PROPERTIES,
            _uncoupled_stiffness,
            _uncoupled_terms,
            _UNCOUPLED_SAMPLES + _samples({"E": 1.0, "G": 1.0}),
            _check,
            is_joint=True,
        ),
        Law(
            "constrained",
            _LAYER_PROPERTIES,
            _constrained_stiffness,
            _constrained_terms,
            ({"E": 2.0, "G": 1.0, "rho": 1.0, "stretch": 1.0},) + _samples({"E": 2.6, "G": 1.0}),
            _check_isotropic,
            3.0,
            is_joint=True,
        ),
    )
}

#: Springs spread over a face, along its normal and in its plane; they hold facets, not cells.
ELASTIC_SUPPORT = Law(
    "elastic support",
    ("k_n", "k_t"),
    _support_stiffness,
    lambda q: np.array([q["k_n"], q["k_t"]]),
    ({"k_n": 1.0, "k_t": 0.0}, {"k_n": 0.0, "k_t": 1.0}),
    _check,
    inertia_term=lambda q: 0.0 * q["k_n"],
)

#: All laws by name, also those of `fenics_joints.structure.joint_law`. Of a body of revolution the
#: law of a part is another object with the same scalars.
LINEAR_LAWS = {
    law.name: law
    for law in (SOLID, WIDE_SOLID, TRANSITION, SPRINGS, ELASTIC_SUPPORT, *LAYER_LAWS.values())
}
