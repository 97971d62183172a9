"""Every public constructor and function refuses values that make no sense, by the argument's name.

`CALLS` has a call that works for each of them, and what each argument must be; whatever is not
that has to end in an `InputError`. What a result or a model is made of inside is no input.
"""

from __future__ import annotations

from functools import cache
from math import inf, nan

import numpy as np
import pytest
import ufl
from contact_blocks import both, faces
from mpi4py import MPI
from odd_values import (
    ABOVE_0,
    ANY,
    COUNT,
    FLAG,
    FROM_0,
    GIVEN,
    MODEL,
    NAMED_ABOVE_0,
    NAMED_FROM_0,
    NO_NUMBER,
    OPTIONS,
    POINT,
    RATIO,
    START,
    TEXT,
    VECTOR,
    WORD,
    not_refused,
)
from oscillators import duffing

from fenics_joints import (
    forms,
    harmonic,
    joint_laws,
    modal,
    preload,
    response,
    structure,
    transient,
)
from fenics_joints.errors import InputError
from fenics_joints.meshes import lap_plates, stacked_blocks
from fenics_joints.structure import Damping, Parameter, PointMass, Sensors, Spring, Structure, part


@cache
def plates(**more):
    """A small structure."""
    layers = ("joint_near", "joint_away")
    regions = [
        part("plates", ("plate_1", "plate_2"), E=2e11, nu=0.3, rho=7800.0),
        structure.joint("layer", layers, E=1e9, G="layer.G"),
    ]
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1)
    return Structure(tagged, regions, [Parameter("layer.G", 4e8)], degree=1, **more)


@cache
def blocks():
    """Two blocks with a contact between them and a bolt."""
    x, z = np.linspace(0, 1, 3), np.linspace(0, 0.5, 3)
    tagged = stacked_blocks(MPI.COMM_SELF, lower=(x, x, -z[::-1]), upper=z)
    held = Structure(tagged, both(), degree=1)
    return preload.PreloadModel(held, [faces()], [preload.WasherForce("b", "bottom", "top", 1e5)])


CURVE = joint_laws.RichardAbbott(E_e=168e6, E_p=1e5, S_y=5.7e5, n=2.5)
AT = Sensors([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
VEC = ufl.as_vector([ufl.as_ufl(0.1)])
NORMAL = ufl.as_vector([0.0, 1.0])
ENDS = {"name": "b", "lower": "bottom", "upper": "top", "force": 1e5}
ODD_ENDS = {"name": TEXT, "lower": (*TEXT, "top"), "upper": TEXT, "force": FROM_0}
T = np.linspace(0.0, 3.0, 301)
FRICTION = {"k_n": ABOVE_0, "k_s": ABOVE_0, "mu": FROM_0}


def of_structure():
    yield (
        Parameter,
        {"name": "p", "value": 1.0, "unit": "m", "lower": 0.1, "log": True},
        {
            "name": TEXT,
            "value": ABOVE_0,
            "unit": (None, 1.0),
            "log": FLAG,
            "lower": tuple(v for v in NO_NUMBER if v != -inf),
            "upper": (None, "text", nan, 0.5, True),
        },
    )
    yield (
        Spring,
        {"name": "s", "stiffness": 1e4, "point": (0, 0, 0), "direction": (0, 0, 1)},
        {
            "name": TEXT,
            "stiffness": (*NAMED_FROM_0, -1e6),
            "point": POINT,
            "direction": VECTOR,
            "share": FROM_0,
        },
    )
    yield (
        PointMass,
        {"name": "m", "mass": 1.0, "point": (0, 0, 0)},
        {
            "name": TEXT,
            "mass": NAMED_FROM_0,
            "point": POINT,
            "direction": VECTOR,
            "share": FROM_0,
            "travel": tuple(v for v in ANY if v != "text"),
        },
    )
    yield (
        structure.Support,
        {"facets": "x_min"},
        {"facets": TEXT, "directions": (None, "x", 1, [3], [-1], [True], [0.5], [None])},
    )
    yield (
        structure.ElasticSupport,
        {"name": "w", "facets": "x", "k_n": 1.0, "k_t": 1.0},
        {"name": TEXT, "facets": TEXT, "k_n": NAMED_FROM_0, "k_t": NAMED_FROM_0},
    )
    solid = {"name": "a", "cells": "b", "E": 2e11, "nu": 0.3, "rho": 7800.0}
    odd = {
        "name": TEXT,
        "cells": (None, "", 1.0, [], [1.0], [""]),
        "normal": VECTOR,
        "E": NAMED_ABOVE_0,
        "rho": NAMED_FROM_0,
    }
    yield (
        part,
        solid,
        odd | {"nu": RATIO, "stretch": NAMED_ABOVE_0, "width": NAMED_ABOVE_0, "across": VECTOR},
    )
    layer = {"name": "a", "cells": "b", "E": 2e9, "G": 1e9, "law": "isotropic"}
    yield (
        structure.joint,
        layer,
        odd | {"G": (*NAMED_ABOVE_0, 0.5e9), "law": WORD, "stretch": NAMED_ABOVE_0},
    )
    ring = {"name": "a", "cells": "b", "E": 2e9, "nu": 0.3, "h": 1e-3, "meshed": 1e-3}
    yield structure.transition, ring, odd | {"nu": RATIO, "h": NAMED_ABOVE_0, "meshed": ABOVE_0}
    yield (
        Sensors,
        {"points": [[0, 0, 0]], "directions": [0, 0, 1]},
        {
            "points": (None, "x", nan, 1.0, [], [1.0], [nan, 0, 0], [[[0, 0, 0]]], [[0, 0], [0]]),
            "directions": (
                None,
                "x",
                nan,
                1.0,
                [],
                [0, 0, 0],
                [1, 0],
                [nan, 0, 0],
                [[1, 0, 0]] * 2,
            ),
        },
    )
    yield (
        Damping,
        {"modal": 0.01},
        {
            "modal": (*NAMED_FROM_0, [None], [-0.1], [0.1, nan]),
            "structural": NAMED_FROM_0,
            "rayleigh": (None, "ab", 1.0, [], [1.0], [1.0, -1.0], [None, None], [1, 2, 3]),
            "viscous": (None, "a", [], 1.0, {"a": None}, {"a": -1.0}),
            "hysteretic": (None, "a", [], 1.0, {"a": nan}, {"a": -1.0}),
        },
    )
    tagged, parts = plates().tagged, plates().regions
    named = [Parameter("layer.G", 1e8)]
    yield (
        Structure,
        {"tagged": tagged, "regions": parts, "parameters": named},
        {
            "tagged": MODEL,
            "regions": (None, "a", 1.0, [None], ["a"], [AT]),
            "parameters": (None, "a", 1.0, [None], ["a"], [1.0], {"layer.G": 1.0}),
            "masses": (None, "a", [None], [Spring("s", 1.0, (0, 0, 0))]),
            "springs": (None, "a", [1]),
            "supports": (None, "a", ["x_min"], [None]),
            "degree": (*COUNT, 4),
            "quadrature_degree": tuple(v for v in COUNT if v is not None and v != 0),
        },
    )


def of_forms():
    yield forms.lame_parameters, {"E": 2e11, "nu": 0.3}, {"E": ABOVE_0, "nu": (*ANY[:-1], 0.5)}
    yield forms.lame_from_moduli, {"E": 2e11, "G": 8e10}, {"E": ABOVE_0, "G": (*ABOVE_0, 1e9)}
    yield (
        forms.uncoupled_layer_stress,
        {"eps_n": 0.1, "gamma_t": VEC, "E_n": 1e9, "G_t": 1e9},
        {"E_n": FROM_0, "G_t": FROM_0},
    )
    jump = ufl.as_vector([0.1, 0.2])
    yield (
        forms.spring_traction,
        {"jump": jump, "normal": NORMAL, "k_n": 1.0, "k_t": 1.0},
        {"k_n": FROM_0, "k_t": FROM_0},
    )
    yield (
        forms.mass,
        {"u": VEC, "v": VEC, "rho": 1.0, "dx": 1.0},
        {"rho": FROM_0, "stretch": ABOVE_0[1:], "width": ABOVE_0[1:]},
    )
    yield (
        forms.attached_mass,
        {"u": VEC, "v": VEC, "m": 1.0, "area": 1.0, "ds": 1.0},
        {"m": FROM_0, "area": ABOVE_0},
    )
    yield forms.average_density, {"rho_1": 1.0, "rho_2": 2.0}, {"rho_1": FROM_0, "rho_2": FROM_0}
    yield forms.penalty_pressure, {"gap": 0.1, "stiffness": 1.0}, {"stiffness": FROM_0}
    yield (
        forms.coulomb_traction,
        {"slip": VEC, "pressure": 1.0, "friction": 0.1, "stiffness": 1.0},
        {"friction": FROM_0, "stiffness": FROM_0},
    )
    yield (
        forms.contact_radius,
        {"head_radius": 1.0, "thickness": 1.0, "cone_angle": 0.5},
        {"head_radius": ABOVE_0, "thickness": FROM_0, "cone_angle": (*FROM_0, 2.0)},
    )
    yield (
        forms.peak_pressure,
        {"force": 1.0, "r_hole": 0.5, "r_contact": 1.0},
        {"force": FROM_0, "r_hole": (*FROM_0, 1.0, 2.0), "r_contact": ABOVE_0},
    )
    yield (
        forms.graded_modulus,
        {"pressure": 1.0, "alpha": 1.0, "beta": 1.0, "thickness": 1.0},
        {
            "pressure": FROM_0,
            "alpha": FROM_0,
            "beta": ABOVE_0,
            "thickness": ABOVE_0,
            "floor": FROM_0,
        },
    )
    ring = {"r": ufl.as_ufl(0.2), "force": 1e9, "r_nei": 0.1, "r_wai": 1.0}
    yield (
        forms.ring_pressure,
        ring,
        {"force": FROM_0, "r_nei": (*FROM_0, 2.0), "r_wai": ABOVE_0, "limit": FROM_0},
    )
    graded = {"position": ufl.as_ufl(0.1), "E": 1.0, "E_lower": 1.0, "E_upper": 1.0}
    yield (
        forms.transition_modulus,
        graded,
        {"E": ABOVE_0, "E_lower": ABOVE_0, "E_upper": ABOVE_0, "through": ABOVE_0, "load": ABOVE_0},
    )
    yield (
        forms.richard_abbott,
        {"strain": 0.1, "E_e": 2.0, "E_p": 1.0, "S_y": 1.0, "n": 2.0},
        {"E_e": ABOVE_0, "E_p": ANY, "S_y": ABOVE_0, "n": ABOVE_0},
    )
    yield (
        forms.segalman,
        {"slip": 0.1, "F_S": 1.0, "K_T": 1.0, "chi": -0.5, "beta": 1.0},
        {"F_S": ABOVE_0, "K_T": ABOVE_0, "chi": (*ANY, -1.0), "beta": FROM_0},
    )
    slide = {"slip": VEC, "position": VEC}
    yield (
        forms.slider,
        slide | {"stiffness": 1.0, "strength": 1.0},
        {"stiffness": ABOVE_0, "strength": FROM_0},
    )
    stick = slide | {"opening": 0.1, "k_n": 1.0, "k_s": 1.0, "mu": 0.1}
    yield forms.coulomb_stick, stick, FRICTION | {"pressure": ANY}
    yield forms.dilatant_coulomb, stick | {"opened": 0.0}, FRICTION | {"pressure": ANY}
    hysteretic = {"slip": VEC, "last": VEC, "z": VEC}
    yield (
        forms.bouc_wen,
        hysteretic | {"beta": 1.0, "gamma": 0.1, "n": 1},
        {"beta": ANY, "gamma": ANY, "n": (*FROM_0, 0.5), "substeps": COUNT},
    )


def of_laws():
    yield (
        joint_laws.RichardAbbott,
        {"E_e": 2.0, "E_p": 1.0, "S_y": 1.0, "n": 2.0},
        {"E_e": (*ABOVE_0, 0.5), "E_p": (*FROM_0, 3.0), "S_y": ABOVE_0, "n": ABOVE_0},
    )
    yield (
        joint_laws.Segalman,
        {"F_S": 1.0, "K_T": 1.0, "chi": -0.5, "beta": 1.0},
        {"F_S": ABOVE_0, "K_T": ABOVE_0, "chi": (*ANY, -1.0), "beta": FROM_0},
    )
    yield (
        joint_laws.Bilinear,
        {"E_e": 2.0, "S_y": 1.0},
        {"E_e": ABOVE_0, "S_y": ABOVE_0, "E_p": (*FROM_0, 3.0)},
    )
    sliders = {"amplitudes": ("ab", 1.0, [], [1.0], [0.0, 1.0], [2.0, 1.0], [nan, 1.0])}
    yield (
        joint_laws.Iwan,
        {"backbone": CURVE, "n_sliders": 6},
        sliders | {"backbone": MODEL, "n_sliders": COUNT, "thickness": ABOVE_0},
    )
    yield (
        joint_laws.IwanLayer,
        {"backbone": CURVE, "G": 6e7, "n_sliders": 6},
        sliders | {"backbone": MODEL, "G": ABOVE_0, "n_sliders": COUNT},
    )
    yield (
        joint_laws.iwan_sliders,
        {"backbone": CURVE, "n": 6},
        sliders
        | {"backbone": MODEL, "n": COUNT, "edges": ("ab", 1.0, [], [0.0, -1.0], [1.0, 2.0])},
    )
    yield joint_laws.slider_edges, {"backbone": CURVE, "n": 6}, sliders | {"n": COUNT}
    arrays = tuple(v for v in ABOVE_0 if v != [])
    coulomb = {"normal_stiffness": 1.0, "tangential_stiffness": 1.0, "friction": 0.3}
    for law in (joint_laws.CoulombStick, joint_laws.DilatantCoulomb):
        yield (
            law,
            coulomb,
            {
                "normal_stiffness": arrays,
                "tangential_stiffness": arrays,
                "friction": tuple(v for v in FROM_0 if v != []),
                "pressure": arrays[:4],
            },
        )
    yield (
        joint_laws.BoucWen,
        {"stiffness": 1.0, "ratio": 0.1, "beta": 1.0, "gamma": 0.1},
        {"stiffness": arrays, "n": arrays, "substeps": COUNT},
    )
    yield (
        joint_laws.Valanis,
        {"E_0": 2.0, "E_t": 1.0, "rate": 1.0},
        {"E_0": arrays, "rate": arrays, "E_t": (None, "text", nan, -1.0, 3.0)},
    )


def of_preload():
    yield (
        preload.Contact,
        {"name": "c", "lower": "bottom", "upper": "top"},
        {
            "name": TEXT,
            "lower": (*TEXT, "top"),
            "upper": TEXT,
            "gap": ANY,
            "bonded": FLAG,
            "friction": (*(v for v in FROM_0 if v != inf), 1e9),
            "tolerance": ABOVE_0[1:],
        },
    )
    yield preload.WasherForce, ENDS, ODD_ENDS | {"axis": VECTOR[1:]}
    yield preload.PretensionSection, ENDS, ODD_ENDS | {"axis": VECTOR[1:]}
    yield (
        preload.BeamBolt,
        ENDS | {"diameter": 0.01},
        ODD_ENDS
        | {
            "diameter": ABOVE_0,
            "E": ABOVE_0,
            "nu": (*ANY, 0.5, -1.0),
            "rho": FROM_0,
            "head_mass": FROM_0,
            "n_elements": COUNT,
        },
    )
    yield (
        preload.Traction,
        {"name": "t", "facets": "top", "force": (0.0, 0.0, 1.0)},
        {
            "name": TEXT,
            "facets": TEXT,
            "force": (None, "x", 1.0, [], [1.0], [nan, 0, 0]),
            "profile": ("x", 1.0),
        },
    )
    yield (
        preload.Pressure,
        {"name": "p", "facets": "top", "pressure": 1e5},
        {"name": TEXT, "facets": TEXT, "pressure": ANY},
    )
    plane = preload.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    yield (
        preload.Obstacle,
        {"name": "o", "facets": "top", "shape": plane},
        {
            "name": TEXT,
            "facets": TEXT,
            "gap": ANY,
            "shape": (None, "x", 1.0),
            "friction": (*(v for v in FROM_0 if v != inf), 1e9),
            "force": VECTOR[1:],
            "travel": ("x", 1.0, [nan, 0, 0]),
        },
    )
    model = blocks()
    twice = [
        preload.WasherForce("b", "bottom", "top", 1.0),
        preload.WasherForce("c", "left", "top", 1.0),
    ]
    yield (
        preload.PreloadModel,
        {"structure": model.structure, "contacts": [faces()]},
        {
            "structure": MODEL,
            "contacts": (None, "c", [None], ["c"]),
            "loads": (None, "a", [1.0]),
            "bolts": (None, "a", [None], [1.0], twice),
        },
    )
    yield (
        preload.solve_preload,
        {"model": model},
        {
            "model": (*MODEL, preload.PreloadModel(model.structure, [faces()])),
            "forces": (*GIVEN, *({"b": v} for v in FROM_0)),
            "given": GIVEN,
            "initial": (*START, AT),
            "method": ("", "other", 1.0, True),
            "penalty": (1.0, "text"),
            "petsc_options": (*OPTIONS, {"snes_type": "nonsense"}),
        },
    )
    thread = {"thread_": "M12"}
    yield (
        preload.motosh_force,
        thread | {"torque": 1.0, "friction_thread": 0.1, "friction_head": 0.1},
        {
            "torque": FROM_0,
            "friction_thread": FROM_0,
            "friction_head": FROM_0,
            "thread_": (None, "", "M", 12, nan, True),
            "head_radius": ABOVE_0[1:],
        },
    )
    yield (
        preload.nut_factor_force,
        {"torque": 1.0, "diameter": 0.012},
        {"torque": FROM_0, "diameter": ABOVE_0, "K": ABOVE_0},
    )
    yield (
        preload.friction_from,
        thread | {"torque": 60.0, "force": 2e4},
        {"torque": (*ABOVE_0, 1e-9), "force": ABOVE_0},
    )
    yield preload.thread, {"name": "M12"}, {"name": (None, "", "M", 12, nan, True, [])}


def of_responses():
    modes = {"model": plates(), "n_modes": 8}
    yield (
        modal.solve_modes,
        modes,
        {
            "model": MODEL,
            "given": (*GIVEN, {"layer.G": None}, {"layer.G": "x"}, {"layer.G": nan}),
            "n_modes": COUNT,
            "shift_hz": FROM_0[1:],
            "tolerance": ABOVE_0[1:],
            "method": WORD,
            "initial": START,
            "petsc_options": (*OPTIONS, {"eps_type": "nonsense"}),
        },
    )
    yield (
        modal.EigenSolver,
        {"n": 3},
        {
            "n": COUNT,
            "shift": (*ANY, 1.0),
            "tol": (*ABOVE_0, 0.1),
            "block": COUNT[1:],
            "max_restarts": (None, "x", nan, -1, 2.5),
            "petsc_options": OPTIONS,
        },
    )
    yield (
        modal.IterativeEigenSolver,
        {"n": 3, "shift": -1.0},
        {
            "n": COUNT,
            "shift": (*ANY, 0.0, 1.0),
            "tol": (*ABOVE_0, 0.1),
            "max_iterations": COUNT,
            "petsc_options": OPTIONS,
        },
    )
    places = (None, "x", 1.0, [0, 0, 0], Sensors(np.zeros((0, 3)), np.zeros((0, 3))))
    frf = {"model": plates(), "frequencies_hz": [10.0], "excitation": AT, "sensors": AT}
    yield (
        response.solve_frf,
        frf,
        {
            "model": MODEL,
            "given": GIVEN,
            "excitation": places,
            "sensors": places,
            "frequencies_hz": (*ABOVE_0, [0.0], [nan, 1.0], [[1.0]]),
            "damping": (1.0, "x", 0.01),
            "kind": WORD,
            "method": WORD,
            "gradients": FLAG,
            "n_modes": COUNT[1:],
            "check": (None, "x", -1, 2.5),
        },
    )
    damped = {"structure": plates(), "damping": Damping(structural=0.01), "n_modes": 8}
    yield (
        response.solve_complex_modes,
        damped,
        {
            "structure": MODEL,
            "given": GIVEN,
            "damping": (1.0, "x"),
            "n_modes": COUNT,
            "method": WORD,
            "gradients": FLAG,
            "tolerance": ABOVE_0,
        },
    )


def of_vibration():
    band = (None, "ab", 1.0, [], [1.0], [2.0, 1.0], [0.0, 1.0], [nan, 1.0], [1.0, inf])
    equations = {"harmonics": COUNT, "cycles": COUNT, "samples": (*COUNT[1:], 3)}
    forced = {"model": duffing(), "force": "push", "amplitude": 1e-3, "at": [0.1]}
    yield (
        harmonic.solve_harmonic,
        forced,
        equations
        | {
            "model": MODEL,
            "force": WORD,
            "amplitude": ABOVE_0,
            "sensor": WORD[1:],
            "measure": WORD,
            "settings": ("x", 1.0, {}),
            "initial": START,
            "at": (None, "x", [nan], [-1.0], [], ["x"]),
        },
    )
    held = {
        "model": duffing(),
        "force": "push",
        "sensor": "mass",
        "amplitude": 1e-3,
        "band": (0.05, 0.06),
    }
    yield (
        harmonic.solve_constant_response,
        held,
        equations
        | {
            "model": MODEL,
            "force": WORD,
            "amplitude": ABOVE_0,
            "band": band,
            "kind": WORD,
            "direction": WORD,
            "settings": ("x", 1.0),
        },
    )
    moved = {"model": duffing(), "amplitudes": (0.01, 0.02)}
    yield (
        harmonic.solve_backbone,
        moved,
        equations
        | {
            "model": MODEL,
            "amplitudes": band,
            "near": ABOVE_0[1:],
            "sensor": WORD[1:],
            "force": WORD[1:],
        },
    )
    yield (
        harmonic.Settings,
        {},
        {
            "step": (*ABOVE_0, 1.0),
            "max_step": (*ABOVE_0, 1e-3),
            "min_step": (*ABOVE_0, 1.0),
            "max_points": COUNT,
            "max_iterations": COUNT,
            "keep": FLAG,
            "tolerance": (*ABOVE_0, 1.0),
            "wanted_jacobians": COUNT,
            "save_every": COUNT,
        },
    )
    yield (
        harmonic.Fourier,
        {"harmonics": 3, "samples": 16},
        {"harmonics": COUNT, "samples": (*COUNT, 7)},
    )
    yield (
        transient.solve_transient,
        {"model": duffing(), "step": 0.1, "n_steps": 1},
        {
            "model": MODEL,
            "step": ABOVE_0,
            "n_steps": COUNT,
            "start": ANY,
            "loads": ({"push": 1.0}, {"nowhere": np.sin}),
            "sensors": ("mass", ["nothing"]),
            "initial": (*START, ("a", "b", "c"), (None, [nan], None)),
            "petsc_options": (*OPTIONS, {"ts_type": "nonsense"}),
        },
    )
    signal = np.exp(-T / 10) * np.cos(20 * T)
    yield (
        transient.ring_down,
        {"times": T, "signal": signal},
        {
            "times": (None, "x", [], 1.0, T[::-1], np.full(301, nan)),
            "signal": (None, "x", [], 1.0, T[:5], np.full(301, nan), 0 * T),
        },
    )
    yield (
        transient.steady_harmonics,
        {"times": T, "signal": signal, "frequency": 1.0},
        {
            "times": (None, "x", [], 1.0),
            "signal": (None, "x", [], T[:5]),
            "frequency": ABOVE_0,
            "harmonics": COUNT,
        },
    )


#: By room: what is called, arguments that work, and odd values of each argument.
CALLS = {
    "structure": of_structure,
    "forms": of_forms,
    "joint_laws": of_laws,
    "preload": of_preload,
    "modal, response": of_responses,
    "harmonic, transient": of_vibration,
}


@pytest.mark.parametrize("rooms", CALLS)
def test_odd_values_are_refused(rooms):
    # UFL works with complex numbers.
    wrong = not_refused(CALLS[rooms](), skip=complex if rooms == "forms" else ())
    assert not wrong, "\n".join(wrong)


def test_option_that_no_solver_reads_is_said():
    with pytest.warns(UserWarning, match="eps_bogus"):
        modal.solve_modes(plates(), n_modes=8, petsc_options={"eps_bogus": 1})


def test_structure_without_mass_is_refused():
    weightless = [part("plates", ("plate_1", "plate_2"), E=2e11, nu=0.3, rho=0.0)]
    layers = structure.joint("layer", ("joint_near", "joint_away"), E=1e9, G=4e8)
    tagged = lap_plates(MPI.COMM_SELF, element_size=0.04, n_thickness=1)
    with pytest.raises(InputError, match="mass"):
        modal.solve_modes(Structure(tagged, [*weightless, layers], degree=1), n_modes=8)
