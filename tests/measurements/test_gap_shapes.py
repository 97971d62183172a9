"""Measured mode shapes: read beside the frequencies, and what modes are then matched to."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.errors import InputError
from fenics_joints.measurements.gap import largest_difference, pair_modes
from fenics_joints.modal import solve_modes
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.reduction.arrays import ArrayModel
from fenics_joints.reduction.surrogate import ReducedModel
from fenics_joints.structure import Sensors

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="writes a case in a folder")

HEAD = "bending 1,bending 2,bending 3,bending 4\n"


def _with_shapes(write_case, folder, text: str):
    (folder / "shapes.csv").write_text(text, encoding="utf-8")
    return write_case(folder, ('damping = "damping.csv"', 'shapes = "shapes.csv"'))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + "1,1,1,1\n" * 4, r"shape \(4, 4\): expected \(5, 4\)"),
        (HEAD.replace("bending 2", "bendig 2") + "1,1,1,1\n" * 5, "no column .*bending 2"),
        (HEAD + "1,0,1,1\n" * 5, "no mode of zeros"),
        (HEAD + "1,,1,1\n" * 5, "finite value"),
    ],
)
def test_bad_shapes_are_refused_in_words(write_case, tmp_path, text, said):
    with pytest.raises(InputError, match=said):
        load_case(_with_shapes(write_case, tmp_path, text))


def test_modes_follow_the_measured_shapes_not_the_order(write_case, tmp_path):
    """Columns of the first two modes' shapes exchanged: the model's modes are exchanged too."""
    case = load_case(write_case(tmp_path))
    full = build_structure(case, MPI.COMM_SELF)
    args = dict(samples=lambda: [case.nominal()], sensors=case.sensors(), n_test=4, n_modes=16)
    plain = ReducedModel(full, case.nominal(), **args)
    swapped = plain.pairing.shapes[:, [1, 0, 2, 3]]
    rows = "".join(",".join(f"{x:.6g}" for x in row) + "\n" for row in swapped * 1e3)
    other = tmp_path / "other"
    other.mkdir()
    shapes = load_case(_with_shapes(write_case, other, HEAD + rows)).measurements().shapes
    followed = ReducedModel(full, case.nominal(), shapes=shapes, **args)
    assert followed.pairing.index.tolist() == plain.pairing.index[[1, 0, 2, 3]].tolist()
    assert followed.crossings == {(0, 1)} and plain.crossings == set()
    log_f, _ = followed.forward(case.nominal())
    assert np.argsort(log_f).tolist() == [1, 0, 2, 3]


def test_an_error_is_of_modes_that_are_alike(write_case, tmp_path):
    """A shape that is a mixture of two modes, of which the small model takes the one and the full
    model the other: that is no error of the small model."""
    case = load_case(write_case(tmp_path))
    full = build_structure(case, MPI.COMM_SELF)
    args = dict(samples=lambda: [case.nominal()], sensors=case.sensors(), n_modes=16)
    shapes = ReducedModel(full, case.nominal(), n_test=2, **args).pairing.shapes
    shapes = shapes / np.linalg.norm(shapes, axis=0)
    small = ReducedModel(full, case.nominal(), n_test=1, **args)
    values = {**case.nominal(), "near.E": 0.03 * case.nominal()["near.E"]}
    (error,) = small.errors([values])
    both = small.forward.solve(values)[0], small.solve(values)

    def taken(angle):
        mixture = np.cos(angle) * shapes[:, :1] + np.sin(angle) * shapes[:, 1:]
        small.forward.reference = mixture
        small.forward.forget()
        return [small.forward.paired(modes).index[0] for modes in both]

    switches, first = np.array([[0.0, np.pi / 2]] * 2), taken(0.0)
    for _ in range(40):
        for k, middle in enumerate(switches.mean(axis=1)):
            switches[k, int(taken(middle)[k] != first[k])] = middle
    own, theirs = taken(switches.mean())
    assert own != theirs
    assert small.errors([values])[0] < 2 * error < 0.01


def test_a_mode_that_a_small_model_lacks_is_an_error():
    """Five oscillators, coupled; of the small model's basis one mode is missing, and the test has
    it: nothing in the small model is like it."""
    n = 5
    sensors = Sensors(np.column_stack([np.arange(n), np.zeros((n, 2))]), [1.0, 0.0, 0.0])
    K = np.diag(np.arange(1.0, n + 1) ** 2) - 0.3 * (np.eye(n, k=1) + np.eye(n, k=-1))
    vectors = np.linalg.eigh(K)[1]

    def modes(kept):
        Z = vectors[:, kept]
        pencil = AffinePencil({}, [], [], fixed=(Z.T @ K @ Z, np.eye(len(kept))), fixed_mass=n)
        found = solve_modes(ArrayModel(pencil, 1e-3, Z, 0 * Z[None]), {}, n_modes=len(kept))
        return found, pair_modes(found, 2, sensors, reference=vectors[:, [0, 2]])

    full, lacking = modes([0, 1, 2, 3, 4]), modes([0, 1, 3, 4])
    assert largest_difference(*full, *modes([0, 2, 4]), sensors) < 1e-9
    assert largest_difference(*lacking, *full, sensors) > 0.1
