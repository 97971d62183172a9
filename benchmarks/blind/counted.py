"""The error of a model as the diagnosis counts it, for D and the oracle of the second world.

What the nominal case states of its model is the least of it: what it states turns close modes into
one another, joints that are as one err in all modes together, and of the mesh's own error some is
left. A cause that such an error hides is hidden from any diagnosis that is told of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fenics_joints.diagnosis.evidence.entries import Neighbours
from fenics_joints.diagnosis.evidence.evidence import BEYOND, Evidence, evidence_of
from fenics_joints.diagnosis.model.bonded import SHARE
from fenics_joints.measurements.data import TestData


@dataclass(frozen=True, kw_only=True)
class Errors:
    """What a model of a case may err by.

    Attributes:
        discrepancy: Standard deviation in ln f, as the case states it.
        of_shapes: Likewise of a component of a shape of root mean square 1.
        mesh: By how much the mesh alone is off in each mode, as the diagnosis of the case has found
            it, by the mode's number; a mode that the mesh does not resolve is not there. Empty for
            a mesh without error.
    """

    discrepancy: float
    of_shapes: float
    mesh: Mapping[int, float]

    def covariance(
        self,
        test: TestData,
        neighbours: Neighbours | None = None,
        joints: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    ) -> np.ndarray:
        """Of ln f (n m) and shapes (n_s m), noise counted, (N, N).

        Args:
            test: The test.
            neighbours: All modes that its own may turn into.
            joints: Of each way in which all joints give way, at any size, the change of ln f, (m,),
                and of the shapes, (n_s, m).
        """
        shaped = test.shapes is not None
        evidence = evidence_of(test, self.discrepancy, self.of_shapes)
        if self.mesh:
            evidence = self._on_mesh(evidence)
        sizes = [SHARE * self.discrepancy / np.sqrt(np.mean(log_f**2)) for log_f, _ in joints]
        joint_f, joint_shapes = (
            np.stack([size * each[part] for size, each in zip(sizes, joints, strict=True)], -1)
            if joints
            else None
            for part in (0, 1)
        )
        evidence = replace(
            evidence,
            scales=None,
            neighbours=neighbours if shaped else None,
            joint_f=joint_f,
            joint_shapes=joint_shapes if shaped else None,
        )
        return evidence.full_covariance()

    def _on_mesh(self, evidence: Evidence) -> Evidence:
        said = [self.mesh.get(mode, np.nan) for mode in range(1, evidence.shape[1] + 1)]
        # What is said holds what is expected beyond the degree that it was found with.
        return evidence.on_mesh(np.expm1(np.log1p(said) / (1 + BEYOND)))
