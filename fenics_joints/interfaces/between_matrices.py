"""Reduced models of parts by matrices whose joints are nonlinear."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from petsc4py import PETSc

from fenics_joints.errors import InputError
from fenics_joints.interfaces.basis import as_vectors, assemble, energy_share, free_interface
from fenics_joints.interfaces.model import InterfacePoints
from fenics_joints.interfaces.reduced import ReducedInterfaceModel
from fenics_joints.joint_laws.law import JointLaw
from fenics_joints.matrices import MatrixJoint, MatrixStructure
from fenics_joints.modal.modes import solve_modes
from fenics_joints.reduction.affine import AffinePencil
from fenics_joints.structure.faces import frames
from fenics_joints.structure.laws import SPRINGS
from fenics_joints.structure.sparse import as_columns
from fenics_joints.structure.structure import Places, place_loads


class _Jumps:
    """Jumps at the points of all joints that laws take: `basis.Strains`.

    Args:
        structure: The parts.
        laws: Law of each joint, by its name.
        values: Values of all parameters.
    """

    def __init__(self, structure: MatrixStructure, laws: Mapping[str, JointLaw], values):
        self.structure, self.joints = structure, []
        there = {joint.name: joint for joint in structure.joints}
        for name, law in laws.items():
            joint = there.get(name)
            if joint is None or joint.law is not SPRINGS:
                known = ", ".join(n for n, j in there.items() if j.law is SPRINGS)
                raise InputError(f"laws: {name!r}: expected a joint of springs: {known or 'none'}")
            rows = self._rows(joint, law.coupled)
            q = {key: joint.properties[key] for key in ("k_n", "k_t")}
            k_n, k_t = (values[v] if isinstance(v, str) else float(v) for v in q.values())
            self.joints.append((joint, law, rows, [k_n, k_t, k_t][not law.coupled :]))
        self.size = sum(rows.shape[0] for _, _, rows, _ in self.joints)
        roots = [np.repeat(np.sqrt(j.interface.areas), len(k)) for j, _, _, k in self.joints]
        self._weighted = sp.diags(np.concatenate(roots)) @ sp.vstack(
            [r for _, _, r, _ in self.joints]
        )

    def _rows(self, joint: MatrixJoint, coupled: bool) -> sp.csr_matrix:
        """Jump along the normal, if the law takes it, and two tangents, point by point."""
        axes = frames(joint.interface.normal[None])[0][0 if coupled else 1 :]
        turn = sp.block_diag([axes] * len(joint.interface.areas), format="csr")
        return turn @ self.structure.jump(joint)

    def __call__(self, columns: np.ndarray) -> np.ndarray:
        comm = self.structure.comm
        return self._weighted @ np.concatenate(comm.allgather(columns))

    def tangent(self) -> np.ndarray:
        return np.diag(
            np.concatenate([np.tile(k, len(j.interface.areas)) for j, _, _, k in self.joints])
        )

    def stresses(self) -> np.ndarray:
        return self._weighted[:, slice(*self.structure.range)].toarray().T

    def interfaces(self, columns: np.ndarray) -> list[InterfacePoints]:
        """The joints' points in a basis. Collective."""
        whole, found = np.concatenate(self.structure.comm.allgather(columns)), []
        for joint, law, rows, k in self.joints:
            own = (rows @ whole).reshape(-1, len(k), whole.shape[1])
            areas, points = joint.interface.areas, joint.interface.points
            found.append(InterfacePoints(joint.name, law, own, areas, law.coupled, points))
        return found


def reduce_matrix_joints(
    structure: MatrixStructure,
    laws: Mapping[str, JointLaw],
    *,
    n_modes: int = 20,
    interface_modes: int | None = None,
    forces: Places | None = None,
    sensors: Places | None = None,
    given: Mapping[str, float] | None = None,
    extra: Sequence[PETSc.Vec] = (),
) -> ReducedInterfaceModel:
    """Reduced model of parts by matrices whose joints follow nonlinear laws. Collective.

    As `reduce_layers`; the strain of a law is the jump of the displacement, m.

    Args:
        structure: The parts, with joints of springs that have the laws' stiffness at rest.
        laws: Law of each joint that becomes nonlinear, by its name.
        n_modes: Modes of the linear structure, rigid-body modes included.
        interface_modes: Number of interface modes, 0 for none; by default as many as modes.
        forces: Position, m, and direction of each force, by name.
        sensors: Those of each sensor.
        given: Parameters that differ from their nominal value; the basis is best there.
        extra: Displacements to keep in the basis.

    Raises:
        InputError: For an unknown joint or one that has no springs, or a place beside the parts.
    """
    jumps = _Jumps(structure, laws, structure.values(given))
    forces, sensors = (
        place_loads(structure, "forces", forces),
        place_loads(structure, "sensors", sensors),
    )
    modes = solve_modes(structure, given, n_modes=n_modes)
    M, K = structure.mass(given), structure.stiffness(given)
    choose = energy_share(interface_modes or None, None, n_modes, jumps.size)
    columns = free_interface(
        K,
        M,
        modes.solver,
        as_columns(modes.shapes),
        np.hstack([forces[1], sensors[1]]),
        jumps,
        None if interface_modes == 0 else choose,
        as_columns(extra) if len(extra) else None,
    ).columns
    source = structure.on_basis(as_vectors(K, columns))
    modes.solver.destroy(), K.destroy(), M.destroy()
    pencil = _without_stress(source.pencil, laws)
    interfaces = jumps.interfaces(columns)
    return assemble(columns, source, interfaces, pencil, {}, given, forces, sensors)


def _without_stress(pencil: AffinePencil, laws: Mapping[str, JointLaw]) -> AffinePencil:
    """The pencil without the springs that laws replace: along the joint, and across if coupled."""
    regions = []
    for region in pencil.regions:
        if region.name in laws:
            stiffness = np.zeros_like(region.stiffness)
            if not laws[region.name].coupled:
                stiffness[0] = region.stiffness[0]
            region = replace(region, stiffness=stiffness)
        regions.append(region)
    return replace(pencil, regions=regions)
