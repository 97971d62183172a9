"""How far the nominal models are from the world in its state without effects or noise.

Run with ``python benchmarks/blind/discrepancy.py [GEOMETRY ...]``; ``GEOMETRY:careful`` is the
model of a careful user. This is what
``[diagnose] discrepancy`` of the nominal cases must honestly cover: by the finer model, where the
diagnosis takes the mesh's own error off.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from mpi4py import MPI

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.blind import worlds  # noqa: E402
from fenics_joints.case import load_case  # noqa: E402
from fenics_joints.diagnosis.model.resolution import mesh_errors
from fenics_joints.diagnosis.model.subject import subject_of
from fenics_joints.progress import Progress
from fenics_joints.reduction.matched import MatchedModes


def compare(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, Hz, of the nominal model, of it with one degree more, and of the world, (m,)
    each, and the error of the shapes.

    The finer one's is nan where it has not the mode; the error of the shapes is relative to unit
    root mean square, (n_s, m).
    """
    geometry, _, careful = name.partition(":")
    world = worlds.world_of(geometry)
    truth = world.clean(world.nominal_spec(geometry))
    more = (True,) if careful else ()
    with tempfile.TemporaryDirectory() as folder:
        world.write_nominal(geometry, truth, Path(folder), *more)
        case = load_case(folder).diagnosed()
        subject = subject_of(case, MPI.COMM_SELF, Progress(silent=True))
        n, count = truth.frequencies.shape[1], case.diagnose.n_modes
        seen = MatchedModes(
            subject.full, subject.baseline, sensors=case.sensors(), n_test=n, n_modes=count
        )  # as a diagnosis starts from it
        errors = mesh_errors(seen, subject.baseline, Progress(silent=True))
    modes, pairing = seen.nominal, seen.pairing
    shapes = pairing.shapes / np.sqrt(np.mean(pairing.shapes**2, axis=0))
    shapes = shapes * np.sign(np.sum(shapes * truth.shapes, axis=0))
    print(f"{name}: {seen.full.n_dofs} unknowns, {modes.model.total_mass(modes.given):.4f} kg")
    own = modes.frequencies_hz[pairing.index]
    return own, own / (1 + errors.frequencies), truth.frequencies[-1], shapes - truth.shapes


def main(names: list[str]) -> None:
    """Print the comparison for each geometry."""
    for name in names or worlds.geometries():
        model, finer, truth, error = compare(name)
        print("  world, Hz ", *(f"{f:9.2f}" for f in truth))
        for word, hz in (("nominal", model), ("finer", finer)):
            change = 100 * (hz / truth - 1)
            print(f"  {word:10s}", *(f"{f:9.2f}" for f in hz))
            print(
                f"  {word:7s}, %",
                *(f"{c:9.2f}" for c in change),
                f"  rms {np.sqrt(np.nanmean(change**2)):.2f}",
            )
        print("  shapes, % ", *(f"{100 * e:9.2f}" for e in np.sqrt(np.mean(error**2, axis=0))))


if __name__ == "__main__":
    main(sys.argv[1:])
