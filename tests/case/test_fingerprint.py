"""What tells kept models apart: all that makes them, however the mesh is shared out."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
from block_file import write_block
from mpi4py import MPI

from fenics_joints.case import build_structure, load_case
from fenics_joints.case.fingerprint import fingerprint
from fenics_joints.meshes import lap_plates

TEXT = """
[mesh]
file = "{file}"
scale = "1 mm"

[parts.block]
cells = "block"
E = "{E} GPa"
nu = 0.3
rho = 7800

[supports.left]
facets = "left"
"""


@pytest.mark.parallel
def test_a_mesh_is_known_on_any_number_of_ranks():
    """Alone and shared out the same; a moved vertex, a named face and a bolt make it another."""

    def digests(comm, moved=0.0):
        tagged = lap_plates(comm, element_size=0.02, n_thickness=1)
        x = tagged.mesh.geometry.x
        place = x[:, 0].max(initial=-np.inf)
        place = comm.allreduce(place, op=MPI.MAX)
        x[x[:, 0] == place, 0] += moved
        cells, points = tagged.cell_names, dict(tagged.points)
        swapped = dict(zip(cells, reversed(cells.values()), strict=True))
        yield tagged.digest
        yield replace(tagged, cell_names=swapped).digest
        yield replace(tagged, points=points | {"more": np.zeros((1, 3))}).digest

    alone, shared = (list(digests(comm)) for comm in (MPI.COMM_SELF, MPI.COMM_WORLD))
    assert alone == shared and len(set(alone)) == 3
    assert next(digests(MPI.COMM_WORLD, 1e-9)) not in alone


def test_a_kept_model_is_found_again_by_what_is_in_its_mesh(tmp_path):
    """However its file's path is written, and not where a corner was moved or E is another."""

    def name(folder, file, E=210):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "case.toml").write_text(TEXT.format(file=file, E=E))
        case = load_case(tmp_path / folder)
        return fingerprint(case, build_structure(case, MPI.COMM_SELF), None)

    whole = write_block(tmp_path / "block.msh")
    shutil.copy(whole, tmp_path / "copy.msh")
    (tmp_path / "a").mkdir()
    found = {name("a", "../block.msh"), name("a", "../a/../copy.msh"), name("b", str(whole))}
    assert len(found) == 1
    # The same box, of which one layer of nodes stands elsewhere: volumes and counts are the same.
    write_block(tmp_path / "copy.msh", cells=(2, 2, 2))
    text = (tmp_path / "copy.msh").read_text()
    (tmp_path / "copy.msh").write_text(text.replace("10 10 20\n", "10 10 21\n"))
    assert text.count("10 10 20\n") == 1
    assert not found & {name("a", "../copy.msh"), name("a", "../block.msh", E=211)}
