"""Measured antiresonances in a diagnosis: lap plates that are the same from either end."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from measured_points import Plates, check_derivatives, measure_again, reduced, said, solved, sparse
from mpi4py import MPI

from fenics_joints.diagnosis.evidence.entries import ANTIRESONANCE
from fenics_joints.diagnosis.model.at_points import paired_zeros
from fenics_joints.errors import InputError
from fenics_joints.meshes import box
from fenics_joints.reduction.matched import places_all_over
from fenics_joints.reduction.receptances import Antiresonances, PointBasis
from fenics_joints.structure import Parameter, Sensors, Structure, part

#: Of all sensors the first, at the left end.
END = Sensors([0.01, 0.04, 0.0], [0, 0, 1])
WEIGHTS = """
[attached.left]
kind = "mass"
points = [["10 mm", "40 mm", "0 mm"]]
mass = "40 g"
tolerance = "5 %"

[attached.right]
kind = "mass"
points = [["310 mm", "40 mm", "16.5 mm"]]
mass = "40 g"
tolerance = "5 %"
"""


def driven(hz) -> str:
    listed = ", ".join(f'"{f} Hz"' for f in hz)
    return f"""
[test.antiresonances.end]
point = ["10 mm", "40 mm", "0 mm"]
direction = [0, 0, 1]
frequencies = [{listed}]
noise = "0.2 %"
"""


PLATES = Plates(("left mass", "right mass", "modulus error"), 20, 0.3, WEIGHTS)


def exact_zeros(full: Structure, given, near) -> np.ndarray:
    """Where the motion of a point under a unit force there is nought, within 2 % of some
    frequencies, by factorisations that are not PETSc's."""
    K, M, load = sparse(full.stiffness(given)), sparse(full.mass(given)), full.loads(END)[:, 0]

    def motion(hz):
        return load @ solved(K - (2 * np.pi * hz) ** 2 * M, load)

    return np.array(
        [scipy.optimize.brentq(motion, 0.98 * f, 1.02 * f, xtol=1e-4, rtol=1e-6) for f in near]
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Resonances and the first two antiresonances at the left end, where the weight is."""
    full, values, modes, hz = PLATES.true(
        tmp_path_factory.mktemp("true"), 60, **{"left.mass": 0.04}
    )
    # By 60 modes a change of sign is nearly a zero, or a resonance.
    found, at = np.linspace(150, 1500, 2000), modes.at(END)[0]
    sign = np.sign(at**2 @ (1 / (modes.eigenvalues[:, None] - (2 * np.pi * found) ** 2)))
    near = found[:-1][np.diff(sign) > 0]
    return hz, exact_zeros(full, values, near[:2])


def test_antiresonances_say_at_which_end(tmp_path, measured, models):
    """Frequencies are the same with the weight at the other end."""
    seen = said(PLATES.tested(tmp_path / "seen", measured[0], driven(measured[1])), models)
    assert seen["left mass"] > 0.5 and seen["right mass"] < 0.05


def test_they_are_entries_with_derivatives(tmp_path, measured, models):
    model = reduced(PLATES.tested(tmp_path / "case", measured[0], driven(measured[1])), models)
    own = np.flatnonzero(model.evidence.entries.kind == ANTIRESONANCE)
    zeros = model.evidence.scalars
    assert np.exp(model.evidence.data[own]) == pytest.approx(measured[1])
    assert np.all(model.evidence.noise_sd()[own] > np.hypot(0.002, 0.003) - 1e-12)
    changed = {**model.baseline, "left.mass": 0.07, "plates.rho": 2600.0}
    found = np.array([z.log_value(changed)[0] + z.mesh for z in zeros])
    exact = exact_zeros(model.full, changed, np.exp(found))
    assert np.exp(found) == pytest.approx(exact, rel=2e-4)
    hypothesis = model.hypothesis(model.effects[:1])
    check_derivatives(model, hypothesis, own, hypothesis.own.start)
    # Stiffer by 15 % everywhere is higher by half of it, heavier by 10 % lower by half of that.
    parts = ~model.evidence.signatures.of_joint
    for zero in zeros:
        stiff, mass = zero.patches[:, parts].sum(axis=1)
        assert [stiff, mass] == pytest.approx([0.075, -0.05], rel=0.02)
    # What is refused of them, once the model is there.
    for changes, said_ in (
        ({"frequencies": [30.0]}, "test.antiresonances.end.frequencies: expected such as"),
        ({"point": [0.9, 0.04, 0.0]}, "test.antiresonances.end"),
        ({"at": 7.0}, "test.antiresonances.end.at = 7: expected a condition"),
    ):
        with pytest.raises(InputError, match=said_):
            measure_again(model, "antiresonances", "end", **changes)


def test_pairs_once_resonances_are_moved_onto_each_other():
    """A structure softer by 30 % has its second antiresonance where the model has its first."""
    zeros, nominal = np.log([300.0, 430.0, 900.0]), np.log([350.0, 600.0])
    softer = 0.7 * np.exp(zeros)
    tested = nominal + np.log(0.7)
    found = paired_zeros(np.log(softer[1:]), zeros, tested, nominal)
    assert found.tolist() == [1, 2]
    assert paired_zeros(np.log([100.0]), zeros, tested, nominal) is None
    assert paired_zeros(np.log(softer[:1]), zeros, np.full(2, np.nan), nominal) is None


@pytest.mark.parallel
def test_a_beam_driven_at_its_end_has_those_of_a_pinned_one():
    """tan(beta L) = tanh(beta L) (Blevins, Formulas for Natural Frequency and Mode Shape, 1979), at
    a modulus and a thickness that no sample has."""
    length, width, height, rho = 0.5, 0.02, 0.005, 7800.0
    body = part("bar", "body", E="E", nu=0.0, rho=rho, stretch="s")
    full = Structure(
        box(MPI.COMM_WORLD, (length, width, height), (24, 1, 1)),
        [body],
        [Parameter("E", 2e11), Parameter("s", 1.0)],
    )
    end = Sensors([0.0, width / 2, height / 2], [0, 0, 1])
    samples = [{"E": 2e11, "s": s} for s in (1.0, 0.8, 1.25)]
    basis = PointBasis(full, end, places_all_over(full, 40), samples, 24)
    zeros = Antiresonances(basis, 0, samples[0], 24)

    def by_hand(E, s):
        beta = np.array([3.926602, 7.068583, 10.210176]) / length
        return beta**2 * np.sqrt(E * (s * height) ** 2 / (12 * rho)) / (2 * np.pi)

    assert np.exp(zeros.log_f[:3]) == pytest.approx(by_hand(2e11, 1.0), rel=5e-3)
    zeros.follow(np.arange(3))
    for values in ({"E": 1.7e11, "s": 0.9}, {"E": 2.2e11, "s": 1.15}):
        found = np.exp(zeros.at(values).log_f[0])
        assert found == pytest.approx(by_hand(**values), rel=5e-3)
