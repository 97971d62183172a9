"""What the tests of meshes measure, and small files of gmsh by hand."""

import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from fenics_joints.meshes import TaggedMesh

COMM = MPI.COMM_WORLD
CELLS = ["hexahedron", "tetrahedron"]


def volumes(tagged: TaggedMesh) -> dict[str, float]:
    """Volume of each part, from the cell averages of one."""
    space = fem.functionspace(tagged.mesh, ("DG", 0))
    vector = fem.assemble_vector(fem.form(ufl.TestFunction(space) * ufl.dx))
    n_owned = space.dofmap.index_map.size_local
    by_cell = vector.array[:n_owned]
    found = {}
    for name, tag in tagged.cell_names.items():
        cells = tagged.cell_tags.find(tag)
        found[name] = COMM.allreduce(by_cell[cells[cells < n_owned]].sum())
    return found


def area(mesh: dolfinx.mesh.Mesh, facets: np.ndarray) -> float:
    """Area of this rank's owned plane facets, by cross products of their edges."""
    fdim = mesh.topology.dim - 1
    facets = facets[facets < mesh.topology.index_map(fdim).size_local]
    mesh.topology.create_connectivity(fdim, mesh.topology.dim)
    doubled = np.empty((0, 3))
    if len(facets):  # DOLFINx 0.9 divides by their number
        x = mesh.geometry.x[dolfinx.mesh.entities_to_geometry(mesh, fdim, facets)]
        ends = (1, 0, 2, 0) if x.shape[1] == 3 else (3, 0, 2, 1)
        a, b, c, d = (x[:, end] for end in ends)
        doubled = np.cross(a - b, c - d)
    return COMM.allreduce(0.5 * np.linalg.norm(doubled, axis=1).sum())


def areas(tagged: TaggedMesh) -> dict[str, float]:
    return {
        name: area(tagged.mesh, tagged.facet_tags.find(tag))
        for name, tag in tagged.facet_names.items()
    }


def skin(tagged: TaggedMesh) -> float:
    """Area of all exterior facets; a cut that does not conform would add its faces to it."""
    mesh = tagged.mesh
    mesh.topology.create_connectivity(2, 3)
    return area(mesh, dolfinx.mesh.exterior_facet_indices(mesh.topology))


# Two hexahedra side by side along x in gmsh's numbering, the face between them and one end.
NODES = [(x, y, z) for x in (0, 1, 2) for y, z in ((0, 0), (1, 0), (1, 1), (0, 1))]
LEFT, RIGHT = [1, 5, 6, 2, 4, 8, 7, 3], [5, 9, 10, 6, 8, 12, 11, 7]
HEXAHEDRON, TETRAHEDRON, PRISM, QUADRATIC_TETRAHEDRON, QUADRILATERAL = 5, 4, 6, 11, 3
NAMES = {(3, 1): "left", (3, 2): "right", (2, 3): "interface"}
ELEMENTS = [(HEXAHEDRON, 1, LEFT), (HEXAHEDRON, 2, RIGHT), (QUADRILATERAL, 3, [5, 6, 7, 8])]


def write_msh(folder, elements=ELEMENTS, names=NAMES, nodes=NODES):
    """Write format 2.2; an element is (gmsh's type, group, vertices from 1[, entity])."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", f"{len(names)}"]
    lines += [f'{dim} {tag} "{name}"' for (dim, tag), name in names.items()]
    lines += ["$EndPhysicalNames", "$Nodes", f"{len(nodes)}"]
    lines += [f"{number} {x} {y} {z}" for number, (x, y, z) in enumerate(nodes, start=1)]
    lines += ["$EndNodes", "$Elements", f"{len(elements)}"]
    for number, (kind, group, vertices, *entity) in enumerate(elements, start=1):
        ids = " ".join(str(vertex) for vertex in vertices)
        lines.append(f"{number} {kind} 2 {group} {entity[0] if entity else group + 10} {ids}")
    path = folder / "mesh.msh"
    path.write_text("\n".join([*lines, "$EndElements", ""]))
    return path


def written(folder, **content):
    if COMM.rank == 0:
        write_msh(folder, **content)
    COMM.barrier()
    return folder / "mesh.msh"
