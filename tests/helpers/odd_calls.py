"""Valid calls of public constructors and functions, and the odd values that each accepts."""

from __future__ import annotations

from functools import cache

import measured_world as chain
import numpy as np
import ufl
from bolted_rods import BASELINE, BOLTS, Rods, sensors
from contact_blocks import both, faces
from mpi4py import MPI
from oscillators import BAND, duffing

from fenics_joints import (
    bayes,
    beams,
    database,
    diagnosis,
    forms,
    harmonic,
    interfaces,
    joint_laws,
    measurements,
    meshes,
    modal,
    preload,
    random_fields,
    reduction,
    response,
    structure,
    transient,
    updating,
)
from fenics_joints.case.preload import known_thread
from fenics_joints.measurements import MeasuredCurves, MeasuredFRFs, Target, TestData
from fenics_joints.meshes import lap_plates, stacked_blocks
from fenics_joints.structure import Damping, Parameter, PointMass, Sensors, Spring, Structure, part

CURVE = joint_laws.RichardAbbott(E_e=168e6, E_p=1e5, S_y=5.7e5, n=2.5)
AT = Sensors([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
VEC = ufl.as_vector([ufl.as_ufl(0.1)])
NORMAL = ufl.as_vector([0.0, 1.0])
ENDS = {"name": "b", "lower": "bottom", "upper": "top", "force": 1e5}
T = np.linspace(0.0, 3.0, 301)
N = 3
LINES = np.linspace(10.0, 20.0, 8)
H = np.ones((8, N, 1), dtype=complex)
POINTS, ALONG = np.eye(N), np.tile([0.0, 0.0, 1.0], (N, 1))
SHAPES = np.eye(N)[:, :2]


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


@cache
def rods():
    return Rods(0.05).model()


def seen() -> Target:
    found = modal.solve_modes(rods(), n_modes=5)
    return Target(found.frequencies_hz[1:4], 1e-3)


def box(**arguments):
    return meshes.box(MPI.COMM_SELF, **arguments)


def of_structure():
    yield (
        Parameter,
        {"name": "p", "value": 1.0, "unit": "m", "lower": 0.1, "log": True},
        "unit:empty lower:-1,0 upper:inf",
    )
    yield (
        Spring,
        {"name": "s", "stiffness": 1e4, "point": (0, 0, 0), "direction": (0, 0, 1)},
        "direction:-1 share:0 stiffness:text,0 point:-1",
    )
    yield (
        PointMass,
        {"name": "m", "mass": 1.0, "point": (0, 0, 0)},
        "direction:-1 travel:text,-1,0 share:0 mass:text,0 point:-1",
    )
    yield structure.Support, {"facets": "x_min"}, "directions:[] points:empty,1,[]"
    yield (
        structure.ElasticSupport,
        {"name": "w", "facets": "x", "k_n": 1.0, "k_t": 1.0},
        "k_n:text,0 k_t:text,0",
    )
    solid = {"name": "a", "cells": "b", "E": 2e11, "nu": 0.3, "rho": 7800.0}
    yield part, solid, "stretch:text normal:-1 width:text across:-1 E:text nu:text,0 rho:text,0"
    layer = {"name": "a", "cells": "b", "E": 2e9, "G": 1e9, "law": "isotropic"}
    yield structure.joint, layer, "rho:text,0 stretch:text normal:-1 E:text G:text"
    ring = {"name": "a", "cells": "b", "E": 2e9, "nu": 0.3, "h": 1e-3, "meshed": 1e-3}
    yield structure.transition, ring, "rho:text,0 normal:-1 E:text nu:text,0 h:text"
    yield (
        Sensors,
        {"points": [[0, 0, 0]], "directions": [0, 0, 1]},
        "names:words,[],nans,-1 points:-1 directions:-1",
    )
    yield Damping, {"modal": 0.01}, "modal:text,0 structural:text,0 viscous:{} hysteretic:{}"
    tagged, parts = plates().tagged, plates().regions
    named = [Parameter("layer.G", 1e8)]
    yield (
        Structure,
        {"tagged": tagged, "regions": parts, "parameters": named},
        "masses:[],nans,-1 springs:[],nans,-1 supports:[],nans,-1 changes:[],nans,-1 "
        "axisymmetric:None,0,[]",
    )


def of_forms():
    yield forms.lame_parameters, {"E": 2e11, "nu": 0.3}, "nu:0"
    yield forms.lame_from_moduli, {"E": 2e11, "G": 8e10}, ""
    yield (
        forms.uncoupled_layer_stress,
        {"eps_n": 0.1, "gamma_t": VEC, "E_n": 1e9, "G_t": 1e9},
        "eps_n:* gamma_t:* E_n:0 G_t:0",
    )
    jump = ufl.as_vector([0.1, 0.2])
    yield (
        forms.spring_traction,
        {"jump": jump, "normal": NORMAL, "k_n": 1.0, "k_t": 1.0},
        "jump:* k_n:0 k_t:0",
    )
    yield (
        forms.mass,
        {"u": VEC, "v": VEC, "rho": 1.0, "dx": 1.0},
        "dx:* stretch:1 width:1 u:* v:* rho:0",
    )
    yield (
        forms.attached_mass,
        {"u": VEC, "v": VEC, "m": 1.0, "area": 1.0, "ds": 1.0},
        "u:* v:* m:0 ds:*",
    )
    yield forms.average_density, {"rho_1": 1.0, "rho_2": 2.0}, "rho_1:0 rho_2:0"
    yield forms.penalty_pressure, {"gap": 0.1, "stiffness": 1.0}, "gap:* stiffness:0"
    yield (
        forms.coulomb_traction,
        {"slip": VEC, "pressure": 1.0, "friction": 0.1, "stiffness": 1.0},
        "slip:* pressure:* friction:0 stiffness:0",
    )
    yield (
        forms.contact_radius,
        {"head_radius": 1.0, "thickness": 1.0, "cone_angle": 0.5},
        "thickness:0 cone_angle:0",
    )
    yield (
        forms.peak_pressure,
        {"force": 1.0, "r_hole": 0.5, "r_contact": 1.0},
        "open_hole:None,text,1,0,[] force:0 r_hole:0",
    )
    yield (
        forms.graded_modulus,
        {"pressure": 1.0, "alpha": 1.0, "beta": 1.0, "thickness": 1.0},
        "floor:0 pressure:0 alpha:0",
    )
    ring = {"r": ufl.as_ufl(0.2), "force": 1e9, "r_nei": 0.1, "r_wai": 1.0}
    yield forms.ring_pressure, ring, "limit:0 r:* r_nei:0"
    graded = {"position": ufl.as_ufl(0.1), "E": 1.0, "E_lower": 1.0, "E_upper": 1.0}
    yield forms.transition_modulus, graded, "through:2.5 load:2.5 along:-1,0,2.5 position:*"
    yield (
        forms.richard_abbott,
        {"strain": 0.1, "E_e": 2.0, "E_p": 1.0, "S_y": 1.0, "n": 2.0},
        "strain:* E_p:-1,0",
    )
    yield (
        forms.segalman,
        {"slip": 0.1, "F_S": 1.0, "K_T": 1.0, "chi": -0.5, "beta": 1.0},
        "slip:* chi:0 beta:0",
    )
    slide = {"slip": VEC, "position": VEC}
    yield forms.slider, slide | {"stiffness": 1.0, "strength": 1.0}, "slip:* position:* strength:0"
    stick = slide | {"opening": 0.1, "k_n": 1.0, "k_s": 1.0, "mu": 0.1}
    yield forms.coulomb_stick, stick, "pressure:-1,0 slip:* position:* opening:* mu:0"
    yield (
        forms.dilatant_coulomb,
        stick | {"opened": 0.0},
        "pressure:-1,0 slip:* position:* opening:* mu:0 opened:*",
    )
    hysteretic = {"slip": VEC, "last": VEC, "z": VEC}
    yield (
        forms.bouc_wen,
        hysteretic | {"beta": 1.0, "gamma": 0.1, "n": 1},
        "slip:* last:* z:* beta:-1,0 gamma:-1,0 n:2.5",
    )


def of_laws():
    yield joint_laws.RichardAbbott, {"E_e": 2.0, "E_p": 1.0, "S_y": 1.0, "n": 2.0}, "E_p:0"
    yield joint_laws.Segalman, {"F_S": 1.0, "K_T": 1.0, "chi": -0.5, "beta": 1.0}, "chi:0 beta:0"
    yield joint_laws.Bilinear, {"E_e": 2.0, "S_y": 1.0}, "E_p:0"
    yield joint_laws.Iwan, {"backbone": CURVE, "n_sliders": 6}, ""
    yield joint_laws.IwanLayer, {"backbone": CURVE, "G": 6e7, "n_sliders": 6}, ""
    yield joint_laws.iwan_sliders, {"backbone": CURVE, "n": 6}, ""
    yield joint_laws.slider_edges, {"backbone": CURVE, "n": 6}, ""
    coulomb = {"normal_stiffness": 1.0, "tangential_stiffness": 1.0, "friction": 0.3}
    for law in (joint_laws.CoulombStick, joint_laws.DilatantCoulomb):
        yield (
            law,
            coulomb,
            "pressure:[],-1,0 normal_stiffness:[] tangential_stiffness:[] friction:[],0",
        )
    yield (
        joint_laws.BoucWen,
        {"stiffness": 1.0, "ratio": 0.1, "beta": 1.0, "gamma": 0.1},
        "n:[] stiffness:[] ratio:[],0 beta:[] gamma:[],-1,0",
    )
    yield joint_laws.Valanis, {"E_0": 2.0, "E_t": 1.0, "rate": 1.0}, "E_0:[] E_t:[],0 rate:[]"


def of_preload():
    yield (
        preload.Contact,
        {"name": "c", "lower": "bottom", "upper": "top"},
        "friction:inf,0 gap:-1,0 tolerance:1",
    )
    yield preload.WasherForce, ENDS, "force:0"
    yield preload.PretensionSection, ENDS, "force:0"
    yield preload.BeamBolt, ENDS | {"diameter": 0.01}, "nu:0 rho:0 head_mass:0 force:0"
    yield preload.Traction, {"name": "t", "facets": "top", "force": (0.0, 0.0, 1.0)}, "force:-1"
    yield preload.Pressure, {"name": "p", "facets": "top", "pressure": 1e5}, "pressure:-1,0"
    plane = preload.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    yield (
        preload.Obstacle,
        {"name": "o", "facets": "top", "shape": plane},
        "friction:inf,0 gap:-1,0",
    )
    model = blocks()
    yield (
        preload.PreloadModel,
        {"structure": model.structure, "contacts": [faces()]},
        "bolts:[],nans,-1 loads:[],nans,-1 contacts:[]",
    )
    yield preload.solve_preload, {"model": model}, ""
    thread = {"thread_": "M12"}
    yield (
        preload.motosh_force,
        thread | {"torque": 1.0, "friction_thread": 0.1, "friction_head": 0.1},
        "head_radius:1 torque:0 friction_thread:0 friction_head:0",
    )
    yield preload.nut_factor_force, {"torque": 1.0, "diameter": 0.012}, "torque:0"
    yield preload.friction_from, thread | {"torque": 60.0, "force": 2e4}, "head_radius:1"
    yield preload.thread, {"name": "M12"}, ""


def of_responses():
    modes = {"model": plates(), "n_modes": 8}
    yield modal.solve_modes, modes, "shift_hz:1 solver:* bcs:[],nans,-1"
    yield modal.EigenSolver, {"n": 3}, "shift:-1,0 prefix:*"
    yield modal.IterativeEigenSolver, {"n": 3, "shift": -1.0}, "prefix:* shift:-1"
    frf = {"model": plates(), "frequencies_hz": [10.0], "excitation": AT, "sensors": AT}
    yield response.solve_frf, frf, "modes:text,1,[nan],words,{} frequencies_hz:1"
    damped = {"structure": plates(), "damping": Damping(structural=0.01), "n_modes": 8}
    yield (response.solve_complex_modes, damped, "modes:* damping:None")


def of_vibration():
    forced = {"model": duffing(), "force": "push", "amplitude": 1e-3, "at": [0.1]}
    yield (
        harmonic.solve_harmonic,
        forced,
        "direction:* more:* checkpoint:* resume:None,text,1,0,[] progress:*",
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
        "checkpoint:* resume:None,text,1,0,[] progress:* sensor:None",
    )
    moved = {"model": duffing(), "amplitudes": (0.01, 0.02)}
    yield harmonic.solve_backbone, moved, "near:1 checkpoint:* resume:None,text,1,0,[] progress:*"
    yield harmonic.ContinuationSettings, {}, ""
    yield harmonic.Fourier, {"harmonics": 3, "samples": 16}, ""
    yield (
        transient.solve_transient,
        {"model": duffing(), "step": 0.1, "n_steps": 1},
        "loads:* sensors:* start:-1,0 progress:*",
    )
    signal = np.exp(-T / 10) * np.cos(20 * T)
    yield transient.ring_down, {"times": T, "signal": signal}, ""
    yield (
        transient.steady_harmonics,
        {"times": T, "signal": signal, "frequency": 1.0},
        "times:-1 signal:-1",
    )


def of_measurements():
    test = {"conditions": [1.0], "frequencies_hz": [[5.0, 7.0]], "mode_names": ("a", "b")}
    yield (
        TestData,
        test,
        "condition_name:empty condition_unit:empty resolution_hz:0 noise:0 damping_noise:1 "
        "shape_noise:0 shapes_at:text,1,[nan],words,{} notes:* known:* row_names:* "
        "conditions:1,-1 frequencies_hz:nans",
    )
    yield (
        Target,
        {"frequencies_hz": [5.0, 7.0]},
        "shape_sensors:text,1,[nan],words,{} shape_sd:text,1,[nan],words,{}",
    )
    at = sensors()
    values = np.ones((2, len(at.points), 1), dtype=complex)
    force = sensors(((0.0, 0),))
    frfs = {"frequencies_hz": LINES[:2], "values": values, "sensors": at, "excitation": force}
    yield measurements.FRFTarget, frfs, "values:-1"
    yield (
        MeasuredFRFs,
        {
            "frequencies_hz": LINES,
            "values": H,
            "kind": "receptance",
            "response_points": POINTS,
            "response_directions": ALONG,
            "reference_points": POINTS[:1],
            "reference_directions": ALONG[:1],
        },
        "response_names:[],nans,-1 reference_names:words,[],nans,-1 sources:* notes:* "
        "values:nans,-1 response_points:-1 response_directions:-1 reference_points:-1 "
        "reference_directions:-1",
    )
    yield (
        MeasuredCurves,
        {
            "levels": (1.0,),
            "frequencies_hz": (LINES,),
            "amplitudes": (LINES,),
            "response": "displacement",
        },
        "",
    )
    known = MeasuredFRFs(
        chain.FREQUENCIES, chain.accelerance(), "accelerance", POINTS, ALONG, POINTS, ALONG
    )
    yield measurements.identify_modes, {"frfs": known}, "exponential_window:1"
    yield measurements.mac, {"a": SHAPES, "b": SHAPES}, "a:nans,-1 b:nans,-1"
    yield measurements.made_real, {"shapes": SHAPES + 0j}, "shapes:-1"
    found = modal.solve_modes(rods(), n_modes=6)
    yield measurements.pair_modes, {"modes": found, "n_test": 3}, "threshold:0"


def of_reduction():
    model = rods()
    names = list(BASELINE)
    forward = {"model": model, "sensors": sensors(), "n_test": 3, "n_modes": 5}
    yield reduction.ModalPrediction, forward, "threshold:0 sensors:None"
    free = {"model": model, "free": names[:1]}
    yield reduction.freeze, free, ""
    ranges = {f"{BOLTS[0]}.G": (1e10, 1e11)}
    yield reduction.narrow, {"model": model, "ranges": ranges, "n_modes": 4}, ""


def of_interfaces():
    one = np.ones((1, 1))
    points = duffing().interfaces[0]
    yield interfaces.InterfaceModel, {"M": one, "K": one}, "interfaces:[],nans,-1 M:-1 K:-1"
    good = {"name": "j", "law": points.law, "rows": one[None], "weights": np.ones(1)}
    yield interfaces.InterfacePoints, good, "rows:-1"
    yield interfaces.static_state, {"model": duffing(), "load": np.ones(1)}, "load:-1"
    yield interfaces.with_modal_damping, {"model": duffing(), "ratios": 0.01}, "rest:0 ratios:0"
    yield interfaces.with_rayleigh_damping, {"model": duffing()}, "mass:0 stiffness:0"


def of_updating():
    model, target = rods(), seen()
    name = f"{BOLTS[0]}.G"
    free = [Parameter(name, BASELINE[name], lower=1e9, upper=1e12)]
    fit = {"model": model, "parameters": free, "target": target, "start": {name: 7e10}}
    yield updating.update, fit, "damping:text,1,[nan],words,{} regularisation:1"
    yield updating.update_weighted, fit, "damping:text,1,[nan],words,{} w_f:0 w_H:0 step_limit:1"
    yield modal.identifiability, {"whitened": np.eye(2), "names": ("a", "b")}, "whitened:-1 names:*"
    found = modal.solve_modes(model, n_modes=5)
    yield modal.frequency_sensitivity, {"modes": found, "index": [1]}, "index:[]"


def of_harmonic():
    yield harmonic.Load, {"force": "push", "amplitude": 1.0}, "phase:-1,0 amplitude:-1,0"
    curves = MeasuredCurves((0.01,), (np.linspace(*BAND, 9),), (np.ones(9),), "displacement")
    told = {"model": duffing(), "curves": curves, "force": "push", "sensor": "mass", "points": 3}
    yield harmonic.predict, told, "sensor:None"
    yield harmonic.default_samples, {"model": duffing(), "harmonics": 3}, ""
    yield (
        bayes.rank,
        {"truth": 0.5, "draws": np.linspace(0.0, 1.0, 50), "n": 10},
        "truth:-1,0 draws:deeper,-1",
    )
    yield bayes.calibrate, {"ranks": np.arange(60) % 10, "n": 9}, ""


def of_meshes():
    yield box, {"lengths": (1.0, 1.0, 1.0), "counts": (1, 1, 1)}, ""
    yield meshes.grid_lines, {"edges": [0.0, 1.0], "size": 0.5}, "edges:*"
    yield meshes.graded_lines, {"edges": [0.0, 1.0], "sizes": [0.1, 0.2]}, ""
    yield meshes.LapPlates, {}, "layer:0 bolts:[] zone:0"
    yield meshes.CBeams, {}, "layer:0"
    yield meshes.Dumbbell, {}, "rings:[],nans,-1 r_wai:1 zone:1"
    yield meshes.LapBeam, {}, "washer:0 layer:0 root:0"
    yield meshes.RoundPlates, {"size": 0.01}, ""


def of_beams():
    size = {"name": "b", "length": 1.0, "breadth": 0.1, "height": 0.1, "n_elements": 4}
    yield (
        beams.Beam,
        size | {"E": 2e11, "nu": 0.3, "rho": 7800.0},
        "stretch:text,-1,0 width:text,-1,0 offset:1 E:text,-1,0 nu:text,-1,0 rho:text,-1,0",
    )
    lap = {"name": "j", "length": 0.1, "n_elements": 2, "k1": 1e3, "k2": 1e3}
    yield (
        beams.GenericJoint,
        lap,
        "c:text,-1,0 k_axial:text,1 axial:text,-1,0 k1:text,-1,0 k2:text,-1,0",
    )
    yield (
        beams.LumpedMass,
        {"name": "m", "mass": 1.0, "point": (0.0, 0.0, 0.0)},
        "radius:0 travel:text,-1,0 share:0 mass:text,0 point:-1",
    )
    yield beams.Held, {"x": 0.0}, "motions:twice x:-1,0"
    yield beams.Clamp, {"name": "c", "last": True, "k_n": 1.0, "k_t": 1.0}, "k_n:text,0 k_t:text,0"


def of_statistics():
    yield bayes.Settings, {}, ""
    table = np.full((8, 2), 100.0) + np.arange(16).reshape(8, 2)
    yield (
        bayes.Specimens,
        {"mode_names": ("a", "b"), "frequencies_hz": table},
        "discrepancy:0 mode_names:* frequencies_hz:*",
    )
    yield (
        random_fields.RandomField,
        {"names": ("a", "b"), "eps": 0.1},
        "expansion:* names:text,words",
    )
    points = np.linspace(0.0, 1.0, 5)
    yield random_fields.karhunen_loeve, {"points": points, "length": 0.5}, "points:deeper,-1"
    yield (
        diagnosis.Prior,
        {"name": "p", "median": 1.0, "spread": 0.1},
        "unit:* span:* even:None,text,1,0,[] also:*",
    )


def of_databases():
    joint = {"diameter": 0.012, "radius": 0.04}
    yield (
        database.JointRow,
        joint,
        "force:1 torque:1 thickness:1 roughness:1 pressure:1 E:1 h:1 bolt:text author:text "
        "model:text version:text date:text source:text",
    )
    sample = {"bolt": "M12", "diameter": 0.012, "force": 1e4, "thickness": 0.02}
    yield database.Sample, sample, "roughness:1"
    yield (
        database.grid,
        {"bolts": ["M12"], "forces": [1e4], "thicknesses": [0.02]},
        "roughnesses:* bolts:* forces:* thicknesses:*",
    )
    yield (
        database.BoltedPlates,
        {},
        "friction:0 washer_friction:0 loaded_diameter:1 washer_diameter:1 washer_thickness:1 "
        "hole_diameter:1 nu:0 penalty:1",
    )
    yield database.TorqueToForce, {}, "friction:1 friction_head:1"
    yield known_thread, {"name": "M12"}, ""


#: By room: what is called, arguments that work, and odd values that it takes.
CALLS = {
    "structure": of_structure,
    "forms": of_forms,
    "joint_laws": of_laws,
    "preload": of_preload,
    "modal, response": of_responses,
    "harmonic, transient": of_vibration,
    "measurements": of_measurements,
    "reduction": of_reduction,
    "interfaces": of_interfaces,
    "updating, modal": of_updating,
    "harmonic, bayes": of_harmonic,
    "meshes": of_meshes,
    "beams": of_beams,
    "bayes, random_fields, diagnosis": of_statistics,
    "database": of_databases,
}
