"""Derivatives of eigenvalues beside differences of them, and PETSc's matrices beside each other."""

from __future__ import annotations

import numpy as np
from petsc4py import PETSc

from fenics_joints.modal import solve_modes
from fenics_joints.reduction import ReducedStructure


def assert_second_order(
    model, steps, index, given=None, *, modes=None, least=3, floor=1e-9, order=1.9, **options
):
    """Halving a small step in a parameter quarters what the derivative leaves of a change.

    Args:
        model: The model.
        steps: The larger step of each parameter.
        index: Numbers of the modes.
        given: Where the derivatives are taken.
        modes: Those there, if they are known.
        least: Number of modes whose remainder is above ``floor`` times their eigenvalue: below it
            the remainder is the eigensolver's.
        floor: That share.
        order: Least order of the remainder.
        options: Of `solve_modes`.
    """
    given = dict(given or {})
    modes = modes or solve_modes(model, given, **options)
    slopes, values, names = modes.gradients(index), modes.eigenvalues[index], list(model.parameters)
    for name, step in steps.items():
        left = []
        for h in (step, step / 2):
            moved = solve_modes(model, given | {name: model.values(given)[name] + h}, **options)
            change = moved.eigenvalues[index] - values
            left.append(np.abs(change - h * slopes[:, names.index(name)]))
        seen = left[1] > floor * values
        assert seen.sum() >= least, name
        assert np.all(np.log2(left[0][seen] / left[1][seen]) > order), name


def difference(model, given, name, index, step, *, zero=None, **options):
    """Central difference of eigenvalues by a parameter, over a share of its value or of ``zero``,
    which stands for a value of 0."""
    value = model.values(given)[name]
    step *= value or zero
    low, high = (solve_modes(model, {**given, name: value + s}, **options) for s in (-step, step))
    return (high.eigenvalues[index] - low.eigenvalues[index]) / (2 * step)


def assert_same(found, wanted, rel):
    """The norm of the difference of two matrices; ``wanted`` has no fewer entries, and is lost."""
    size = wanted.norm()
    wanted.axpy(-1.0, found, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    assert wanted.norm() < rel * size


def assert_terms_reproduce(model, fresh, cases, n_vectors):
    """K and M of a reduced model are the assembled ones, on vectors that were never modes."""
    rng, vectors = (
        np.random.default_rng(3),
        [model.mass().createVecRight() for _ in range(n_vectors)],
    )
    for x in vectors:
        x.array[:] = rng.standard_normal(x.local_size)
    small = ReducedStructure(model, vectors)
    for given in cases:
        for found, whole in (
            (small.stiffness(given), fresh.stiffness(given)),
            (small.mass(given), fresh.mass(given)),
        ):
            exact = small.projection.matrix(whole)
            np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9 * np.abs(exact).max())
        assert np.isclose(small.total_mass(given), fresh.total_mass(given), rtol=1e-6)
