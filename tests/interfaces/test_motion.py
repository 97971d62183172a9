"""The contract of motions: a reduced model and a full one of the same equations move alike."""

import numpy as np
import pytest
from mass_chain import chain
from mpi4py import MPI

from fenics_joints.errors import InputError

N = 6


def whole(motion, vector) -> np.ndarray:
    """All entries of a vector, on every rank."""
    return np.concatenate(motion.comm.tompi4py().allgather(vector.array_r))


def filled(motion, values):
    """A vector of these entries."""
    vector = motion.vector()
    vector.array[:] = values[slice(*vector.getOwnershipRange())]
    return vector


def asked(motion) -> dict[str, np.ndarray]:
    """What a motion answers about one state and one step from it."""
    rng = np.random.default_rng(3)
    u, v, a, load, last = (filled(motion, rng.standard_normal(N)) for _ in range(5))
    states = [new for _, _, new, _ in motion.step(last, motion.rest())]
    r, J = motion.vector(), motion.matrix()
    motion.residual(u, v, a, load, states, r)
    motion.jacobian(u, states, 0.3, 0.7, J)
    columns = []
    for unit in np.eye(N):
        column = motion.vector()
        J.mult(filled(motion, unit), column)
        columns.append(whole(motion, column))
    work = sum(
        p.weights @ (strain * stress).sum(axis=1)
        for p, (strain, stress, *_) in zip(motion.interfaces, motion.step(u, states), strict=True)
    )
    return {
        "residual": whole(motion, r),
        "jacobian": np.array(columns),
        "drag": whole(motion, motion.drag(v)),
        "energy": np.array(motion.energy(u, v)),
        "acceleration": whole(motion, motion.acceleration(load, u, states, 1e-4)),
        "place": whole(motion, motion.place("forces", "end")),
        "work": np.array(motion.total(float(work))),
    }


@pytest.mark.parallel
def test_motions_of_a_dense_and_a_shared_model_agree():
    dense, shared = asked(chain().motion()), asked(chain(MPI.COMM_WORLD).motion())
    for key, value in dense.items():
        assert shared[key] == pytest.approx(value, rel=1e-9, abs=1e-12), key


def test_jacobian_is_the_residuals_derivative():
    motion = chain().motion()
    rng = np.random.default_rng(5)
    u, v, a, load = rng.standard_normal((4, N))
    J, states = motion.matrix(), motion.rest()
    motion.jacobian(filled(motion, u), states, 0.3, 0.7, J)

    def residual(change):
        found = motion.vector()
        moved = (filled(motion, x + s * change) for x, s in ((u, 1.0), (v, 0.3), (a, 0.7)))
        motion.residual(*moved, filled(motion, load), states, found)
        return found.array_r.copy()

    for i, unit in enumerate(1e-6 * np.eye(N)):
        slope = (residual(unit) - residual(-unit)) / 2e-6
        assert J.getDenseArray()[:, i] == pytest.approx(slope, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("model", [chain(), chain(MPI.COMM_SELF)])
def test_an_unknown_place_is_named(model):
    with pytest.raises(InputError, match="sensors: no 'tip'; expected one of: end"):
        model.motion().place("sensors", "tip")
    assert len(repr(model)) < 120 and "joint: 6 points" in repr(model)
