"""The blind check's second world: its plan, its joint, and CalculiX against our own solutions."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.linalg import eigh

pytest.importorskip("dolfinx")
pytest.importorskip("gmsh")

from mpi4py import MPI

from benchmarks.blind import calculix, forecast, matching, world, worlds
from benchmarks.blind.calculix import program
from benchmarks.blind.calculix.build import BONDED, Build, Joint
from benchmarks.blind.calculix.cases import NEW, generate
from benchmarks.blind.calculix.deck import Observed, pressures, stiffness, write_deck
from benchmarks.blind.calculix.effects import MASS, UNKNOWN_OF
from benchmarks.blind.calculix.meshing import mesh_of, unfolded
from benchmarks.blind.calculix.rigs import RIGS
from benchmarks.blind.calculix.ritz import with_attached
from benchmarks.blind.calculix.specimen import RIGID, build_of, drawn_hz, follow, receptances
from fenics_joints.case import load_case
from fenics_joints.diagnosis.model.subject import subject_of
from fenics_joints.modal import solve_modes
from fenics_joints.progress import Progress


def has_calculix() -> bool:
    try:
        return bool(calculix.find_program())
    except calculix.CalculixError:
        return False


needs_calculix = pytest.mark.skipif(not has_calculix(), reason=calculix.MISSING)


def test_without_calculix_it_says_so(monkeypatch, tmp_path):
    monkeypatch.setenv("CCX", str(tmp_path / "none"))
    with pytest.raises(calculix.CalculixError, match="none: no such program"):
        calculix.find_program()


def test_plan_of_three_hundred():
    """Kinds as they should be, half of the new geometry, and every cause of every geometry."""
    cases = calculix.plan(300, 1, True)
    kinds = {"none": 60, "single": 126, "pair": 54, "unknown": 60}
    assert Counter(case[1] for case in cases) == kinds
    for geometry in calculix.GEOMETRIES:
        own = [case for case in cases if case[0] == geometry]
        assert len(own) == (150 if geometry == NEW else 50)
        single = {case[2][0] for case in own if case[1] == "single"}
        unknown = {case[2][0] for case in own if case[1] == "unknown"}
        assert single == set(calculix.EFFECTS[geometry])
        assert unknown == set(UNKNOWN_OF[geometry]) and len(unknown) >= 6
    careful = {case[0] for case in cases if case[4]}
    assert careful == {NEW} and abs(sum(case[4] for case in cases) - 75) < 3
    assert sum(case[5] for case in cases) == pytest.approx(300 / 8, abs=12)
    # No geometry, unknown cause or seed's plan is shared with the first world.
    assert set(calculix.GEOMETRIES).isdisjoint(world.GEOMETRIES)
    assert set(calculix.UNKNOWN).isdisjoint(world.UNKNOWN)
    assert worlds.world_of("screw_box") is calculix and worlds.world_of("c_beam") is world
    assert matching.same_cause("two_loose_bolts", "two loose bolts")


@pytest.mark.parametrize("name", sorted(RIGS))
def test_pads_have_the_area_of_the_cone(name):
    """Pressure has the volume of a paraboloid, and a loose bolt's pad is gone."""
    rig, mesh = RIGS[name], mesh_of(name)
    pads = len(rig.bolts) * np.pi * rig.pad**2
    for joint, bolts in ((Joint(), 1.0), (Joint(loose=[0]), 1 - 1 / len(rig.bolts))):
        p = pressures(rig, mesh, joint)
        total = sum(float(q @ pairs.area) for q, pairs in zip(p, mesh.pairs, strict=True))
        # Chords of the circle: a hexagon has 17 % less than it, a disc in twelve 4 %.
        assert total == pytest.approx(bolts * pads / 2, rel=0.08)
    for pairs in mesh.pairs:
        assert np.allclose(mesh.x[pairs.first], mesh.x[pairs.second], atol=1e-12)


def test_a_folded_cell_is_made_straight():
    """CalculiX refuses it: a middle of an edge beyond the opposite face. A curved one stays."""
    corners = np.vstack([np.zeros(3), np.eye(3)])
    edges = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]
    straight = np.vstack([corners, [corners[list(edge)].mean(axis=0) for edge in edges]])
    cells = np.arange(10)[None]
    curved, folded = straight.copy(), straight.copy()
    curved[4] += [0, -0.05, -0.05]
    folded[4] += [0, 0.6, 0.6]
    assert np.array_equal(unfolded(curved, cells), curved)
    assert np.allclose(unfolded(folded, cells), straight, atol=1e-15)


def test_stiffness_goes_with_pressure_and_torque():
    soft = Joint(k_n=1e12, k_t=2e11, beta=0.5)
    p = np.array([0.0, 0.25, 1.0])
    normal, tangential = stiffness(p, soft, 0, 1.0)
    bonded = BONDED * p[1:]
    assert normal[0] == tangential[0] == 0
    assert normal[1:] == pytest.approx(1 / (1 / (1e12 * p[1:] ** 0.5) + 1 / bonded))
    assert stiffness(p, soft, 0, 0.25)[1][2] == pytest.approx(0.5 * 2e11, rel=1e-3)


def test_attached_masses_and_springs_by_modes():
    """With all of its modes the span is the whole, so that any attachment is exact."""
    random = np.random.default_rng(0)
    n, nodes = 12, 4
    a = random.standard_normal((n, n))
    k, m = a @ a.T + n * np.eye(n), np.diag(random.uniform(1, 2, n))
    values, vectors = eigh(k, m)
    hz, u = np.sqrt(values) / (2 * np.pi), vectors.T.reshape(n, nodes, 3)
    own, kg, spring = 0.8, 0.3, 4.0
    wide_k, wide_m = np.zeros((n + 3, n + 3)), np.eye(n + 3)
    wide_k[:n, :n], wide_m[:n, :n] = k, m
    wide_k[7, 7] += spring
    wide_m[[3, 4, 5], [3, 4, 5]] += 0.5
    tuned = kg * (2 * np.pi * own) ** 2
    for axis in range(3):
        i, j = 3 * 1 + axis, n + axis
        wide_k[np.ix_([i, j], [i, j])] += tuned * np.array([[1, -1], [-1, 1]])
        wide_m[j, j] = kg
    expected = np.sqrt(eigh(wide_k, wide_m)[0][:n]) / (2 * np.pi)
    found, shapes = with_attached(
        hz, u, masses=[(1, 0.5)], springs=[(2, 1, spring)], tuned=[(1, kg, own)]
    )
    assert found == pytest.approx(expected, rel=1e-9)
    assert follow(shapes[[2, 0, 1]], shapes).tolist() == [2, 0, 1]


def test_class_of_nearly_all_is_no_answer():
    """Six of twenty are none; six of forty are less than a fifth of what was thought of."""
    for sizes, little in (({"A": 5, "B": 6, "C": 9}, "BC"), ({"B": 6, "C": 34}, "C")):
        rows = [
            {"name": str(i), "region": "", "class": c, "odds": 1.0, "probability": 0.1}
            for i, c in enumerate("".join(c * size for c, size in sizes.items()))
        ]
        said = forecast.Forecast({"effects": rows, "hypotheses": [], "verdict": "cause"})
        assert "".join(c for c in sizes if said.says_little(c)) == little


@pytest.mark.parametrize("name", ["t_tubes", "screw_box"])
def test_every_effect_makes_a_deck(name):
    """Each cause, listed or not, changes the input that CalculiX gets; those of the test do not."""
    rig, mesh, random = RIGS[name], mesh_of(name), np.random.default_rng(0)
    observed = calculix.specimen.pool_of(name).observed
    plain = write_deck(rig, mesh, Build(), observed, 10)
    for effect in (*calculix.EFFECTS[name], *UNKNOWN_OF[name]):
        build = Build()
        drawn = calculix.draw(random, name, effect)
        calculix.effects.apply(rig, drawn, build, [500.0] * 8)
        same = effect in ("sensor_place", "sensor_gain", "mis_pairing")
        assert (write_deck(rig, mesh, build, observed, 10) == plain) == same, effect


@pytest.mark.slow
@needs_calculix
def test_the_world_is_converged():
    """As drawn, on its own mesh and on one of two thirds of its size: else a diagnosis that takes
    the mesh's own error off would find that of the world."""
    rig = RIGS["t_tubes"]
    finer = mesh_of("t_tubes", 0.65)
    some = Observed(np.unique(finer.cells[0])[:50])
    hz, _ = program.run_modes(write_deck(rig, finer, Build(), some, RIGID + 8), len(some.nodes))
    assert np.array(drawn_hz("t_tubes")) == pytest.approx(hz[RIGID:], rel=0.008)


@pytest.mark.slow
@needs_calculix
def test_calculix_agrees_with_our_own_model(tmp_path):
    """The T without effects, by two codes and two meshes: as a diagnosis starts, bonded where the
    bolts press, with the mesh's own error off, within 1.5 %."""
    nominal = calculix.cases.nominal_case("t_tubes", ["planned = { modes = 8 }"])
    (tmp_path / "case.toml").write_text(nominal, encoding="utf-8")
    calculix.cases.copy_drawing("t_tubes", tmp_path)
    subject = subject_of(load_case(tmp_path), MPI.COMM_SELF, Progress(silent=True))
    modes = solve_modes(subject.full.finer(), subject.baseline, n_modes=14)
    ours = modes.frequencies_hz[modes.frequencies_hz > 50][:8]
    assert ours == pytest.approx(np.array(drawn_hz("t_tubes"))[:8], rel=0.015)


@pytest.mark.slow
@needs_calculix
def test_functions_have_the_resonances_and_the_mass(tmp_path):
    """A careful user's case with functions is read, and these are the structure's."""
    truth = generate("bracket", "none", [], 3, tmp_path, careful=True, functions=True)
    case = load_case(tmp_path)
    assert case.mesh.size == pytest.approx(0.016) and case.diagnose.discrepancy == 0.01
    frfs, hz = case.frfs(), np.array(truth["frequencies"][-1])
    assert frfs.values.shape[1:] == (len(truth["spec"]["sensors"]), 2)
    spec = calculix.Spec(**truth["spec"])
    near = np.concatenate([0.95 * hz, hz, [5.0]])
    found = receptances(spec, build_of(spec), near, spec.scatter[-1])
    place = [spec.sensors.index(s) for s in spec.forces]
    driven = np.array([found[:, i, j] for j, i in enumerate(place)])
    # At a resonance what is driven there lags by a quarter turn, unless it is at a node; far below,
    # a free structure is its rigid body, of which a point off the centre of mass moves more.
    off, at = np.split(-driven[:, :-1].imag.sum(axis=0), 2)
    assert np.mean(at > 3 * off) > 0.8 and np.all(off > 0)
    assert np.all(-1 / ((2 * np.pi * 5.0) ** 2 * driven[:, -1].real) < MASS["bracket"])
