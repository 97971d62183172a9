"""Masses in a row with a slider across every spring, as a dense model or shared over ranks."""

import numpy as np
from oscillators import Jenkins
from petsc4py import PETSc

from fenics_joints.interfaces import FullModel, InterfaceModel, InterfacePoints, SparsePoints


def chain(comm=None, n=6):
    """Masses in a row, clamped at one end, with a slider across every spring: dense or shared."""
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1
    M, C = np.diag(np.linspace(1, 2, n)), 0.01 * K
    rows = np.eye(n) - np.eye(n, k=-1)
    law, weights = Jenkins(k=[0.6, 0.4], s=[0.02, 0.05]), np.linspace(1, 2, n)
    end = np.eye(n)[-1]
    if comm is None:
        joint = InterfacePoints("joint", law, rows[:, None, :], weights)
        return InterfaceModel(M, K, (joint,), C, {"end": end}, {"end": end})
    share = PETSc.Vec().createMPI(n, comm=comm)
    first, last = share.getOwnershipRange()

    def shared(array):
        A = PETSc.Mat().createAIJ(((last - first, n),) * 2, nnz=n, comm=comm)
        for i in range(first, last):
            at = np.flatnonzero(array[i]).astype(np.int32)
            A.setValues([i], at, array[i, at])
        A.assemble()
        return A

    share.array[:] = end[first:last]
    joint = SparsePoints("joint", law, shared(rows), weights[first:last], n_components=1)
    return FullModel(shared(M), shared(K), (joint,), shared(C), {"end": share}, {"end": share})
