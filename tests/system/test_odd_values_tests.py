"""The same as `test_odd_values` for what a test gave, small models, and fits of parameters."""

from __future__ import annotations

from functools import cache
from math import nan

import measured_world as chain
import numpy as np
import pytest
from bolted_rods import BASELINE, BOLTS, Rods, sensors
from odd_values import (
    ABOVE_0,
    ANY,
    COUNT,
    FLAG,
    FROM_0,
    GIVEN,
    MODEL,
    NO_NUMBER,
    TEXT,
    WORD,
    not_refused,
)
from oscillators import BAND, duffing

from fenics_joints import bayes, harmonic, interfaces, measurements, modal, reduction, updating
from fenics_joints.errors import InputError
from fenics_joints.measurements import MeasuredCurves, MeasuredFRFs, Target, TestData
from fenics_joints.structure import Parameter

N = 3
LINES = np.linspace(10.0, 20.0, 8)
H = np.ones((8, N, 1), dtype=complex)
POINTS, ALONG = np.eye(N), np.tile([0.0, 0.0, 1.0], (N, 1))
SHAPES = np.eye(N)[:, :2]
#: In the place of an array of numbers, all of which must be positive.
ARRAY = (None, "x", nan, [None, 1.0], ["a"], [nan, nan], [-1.0, 2.0], [0.0, 1.0], [1e300j], [[1.0]])


def three() -> measurements.MeasuredFRFs:
    return MeasuredFRFs(LINES, H, "receptance", POINTS, ALONG, POINTS[:1], ALONG[:1])


@cache
def rods():
    return Rods(0.05).model()


def seen() -> Target:
    found = modal.solve_modes(rods(), n_modes=5)
    return Target(found.frequencies_hz[1:4], 1e-3)


def of_measurements():
    test = {"conditions": [1.0], "frequencies_hz": [[5.0, 7.0]], "mode_names": ("a", "b")}
    yield (
        TestData,
        test,
        {
            "conditions": (None, "x", nan, [nan], ["a"], [1.0, 2.0], [[1.0]]),
            "frequencies_hz": (None, "x", [[0.0, 7.0]], [[-5.0, 7.0]], [[5.0]], [["a", 1]]),
            "mode_names": (None, 1.0, "a", ("a", "a"), ("a", 1)),
            "damping": ("x", [0.1], [[-1, 0.1]]),
            "resolution_hz": (None, "x", -1.0, nan, [1.0] * 3),
            "noise": (None, "x", -1.0, nan, [1.0] * 3),
            "damping_noise": ("x", -1.0, nan),
            "shape_noise": FROM_0,
            "sensors": ("x", 1.0, POINTS),
            "shapes": ("x", 1.0, SHAPES),
            "condition_name": (None, 1.0),
        },
    )
    yield (
        Target,
        {"frequencies_hz": [5.0, 7.0]},
        {
            "frequencies_hz": ARRAY[1:],
            "log_sd": (*ABOVE_0, [1e-3], [1e-3, -1.0]),
            "shapes": ("x", 1.0, SHAPES),
            "damping_ratios": ("x", [0.1], [-0.1, 0.1], 0.1),
            "damping_log_sd": (0.0, "x", nan),
            "frfs": (1.0, "x"),
        },
    )
    at = sensors()
    values = np.ones((2, len(at.points), 1), dtype=complex)
    force = sensors(((0.0, 0),))
    frfs = {"frequencies_hz": LINES[:2], "values": values, "sensors": at, "excitation": force}
    yield (
        measurements.FRFTarget,
        frfs,
        {
            "frequencies_hz": ARRAY,
            "values": (None, "x", nan, [1.0], values[:1], nan * values),
            "sensors": (None, "x", POINTS),
            "excitation": (None, "x", at),
            "kind": WORD,
            "relative_sd": (*FROM_0, [0.1] * 3),
            "absolute_sd": ("x", nan, -1.0, [0.1] * 3),
        },
    )
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
        {
            "frequencies_hz": (None, "x", LINES[::-1], nan * LINES, LINES[:3]),
            "kind": WORD,
            "values": (None, "x", 1.0, H[:3], H[:, :2]),
            "response_points": (None, "x", POINTS[:2], nan * POINTS),
            "response_directions": (None, "x", ALONG[:2], 0 * ALONG, nan * ALONG),
            "reference_points": (None, "x", POINTS, [[nan] * 3]),
            "reference_directions": (None, "x", ALONG, [[0.0] * 3]),
            "response_names": (1.0, ("a",), ("a", "a", "b"), (1, 2, 3)),
            "reference_names": (("a", "b"),),
            "coherence": ("x", 1.0, np.ones(8), 2 * np.ones(H.shape), -np.ones(H.shape)),
        },
    )
    yield (
        MeasuredCurves,
        {
            "levels": (1.0,),
            "frequencies_hz": (LINES,),
            "amplitudes": (LINES,),
            "response": "displacement",
        },
        {
            "levels": (None, "x", (), (nan,), (-1.0,), ("a",), (1.0, 2.0)),
            "response": WORD,
            "frequencies_hz": (
                None,
                "x",
                (),
                (LINES[::-1],),
                (nan * LINES,),
                (LINES[:2],),
                (["a"],),
            ),
            "amplitudes": (None, "x", (), (LINES[:2],), (-LINES,), (nan * LINES,)),
        },
    )
    known = MeasuredFRFs(
        chain.FREQUENCIES, chain.accelerance(), "accelerance", POINTS, ALONG, POINTS, ALONG
    )
    yield (
        measurements.identify_modes,
        {"frfs": known},
        {
            "frfs": MODEL,
            "near": ("x", 1.0, [], [nan], [-1.0], ["a"], [1e9]),
            "band": ("ab", 1.0, [1.0], [2.0, 1.0], [nan, 100.0], [1e5, 2e5]),
            "order": (None, "x", 0, -1, 2.5, nan, 10**9),
            "max_damping": ABOVE_0,
        },
    )
    yield (
        measurements.mac,
        {"a": SHAPES, "b": SHAPES},
        {"a": (None, "x", 1.0, [1.0], SHAPES[:2], [["a"]]), "b": (None, "x", [1.0], SHAPES[:2])},
    )
    yield (
        measurements.made_real,
        {"shapes": SHAPES + 0j},
        {"shapes": (None, "x", 1.0, [1.0], [["a"]], [[None]])},
    )
    found = modal.solve_modes(rods(), n_modes=6)
    yield (
        measurements.pair_modes,
        {"modes": found, "n_test": 3},
        {
            "modes": (None, "x", 1.0),
            "n_test": COUNT,
            "sensors": ("x", 1.0, POINTS),
            "reference": ("x", 1.0, SHAPES),
            "threshold": (None, "x", nan, -1.0, 2.0),
        },
    )


def of_reduction():
    model = rods()
    names = list(BASELINE)
    reference = modal.solve_modes(model, n_modes=5).at(sensors())[:, :3]
    forward = {"model": model, "sensors": sensors(), "n_test": 3, "n_modes": 5}
    yield (
        reduction.Forward,
        forward,
        {
            "model": MODEL,
            "sensors": ("x", 1.0, POINTS),
            "n_test": COUNT,
            "n_modes": COUNT,
            "reference": ("x", 1.0, reference[:2]),
            "threshold": (None, "x", nan, -1.0, 2.0),
        },
    )
    free = {"model": model, "free": names[:1]}
    yield (
        reduction.freeze,
        free,
        {
            "model": MODEL,
            "free": (None, 1.0, "x", ["nothing"], [1.0], names[:1] * 2),
            "given": GIVEN,
        },
    )
    ranges = {f"{BOLTS[0]}.G": (1e10, 1e11)}
    yield (
        reduction.narrow,
        {"model": model, "ranges": ranges, "n_modes": 4},
        {
            "model": MODEL,
            "n_modes": COUNT,
            "given": GIVEN,
            "tolerance": (*ABOVE_0, 1.0),
            "ranges": (
                None,
                "x",
                1.0,
                {"nothing": (1.0, 2.0)},
                {names[0]: (2.0, 1.0)},
                {names[0]: (nan, 1.0)},
                {names[0]: 1.0},
                {names[0]: (1.0,)},
            ),
            "n_check": COUNT,
            "seed": (None, "x", -1, 2.5),
        },
    )


def of_interfaces():
    one = np.ones((1, 1))
    points = duffing().interfaces[0]
    yield (
        interfaces.InterfaceModel,
        {"M": one, "K": one},
        {
            "M": (None, "x", 1.0, [1.0], [[nan]], np.ones((2, 1)), np.ones((2, 2))),
            "K": (None, "x", 1.0, [1.0], [[nan]], np.ones((2, 1)), np.ones((2, 2))),
            "C": ("x", 1.0, [1.0], [[nan]]),
            "interfaces": (None, "x", 1.0, [None], [points, points]),
            "forces": ("x", [1.0], {"f": "x"}, {"f": [1.0, 2.0]}, {"f": [nan]}, {1: [1.0]}),
            "sensors": ("x", [1.0], {"f": "x"}, {"f": [1.0, 2.0]}, {"f": [nan]}, {1: [1.0]}),
        },
    )
    good = {"name": "j", "law": points.law, "rows": one[None], "weights": np.ones(1)}
    yield (
        interfaces.InterfacePoints,
        good,
        {
            "name": TEXT,
            "law": (None, "x", 1.0, type(points.law)),
            "rows": (None, "x", 1.0, one, nan * one[None]),
            "normal": FLAG,
            "weights": (None, "x", 1.0, [], [nan], [-1.0], [1.0, 2.0]),
            "points": ("x", 1.0, [1.0], [[nan] * 3]),
        },
    )
    yield (
        interfaces.static_state,
        {"model": duffing(), "load": np.ones(1)},
        {
            "model": MODEL,
            "load": (None, "x", [nan], [1.0, 2.0], ["a"]),
            "steps": COUNT,
            "tolerance": (*ABOVE_0, 1.0),
            "max_iterations": COUNT,
        },
    )
    yield (
        interfaces.with_modal_damping,
        {"model": duffing(), "ratios": 0.01},
        {"model": MODEL, "ratios": (*FROM_0, [nan], ["a"], [-0.1]), "rest": FROM_0},
    )
    yield (
        interfaces.with_rayleigh_damping,
        {"model": duffing()},
        {"model": MODEL, "mass": FROM_0, "stiffness": FROM_0},
    )


def of_updating():
    model, target = rods(), seen()
    name = f"{BOLTS[0]}.G"
    free = [Parameter(name, BASELINE[name], lower=1e9, upper=1e12)]
    fit = {"model": model, "parameters": free, "target": target, "start": {name: 7e10}}
    odd = {
        "model": MODEL,
        "parameters": (None, "x", 1.0, [], ["x"], [1.0], free * 2),
        "target": (None, "x", 1.0, [5.0]),
        "start": (None, *GIVEN, {name: "x"}, {name: nan}),
        "n_modes": COUNT[1:],
    }
    yield (
        updating.update,
        fit,
        odd
        | {
            "moves": WORD,
            "regularisation": FROM_0[1:],
            "max_evaluations": COUNT,
            "strict": FLAG,
            "centre": ("x", 1.0, {name: "x"}, {"nothing": 1.0}, {name: nan}),
        },
    )
    yield (
        updating.update_weighted,
        fit,
        odd
        | {
            "w_f": (*FROM_0, [1.0] * 9),
            "eps_1": ABOVE_0,
            "eps_2": ABOVE_0,
            "strict": FLAG,
            "max_iterations": COUNT,
            "complex_rows": WORD,
            "step_limit": ABOVE_0[1:],
        },
    )
    yield (
        modal.identifiability,
        {"whitened": np.eye(2), "names": ("a", "b")},
        {
            "whitened": (None, "x", 1.0, [1.0], nan * np.eye(2)),
            "open_sd": ABOVE_0,
            "names": (None, 1.0, (), ("a",), ("a", "a"), (1, 2)),
        },
    )
    found = modal.solve_modes(model, n_modes=5)
    yield (
        modal.frequency_sensitivity,
        {"modes": found, "index": [1]},
        {"modes": (None, "x", 1.0), "index": (None, "x", [99], [-99], [1.5], ["a"], [None])},
    )


def of_harmonic():
    yield (
        harmonic.Load,
        {"force": "push", "amplitude": 1.0},
        {"force": TEXT, "amplitude": NO_NUMBER, "harmonic": COUNT, "phase": NO_NUMBER},
    )
    curves = MeasuredCurves((0.01,), (np.linspace(*BAND, 9),), (np.ones(9),), "displacement")
    told = {"model": duffing(), "curves": curves, "force": "push", "sensor": "mass", "points": 3}
    yield (
        harmonic.predict,
        told,
        {
            "model": MODEL,
            "curves": (None, "x", 1.0),
            "force": WORD,
            "sensor": WORD[1:],
            "points": COUNT,
            "harmonics": COUNT,
            "levels": ("x", 1.0, [nan], [9.0], ["a"]),
        },
    )
    yield (
        harmonic.default_samples,
        {"model": duffing(), "harmonics": 3},
        {"model": MODEL, "harmonics": COUNT},
    )
    yield (
        bayes.rank,
        {"truth": 0.5, "draws": np.linspace(0.0, 1.0, 50), "n": 10},
        {"truth": ANY, "draws": (None, "x", [], [nan] * 50, [["a"]]), "n": (*COUNT, 10**6)},
    )
    yield (
        bayes.calibrate,
        {"ranks": np.arange(60) % 10, "n": 9},
        {"ranks": (None, "x", [], [nan], [-1], [99], [0.5]), "n": COUNT, "bins": COUNT},
    )


CALLS = {
    "measurements": of_measurements,
    "reduction": of_reduction,
    "interfaces": of_interfaces,
    "updating, modal": of_updating,
    "harmonic, bayes": of_harmonic,
}


READERS = (
    measurements.read_frfs,
    measurements.read_shapes,
    measurements.read_table,
    measurements.read_test_data,
    reduction.read_array_model,
    interfaces.read_interface_model,
)
READERS_OF = (measurements.read_curves, harmonic.read_loops)


@pytest.mark.parametrize("read", [*READERS, *READERS_OF])
def test_what_is_no_file_is_refused(read):
    more = ("displacement",) if read in READERS_OF else ()
    for value in (None, 1.0, "", "nowhere.csv", "/", "a" * 5000, "a\0b"):
        with pytest.raises(InputError):
            read(value, *more)
    for response in WORD if more else ():
        with pytest.raises(InputError):
            read("nowhere.csv", response)


@pytest.mark.parametrize("rooms", CALLS)
def test_odd_values_are_refused(rooms):
    wrong = not_refused(CALLS[rooms]())
    assert not wrong, "\n".join(wrong)
