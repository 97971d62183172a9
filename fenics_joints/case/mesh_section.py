"""What the rest of a case, and of the program, asks of a ``[mesh]`` section of any kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar, Literal

from mpi4py import MPI

from fenics_joints.case.values import Section
from fenics_joints.meshes import TaggedMesh


class MeshSection(Section):
    """``[mesh]``."""

    #: Where the structure is from: its own builder, a file, or beams in place of a mesh.
    origin: ClassVar[Literal["builder", "file", "beams"]]

    def build(self, folder: Path, comm: MPI.Intracomm) -> TaggedMesh:
        """The mesh; ``folder`` is the case's. Collective.

        Raises:
            MeshError: If it cannot be built or read, or there is none.
            InputError: If an argument is out of range.
        """
        raise NotImplementedError

    @property
    def grows(self) -> bool:
        """Whether its layers are as thin as can be."""
        return False

    def bolt_points(self) -> tuple[str, Any]:
        """Where the file gives the bolts' places, and what it gives there."""
        return "mesh.bolts", getattr(self, "bolts", None)
