"""Measured functions in a diagnosis: lap plates that hang free, and a bar by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from measured_points import Plates, check_derivatives, reduced, said, solved, sparse
from mpi4py import MPI
from virtual_plates import E

from fenics_joints.diagnosis import diagnose
from fenics_joints.diagnosis.evidence.entries import FUNCTION
from fenics_joints.errors import InputError
from fenics_joints.meshes import box
from fenics_joints.modal import solve_modes
from fenics_joints.reduction.matched import places_all_over
from fenics_joints.reduction.prediction import ModalPrediction
from fenics_joints.reduction.receptances import Lines, PointBasis, Poles, Receptances
from fenics_joints.structure import Parameter, Sensors, Structure, part

#: A force at the right end, and motion there and at the left.
ENDS = Sensors([[0.31, 0.04, 0.0165], [0.01, 0.04, 0.0]], [0, 0, 1])
METAL = ("modulus error", "density error")
PLATES = Plates(METAL, 20, 0.5)
LOSS = 0.004
HZ = np.arange(100.0, 1600.0, 2.0)


def frfs(more: str = "", node: str = '["10 mm", "40 mm", "0 mm"]') -> str:
    return f"""
[test.frfs]
files = "frfs.csv"
noise = "2 %"
calibration = "0.5 %"
points = {{ "1" = ["310 mm", "40 mm", "16.5 mm"], "2" = {node} }}
{more}
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Resonances of plates of a softer metal, and both functions, m/N."""
    full, bonded, modes, hz = PLATES.true(tmp_path_factory.mktemp("true"), 60, E=0.93 * E)
    at, lam = modes.at(ENDS), np.maximum(modes.eigenvalues, 0.0)
    gap = lam * (1 + 1j * LOSS) - (2 * np.pi * HZ[:, None]) ** 2
    found = np.stack([np.sum(at[0] * at[i] / gap, axis=1) for i in range(2)])
    # What modes beyond add hardly changes with the frequency: by factorisations not PETSc's.
    K, M, load = sparse(full.stiffness(bonded)), sparse(full.mass(bonded)), full.loads(ENDS)
    lossy = K * (1 + 1j * LOSS)
    some = slice(None, None, 250)
    exact = [load.T @ solved(lossy - (2 * np.pi * f) ** 2 * M, load[:, 0] + 0j) for f in HZ[some]]
    rest = np.transpose(exact) - found[:, some]
    return hz, found + np.array([np.interp(HZ, HZ[some], r.real) for r in rest])


def case_of(folder: Path, measured, more: str, scale: float = 1.0):
    """With 2 % of noise on accelerances, and hum."""
    folder.mkdir()
    rng = np.random.default_rng(4)
    both = scale * measured[1] * -((2 * np.pi * HZ) ** 2)
    noise = rng.standard_normal((2, *both.shape)) * 0.02 / np.sqrt(2)
    both = both * (1 + noise[0] + 1j * noise[1])
    both[:, np.isin(HZ, (150.0, 250.0, 350.0))] *= 3.0
    heads = [f"{i}:+z/1:+z {part} [m/s2/N]" for i in (1, 2) for part in ("re", "im")]
    rows = np.column_stack([HZ, *(part for h in both for part in (h.real, h.imag))])
    table = [",".join(["frequency [Hz]", *heads]), *(",".join(map(repr, r)) for r in rows.tolist())]
    (folder / "frfs.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    return PLATES.tested(folder, measured[0], more)


def test_functions_split_modulus_from_density(tmp_path, measured, models):
    """Frequencies alone do not: the metal is softer. By functions of a heavier one, it is that."""
    seen = said(case_of(tmp_path / "seen", measured, frfs()), models)
    assert seen["modulus error"] > 0.5 and seen["density error"] < 0.1
    # Of a structure heavier by 7.5 % the frequencies are the same, and functions less by that.
    other = said(case_of(tmp_path / "heavier", measured, frfs(), scale=0.93), models)
    assert other["density error"] > 0.5 and other["modulus error"] < 0.1


def test_they_are_entries_with_derivatives(tmp_path, measured, models):
    model = reduced(case_of(tmp_path / "case", measured, frfs()), models)
    lines = model.evidence.scalars
    own = np.flatnonzero(model.evidence.entries.kind == FUNCTION)
    assert len(own) == len(lines) == 96 and not model.evidence.data[own].any()
    # Of the true metal what is left is noise, and the errors that the model says of itself.
    metal = {"plates.E": 0.93 * model.baseline["plates.E"]}
    off = np.array([line.log_value(model.baseline | metal)[0] for line in lines])
    errors = model.evidence.full_covariance()[np.ix_(own, own)]
    assert 0.1 < off @ np.linalg.solve(errors, off) / len(off) < 1.5
    hypothesis = model.hypothesis(model.effects[:2])
    for j in (0, 1):  # to round-off of rigid-body modes, over their frequency
        check_derivatives(model, hypothesis, own, hypothesis.own.start + j, floor=1e-7)
    # Well below the first resonance of a free body there is its mass, heavier by 10 %.
    parts = ~model.evidence.signatures.of_joint
    low = [line for line in lines if line.functions.lines.frequencies_hz[line.index] < 150]
    for line in low:
        stiff, mass = line.patches[:, parts].sum(axis=1)
        assert [stiff, mass] == pytest.approx([0.0, 0.0 if line.phase else -0.1], abs=2e-3)


def test_what_is_not_of_this_structure_is_left_out(tmp_path, measured, models):
    """Accelerations in g, and a sensor upside down."""
    model = reduced(case_of(tmp_path / "wrong", measured, frfs('units = "g/N"')), models)
    assert not model.evidence.scalars
    left = [note for note in model.notes if "is left out: it is" in note]
    assert len(left) == 2 and "look at its unit" in left[0], model.notes


def test_refusals(tmp_path, measured, models):
    beside = case_of(tmp_path / "beside", measured, frfs(node='["900 mm", "40 mm", "0 mm"]'))
    with pytest.raises(InputError, match="test.frfs 2"):
        diagnose(beside, MPI.COMM_SELF, keep=models)
    with pytest.raises(InputError, match=r"test.frfs: row = 7 was not measured: expected one of 1"):
        case_of(tmp_path / "late", measured, frfs("at = 7"))


@pytest.mark.parallel
def test_of_a_free_bar_with_the_resonances_of_a_test():
    """Of force and motion at an end every mode has the residue 4 / m (Blevins, Formulas for Natural
    Frequency and Mode Shape, 1979, table 8-1), rigid ones together too; at values no sample has."""
    length, width, height, rho = 0.5, 0.02, 0.005, 7800.0
    body = part("bar", "body", E="E", nu=0.0, rho=rho, stretch="s")
    full = Structure(
        box(MPI.COMM_WORLD, (length, width, height), (24, 1, 1)),
        [body],
        [Parameter("E", 2e11), Parameter("s", 1.0)],
    )
    end = Sensors([0.0, width / 2, height / 2], [0, 0, 1])
    samples = [{"E": 2e11, "s": s} for s in (1.0, 0.8, 1.25)]
    basis = PointBasis(full, end, places_all_over(full, 40), samples, 24, tolerance=1e-6)
    modes = solve_modes(basis.model, samples[0], n_modes=24)
    bent = np.flatnonzero(np.abs(basis.rows[0] @ modes.shapes) > 0.1)
    reference = modes.at(basis.everywhere)[:, bent[bent >= modes.n_rigid][:3]]
    forward = ModalPrediction(basis.model, basis.everywhere, 3, 24, reference=reference)
    tested = np.array([100.0, np.nan, 540.0])
    hz = np.array([20.0, 60.0, 101.0, 180.0, 400.0, 541.0, 620.0])
    lines = Lines(hz, np.zeros(7, dtype=int), np.zeros(7, dtype=int))
    functions = Receptances(basis, lines, Poles(tested, np.full(3, 0.01)), forward)
    beta = np.array([4.730041, 7.853205, *(np.arange(3, 30) + 0.5) * np.pi]) / length
    for values in ({"E": 1.7e11, "s": 0.9}, {"E": 2.2e11, "s": 1.15}):
        thick = values["s"] * height
        mass = rho * length * width * thick
        own = beta**2 * np.sqrt(values["E"] * thick**2 / (12 * rho)) / (2 * np.pi)
        poles = np.array([100.0, own[1], 540.0, *own[3:]])[:, None]
        damping = np.isin(poles, tested) * 0.01
        omega = 2 * np.pi * hz
        gap = (2 * np.pi * poles) ** 2 - omega**2 + 4j * np.pi * damping * poles * omega
        by_hand = 4 / mass * (np.sum(1 / gap, axis=0) - 1 / omega**2)
        assert np.abs(functions.at(values)[0] / by_hand - 1).max() < 0.02


def test_a_plan_ranks_one(tmp_path, models):
    """It would tell the metal's modulus from its density, at an end, where all modes move."""
    gained = PLATES.gains(tmp_path, models)
    ends = ("(310, 40, 16)", "(10, 40, 0)")
    (one,) = (name for name in gained if name.startswith("the driving-point FRF"))
    assert any(end in one for end in ends) and gained[one] > 0.3, gained
