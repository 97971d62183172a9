"""A bilinear form's matrix on every rank, for tests that compare with scipy."""

from __future__ import annotations

import scipy.sparse as sp
from dolfinx import fem
from dolfinx.fem.petsc import assemble_matrix


def gathered(form):
    """Sparse matrix of a bilinear form, the same on every rank."""
    matrix = assemble_matrix(fem.form(form))
    matrix.assemble()
    comm, (rows, _), (_, columns) = matrix.getComm().tompi4py(), matrix.local_size, matrix.size
    indptr, indices, data = matrix.getValuesCSR()
    blocks = comm.allgather(sp.csr_matrix((data, indices, indptr), shape=(rows, columns)))
    matrix.destroy()
    return sp.vstack(blocks).tocsr()
