"""Spans where directions are the same but for round-off, against eigenvalues of the Gram matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fenics_joints.diagnosis.where.spans import outside, span


def test_alike_directions_that_divide_and_conquer_fails_on():
    """Directions of zones of a box with 16 bolts, kept to the last bit: NumPy 2.2's SVD says
    "did not converge" of them with the OpenBLAS it was met with (0.3.29)."""
    A = np.zeros((57, 57))
    A[np.triu_indices(57)] = np.load(Path(__file__).parent / "gesdd.npz")["triangle"]
    sizes, ways = np.linalg.eigh(A.T @ A)
    kept = sizes > 1e-6 * sizes[-1]
    assert 0 < kept.sum() < 57
    own = A @ ways[:, kept] / np.sqrt(sizes[kept])
    Q = span([A[:, :30], A[:, 30:]])
    assert Q.shape == own.shape
    np.testing.assert_allclose(Q @ Q.T, own @ own.T, atol=1e-7)
    _, sines = outside(A[:, :3] / np.linalg.norm(A[:, :3], axis=0), [A])
    assert np.all(sines < 0.01)
