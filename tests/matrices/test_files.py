"""Matrices from files of other codes: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from fenics_joints.errors import InputError
from fenics_joints.matrices.files import (
    LabelledMatrix,
    Nodes,
    held_note,
    matrix_part,
    read_dofs,
    read_matrix,
    read_nodes,
)

DATA = Path(__file__).parent / "data"
#: Three nodes with translations, in an order of the other code's.
LABELS = np.array([(7, 1), (7, 2), (7, 3), (2, 1), (2, 2), (2, 3), (5, 1), (5, 2), (5, 3)])
PLACES = Nodes({2: np.array([0, 0, 0.0]), 5: np.array([10, 0, 0.0]), 7: np.array([0, 20, 0.0])})


def matrix(seed: int = 0) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(9, 9))
    return A @ A.T


def calculix(**more):
    K, M = (read_matrix(DATA / f"shell.{s}", w) for s, w in (("sti", "stiffness"), ("mas", "mass")))
    known = {"length": 1e-3, "thickness": 4e-3} | more
    return matrix_part(
        "shell", K, M, read_nodes(DATA / "shell.inp"), read_dofs(DATA / "shell.dof"), **known
    )


def test_a_shell_of_calculix():
    """Mass, faces and rigid motions of a triangle of 80 by 60 by 4 mm."""
    part = calculix()
    assert part.total_mass == pytest.approx(0.5 * 0.08 * 0.06 * 0.004 * 7850)
    assert sorted(set(part.points[:, 2].round(9))) == [0.003, 0.005, 0.007]
    assert held_note(part) is None
    # Its bending is right only if each copy of a node is on its own face.
    assert "turned" in held_note(calculix(thickness=9e-3))
    up, moved = part.rigid_motion()[:, 2], part.displacement([[0.02, 0.01, 0.007]])
    assert moved @ up == pytest.approx([0, 0, 1])
    assert sorted(read_nodes(DATA / "shell.inp").sets) == ["ALL", "EDGE"]
    with pytest.raises(InputError, match="several times, as of a shell of CalculiX"):
        calculix(thickness=None)


def test_units_of_mm_and_newtons():
    """The same springs and masses, one in N and m, one in N, mm and t."""
    K, M = matrix(), matrix(1)
    metres = matrix_part(
        "p", LabelledMatrix(sp.csr_matrix(K)), LabelledMatrix(sp.csr_matrix(M)), PLACES, LABELS
    )
    mm = LabelledMatrix(sp.csr_matrix(K / 1e3)), LabelledMatrix(sp.csr_matrix(M / 1e3))
    part = matrix_part("p", *mm, PLACES, LABELS, length=1e-3)
    assert part.stiffness.toarray() == pytest.approx(K)
    assert part.mass.toarray() == pytest.approx(M)
    assert part.points == pytest.approx(1e-3 * metres.points)
    # Of a rotation: 1 N mm is 1e-3 N m.
    turned = LABELS.copy()
    turned[:, 1] += 3
    found = matrix_part("p", *mm, PLACES, turned, length=1e-3)
    assert found.stiffness.toarray() == pytest.approx(1e-3 * K / 1e3)


def _written(folder: Path, kind: str, K: np.ndarray, M: np.ndarray) -> list[Path]:
    files = [folder / f"{name}.{kind}" for name in "KM"]
    if kind == "mtx":
        scipy.io.mmwrite(files[0], sp.coo_matrix(K), symmetry="symmetric")
        scipy.io.mmwrite(files[1], sp.coo_matrix(M))
    elif kind == "npz":
        sp.save_npz(files[0], sp.csr_matrix(K))
        np.savez(files[1], mass=M)
    elif kind == "mat":
        scipy.io.savemat(files[0], {"K": sp.csc_matrix(K), "M": M})
        files[1] = files[0]
    elif kind == "op4":
        op4 = pytest.importorskip("pyyeti.nastran.op4")
        op4.write(str(files[0]), {"KGG": K, "MGG": M})
        files[1] = files[0]
    elif kind == "pch":
        bulk = pytest.importorskip("pyyeti.nastran.bulk")
        pandas = pytest.importorskip("pandas")
        index = pandas.MultiIndex.from_arrays(LABELS.T, names=["id", "dof"])
        frames = {
            n: pandas.DataFrame(A, index=index, columns=index)
            for n, A in (("kaax", K), ("maax", M))
        }
        bulk.wtdmig(str(files[0]), frames)
        files[1] = files[0]
    return files


@pytest.mark.parametrize("kind", ["mtx", "npz", "mat", "op4", "pch"])
def test_formats(tmp_path, kind):
    K, M = matrix(), matrix(1)
    files = _written(tmp_path, kind, K, M)
    read = [read_matrix(f, what) for f, what in zip(files, ("stiffness", "mass"), strict=True)]
    dofs = None if kind == "pch" else LABELS
    part = matrix_part("p", *read, PLACES, dofs)
    # In the order of the table, which those of DMIG has not.
    order = [part.rows[list(part.numbers).index(n), w - 1] for n, w in LABELS]
    assert part.stiffness.toarray()[np.ix_(order, order)] == pytest.approx(K)
    assert part.mass.toarray()[np.ix_(order, order)] == pytest.approx(M)


@pytest.mark.parametrize("kind", ["csr", "csc", "coo", "dia", "bsr"])
def test_sparse_formats_of_scipy(tmp_path, kind):
    sp.save_npz(tmp_path / "k.npz", sp.csr_matrix(matrix()).asformat(kind))
    found = read_matrix(tmp_path / "k.npz", "stiffness")
    assert found.matrix.toarray() == pytest.approx(matrix())


def test_abaqus_names_its_rows(tmp_path):
    K, lines = matrix(), []
    for i in range(9):
        for j in range(i + 1):
            lines.append(", ".join(map(str, (*LABELS[i], *LABELS[j], float(K[i, j])))))
    (tmp_path / "k.mtx").write_text("\n".join(lines))
    found = read_matrix(tmp_path / "k.mtx", "stiffness")
    order = np.lexsort(LABELS.T[::-1])
    assert found.labels.tolist() == LABELS[order].tolist()
    assert found.matrix.toarray() == pytest.approx(K[np.ix_(order, order)])


def test_ansys(tmp_path):
    reader = pytest.importorskip("ansys.mapdl.reader")
    from ansys.mapdl.reader import examples

    labels, K, _ = reader.read_binary(examples.fullfile).load_km()
    path = tmp_path / "file.full"
    path.write_bytes(Path(examples.fullfile).read_bytes())
    found = read_matrix(path, "stiffness")
    whole = K + sp.triu(K, 1).T
    assert abs(found.matrix - whole).max() == 0
    assert found.labels.tolist() == (labels + [0, 1]).tolist()


def test_strangers_files_are_refused(tmp_path):
    np.savez(tmp_path / "object.npz", K=np.array([object()], dtype=object))
    (tmp_path / "text.sti").write_text("one two\n")
    (tmp_path / "k.step").write_text("")
    np.savez(tmp_path / "other.npz", A=matrix())
    np.savez(tmp_path / "oblong.npz", K=np.ones((3, 2)))
    np.savez(tmp_path / "lossy.npz", K=(1 + 0.02j) * matrix())
    (tmp_path / "high.sti").write_text("1 1 2.0\n4000000000 4000000000 2.0\n")
    for name, words in (
        ("object.npz", "cannot be read as .npz"),
        ("text.sti", "row column value"),
        ("k.step", "expected a file of .sti"),
        ("other.npz", "no stiffness .*expected one of A"),
        ("oblong.npz", "square"),
        ("lossy.npz", "complex: expected a real matrix"),
        ("high.sti", "2 entries for 4000000000 rows"),
        ("none.npz", "none.npz: no such file"),
    ):
        with pytest.raises(InputError, match=words):
            read_matrix(tmp_path / name, "stiffness")
    (tmp_path / "nodes.inp").write_text("*NODE\n1,0,0,0\n9,1,0,0\n*NGEN\n1,9,1\n")
    with pytest.raises(InputError, match=r"nodes\.inp: has \*NGEN"):
        read_nodes(tmp_path / "nodes.inp")
    (tmp_path / "set.inp").write_text("*NODE\n1,0,0,0\n*NSET, NSET=A, GENERATE\n1, 9999999999\n")
    with pytest.raises(InputError, match="more than 10,000,000 members"):
        read_nodes(tmp_path / "set.inp")
    K = LabelledMatrix(sp.csr_matrix(matrix()))
    with pytest.raises(InputError, match="no place is known of node 7"):
        matrix_part("p", K, K, Nodes({2: np.zeros(3), 5: np.ones(3)}), LABELS)
    with pytest.raises(InputError, match="8 degrees of freedom are named"):
        matrix_part("p", K, K, PLACES, LABELS[:8])
    with pytest.raises(InputError, match="no table of degrees of freedom"):
        matrix_part("p", K, K, Nodes({1: np.zeros(3), 2: np.ones(3)}))
    (tmp_path / "d.dof").write_text("a b c\n")
    with pytest.raises(InputError, match=r"node\.direction"):
        read_dofs(tmp_path / "d.dof")
