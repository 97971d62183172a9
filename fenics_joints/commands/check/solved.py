"""The modes of a case's nominal model, for a second's work, and what is unlikely beside them."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case, build_preload, build_structure, estimate
from fenics_joints.errors import InputError, JointsError
from fenics_joints.formatting import number, percent
from fenics_joints.measurements.gap import VISIBLE, TooFewModes, pair_modes
from fenics_joints.measurements.mistakes import mistakes_beside
from fenics_joints.meshes import TaggedMesh
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import LinearJoint
from fenics_joints.progress import Progress

__all__ = ["Beside", "beside_model"]

#: Degrees of freedom that are solved: some two seconds. And of a model one degree finer, which
#: only a coarse mesh needs: one as large as this resolves more modes than a test has.
_MOST, _FINER = 20_000, 10_000
#: Keys of a joint to which its stiffness is proportional.
_STIFFNESSES = ("E", "G", "k_n", "k_t", "k1", "k2", "k_axial")
#: Error of a frequency by the mesh that is said.
_COARSE = 0.05


@dataclass(frozen=True)
class Beside:
    """What the nominal model's modes say of a case.

    Attributes:
        words: What was solved, and in what time; or why nothing was. Empty if there is nothing to
            compare with.
        notes: What is unlikely, in sentences.
    """

    words: str = ""
    notes: tuple[str, ...] = ()


def beside_model(
    case: Case, tagged: TaggedMesh | None, dofs: int, comm: MPI.Intracomm, progress: Progress
) -> Beside:
    """Solve the nominal model's modes and hold test and bands against them. Collective.

    Args:
        case: The case, without errors.
        tagged: Its mesh; None for beams.
        dofs: Degrees of freedom of its model.
        comm: Communicator.
        progress: Told before the solution.
    """
    if case.measured is None and not _bands(case):
        return Beside()
    if case.obstacles:
        return Beside("not held against the model's modes: where obstacles touch is not known yet")
    try:
        case, tagged = _small_enough(case, tagged, dofs)
        progress.step("modes of the nominal model")
        begin = time.perf_counter()
        model = _built(case, comm, tagged)
        modes = solve_modes(model, n_modes=min(case.diagnose.n_modes, model.n_dofs))
        notes = [*_of_test(case, modes), *_of_bands(case, modes), *_of_mesh(case, model, modes)]
    except JointsError as error:
        reason = str(error).removeprefix(f"{case.path}: ")
        return Beside(f"not held against the model's modes: {reason}")
    spent = comm.bcast(time.perf_counter() - begin)
    words = f"{len(modes)} modes of {model.n_dofs} degrees of freedom in {number(spent, 2)} s"
    return Beside(f"held against {words}", tuple(notes))


def _small_enough(case: Case, tagged, dofs: int) -> tuple[Case, TaggedMesh | None]:
    """The case with its own mesh, that of its diagnosis, or elements so large that it is small.

    Raises:
        InputError: If it stays too large.
    """
    if tagged is None or dofs <= _MOST:
        return case, tagged
    coarse = case.diagnosed()
    for key in ("size", "element_size"):
        size = getattr(coarse.mesh, key, None)
        if size is not None and (dofs := estimate(coarse).dofs) > _MOST:
            mesh = coarse.mesh.model_copy(update={key: size * (dofs / _MOST) ** 0.5})
            coarse = coarse.model_copy(update={"mesh": mesh})
    found = estimate(coarse)
    if found.dofs > _MOST:
        raise InputError(f"{found}, too large for a check; `modes` does it")
    return coarse, None


def _built(case: Case, comm: MPI.Intracomm, tagged: TaggedMesh | None):
    if case.contacts:
        return LinearJoint(build_preload(case, comm, tagged=tagged, at_rest=True))
    return build_structure(case, comm, tagged=tagged)


def _bands(case: Case) -> dict[str, tuple[float, float]]:
    """Bands of frequency in which modes are expected, Hz."""
    found = {} if case.harmonic is None else {"harmonic.band": case.harmonic.band}
    if case.test is not None and case.test.frfs is not None and case.test.frfs.band is not None:
        found["test.frfs.band"] = case.test.frfs.band
    return found


def _of_bands(case: Case, modes: Modes) -> list[str]:
    """Bands without a mode."""
    hz, notes = modes.frequencies_hz[modes.n_rigid :], []
    for key, (low, high) in _bands(case).items():
        if not len(hz) or np.any((hz > low / 1.5) & (hz < 1.5 * high)) or low > hz[-1]:
            continue
        near = hz[np.argmin(np.abs(np.log(hz / np.sqrt(max(low, 1e-9) * high))))]
        notes.append(
            f"{key} = [{low:g}, {high:g}] Hz: the model has no mode there; expected a band round "
            f"one, the nearest of which is at {near:.4g} Hz"
        )
    return notes


def _of_test(case: Case, modes: Modes) -> list[str]:
    """What is unlikely in the measured modes."""
    data = case.measured
    if data is None:
        return []
    own = case.row()
    row = data.shape_row if data.shapes is not None or own is None else own
    seen, shapes = np.arange(modes.n_rigid, len(modes)), None
    if data.sensors is not None:
        seen = seen[modes.visibility(data.sensors)[seen] > VISIBLE]
        shapes = modes.at(data.sensors)
    pairing, hz = None, modes.frequencies_hz
    with suppress(TooFewModes):
        pairing = pair_modes(modes, len(data.mode_names), data.sensors, reference=data.shapes)
        seen = pairing.visible
    notes = mistakes_beside(
        data, row, hz, seen, shapes, pairing, lambda n: _share_of_joints(case, modes, seen[:n])
    )
    if pairing is None and np.nanmax(data.frequencies_hz[row]) < hz[-1]:
        notes.append(
            f"test.sees: its sensors see {len(seen)} of the model's {len(modes) - modes.n_rigid} "
            f"elastic modes up to {hz[-1]:.4g} Hz; expected at least the {len(data.mode_names)} "
            "that were measured: are their places and directions right?"
        )
    return notes


def _share_of_joints(case: Case, modes: Modes, index) -> float:
    """Share of the strain energy of modes that is in joints, of the middle one; 0 of contacts."""
    values = modes.model.values(modes.given)
    stiff = [f"{name}.{key}" for name in case.joints for key in _STIFFNESSES]
    there = [name for name in stiff if name in values]
    if not there:
        return 0.0
    columns = [list(modes.model.parameters).index(name) for name in there]
    slopes = modes.gradients(index)[:, columns] @ np.array([values[name] for name in there])
    return float(np.median(slopes / modes.eigenvalues[index]))


def _of_mesh(case: Case, model, modes: Modes) -> list[str]:
    """What the mesh does to the modes in the range of the test, where it is coarse."""
    data = case.measured
    if data is None:
        return []
    finer, key = _finer(case, model)
    if finer is None or finer.n_dofs > _FINER:
        return []
    # On nested spaces each eigenvalue, in order, is above the finer one's (Courant and Fischer).
    better = solve_modes(finer, n_modes=len(modes))
    count = int(np.sum(modes.frequencies_hz < 1.1 * np.nanmax(data.frequencies_hz)))
    count = max(count, modes.n_rigid + data.frequencies_hz.shape[1])
    own, true = (m.frequencies_hz[m.n_rigid : count] for m in (modes, better))
    n = min(len(own), len(true))
    off = own[:n] / true[:n] - 1
    if not n or np.max(np.abs(off)) < _COARSE:
        return []
    worst = int(np.argmax(np.abs(off)))
    return [
        f"{key}: the mesh alone makes the model's frequencies up to {percent(off[worst])} too high "
        f"in the range of the test (at {own[worst]:.4g} Hz, {true[worst]:.4g} Hz on a finer one); "
        f"expected less than {percent(_COARSE)}: smaller elements, or more of them"
    ]


def _finer(case: Case, model):
    """A finer model of the same structure, or None, and the key that says how fine it is."""
    mesh = case.mesh
    if mesh.origin == "beams":
        finer = mesh.model_copy(update={"elements": [2 * n for n in mesh.elements]})
        return build_structure(case.model_copy(update={"mesh": finer}), MPI.COMM_SELF), \
            "mesh.elements"  # fmt: skip
    keys = [key for key in ("element_size", "size", "file") if getattr(mesh, key, None) is not None]
    own = getattr(model, "finer", None)
    small = own is not None and 2.5 * model.n_dofs < _FINER
    return own() if small else None, f"mesh.{(keys or ['builder'])[0]}"
