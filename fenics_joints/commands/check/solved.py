"""Solve the baseline model's modes in seconds and compare the test and the bands with them."""

from __future__ import annotations

import time
from contextlib import suppress

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case, build_preload, build_structure, estimate
from fenics_joints.errors import InputError, JointsError
from fenics_joints.formatting import number, percent
from fenics_joints.measurements.gap import VISIBLE, TooFewModes, pair_modes, rms
from fenics_joints.measurements.mistakes import mistakes_beside
from fenics_joints.meshes import TaggedMesh
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import LinearJoint
from fenics_joints.progress import Progress
from fenics_joints.structure import Structure

#: Degrees of freedom up to which a model is solved as it is, in some two seconds; larger ones get
#: larger elements, for half as many. And up to which a finer model is solved, in some five seconds,
#: to see whether the mesh is too coarse.
_MOST, _FINER = 20_000, 40_000
#: Keys of a mesh that say how large its cells are.
_SIZES = ("element_size", "size", "file")
#: Keys of a joint to which its stiffness is proportional.
_STIFFNESSES = ("E", "G", "k_n", "k_t", "k1", "k2", "k_axial")
#: Factor by which a mode may lie outside its band.
_MARGIN = 1.5
#: Error of a frequency, by the mesh, from which a note is made; and that of all, as a share of the
#: model's error against the test, from which the mesh hides what the test shows. Chosen.
_COARSE, _HIDES = 0.05, 0.2
#: Error by the mesh that is no reason for a note: that of many tests. Chosen.
_SLIGHT = 0.005
#: Modes that are looked at where no test says how many, rigid ones included. Chosen.
_LOOKED = 12
#: Kinetic energy of a mode, and mass, as shares of parts that move alone. Chosen: what hangs
#: loosely on a structure moves so; a thin cover may too.
_ALONE, _SMALL = 0.9, 0.2
#: Lowest and highest first frequency times length over the speed of sound. A compact block has 0.5
#: at most, a strip 300 times as long as it is thick 0.003; the rest is margin. Chosen.
_SLOW, _FAST = 1e-5, 2.0


def beside_model(
    case: Case, tagged: TaggedMesh | None, dofs: int, comm: MPI.Intracomm, progress: Progress
) -> tuple[str, list[str]]:
    """Solve the baseline model's modes and compare test and bands with them. Collective.

    Args:
        case: The case, without errors.
        tagged: Its mesh; None for beams.
        dofs: Degrees of freedom of its model.
        comm: Communicator.
        progress: Told before the solution.

    Returns:
        What was solved, and in what time, or why nothing was. And what is unlikely, in sentences.
    """
    bands = {} if case.harmonic is None else {"harmonic.band": case.harmonic.band}
    if case.frfs() is not None and case.test.frfs.band is not None:
        bands["test.frfs.band"] = case.test.frfs.band
    compared = bool(case.measured is not None or bands)
    begin = time.perf_counter()
    try:
        if case.obstacles:
            raise InputError("where obstacles touch is known only after the preload")
        if not compared and dofs > _MOST and getattr(case.mesh, "degree", 1) == 2:
            # Too stiff, in a sixth of the size: it shows what is loose.
            case = case.model_copy(update={"mesh": case.mesh.model_copy(update={"degree": 1})})
        else:
            case, tagged = _small_enough(case, tagged, dofs)
        progress.step("modes of the baseline model")
        if case.contacts:
            model = LinearJoint(build_preload(case, comm, tagged=tagged, at_rest=True))
        else:
            model = build_structure(case, comm, tagged=tagged)
        if model.n_dofs > 2 * _MOST:
            raise InputError(
                f"{model.n_dofs} degrees of freedom are too many for a check; run "
                "fenics-joints modes"
            )
        wanted = case.diagnose.n_modes if compared else _LOOKED
        modes = solve_modes(model, n_modes=min(wanted, model.n_dofs))
        notes = _of_modes(case, modes)
        notes += _of_bands(bands, modes.frequencies_hz[modes.n_rigid :])
        if case.measured is not None:
            notes += [*_of_test(case, modes), *_of_mesh(case, comm, model, modes)]
    except JointsError as error:
        reason = str(error).removeprefix(f"{case.path}: ")
        what = "not compared with the model's modes" if compared else "modes not checked"
        return f"{what}: {reason}", []
    spent = number(comm.bcast(time.perf_counter() - begin), 2)
    words = f"{len(modes)} modes of a model of {model.n_dofs} degrees of freedom"
    words = f"compared with {words}" if compared else f"checked {words}"
    return f"{words}, solved in {spent} s", notes


def _of_modes(case: Case, modes: Modes) -> list[str]:
    """Notes on modes that no sound structure has: too many rigid ones, parts that move alone."""
    notes, values = [], modes.model.values(modes.given)
    free = 3 if getattr(case.mesh, "gdim", 3) == 2 else 6
    if modes.n_rigid > free and not case.contacts:
        notes.append(
            f"the model has {modes.n_rigid} motions without stiffness, expected at most {free}: "
            "are all parts joined?"
        )
    hz, index = modes.frequencies_hz, range(modes.n_rigid, len(modes))
    if len(index) == 0 or case.contacts:
        return notes
    ratio = hz[index[0]] / modes.model.dilation_frequency(modes.given)
    if not _SLOW < ratio < _FAST:
        notes.append(
            f"the first elastic frequency is {hz[index[0]]:.3g} Hz, {ratio:.2g} times that of "
            "the breathing mode of a block of this size and material: are moduli, densities and "
            "units right?"
        )
    parts = [name for name in case.parts if f"{name}.rho" in values]
    if len(parts) < 2:
        return notes
    columns = [list(values).index(f"{name}.rho") for name in parts]
    rho = np.array([values[f"{name}.rho"] for name in parts])
    # Of a mode with unit modal mass -dlambda / drho rho / lambda is a part's kinetic energy.
    moving = -modes.gradients(index)[:, columns] * rho / modes.eigenvalues[index.start :, None]
    total = modes.model.total_mass(modes.given)
    twice = ({**(modes.given or {}), f"{n}.rho": 2 * r} for n, r in zip(parts, rho, strict=True))
    mass = np.array([modes.model.total_mass(given) for given in twice]) / total - 1
    for k, share in zip(index, moving, strict=True):
        order = np.argsort(-share)
        few = order[: 1 + int(np.argmax(np.cumsum(share[order]) >= _ALONE))]
        if share[few].sum() >= _ALONE and mass[few].sum() < _SMALL:
            names = ", ".join(parts[i] for i in sorted(few))
            notes.append(
                f"mode {k + 1} at {hz[k]:.4g} Hz moves {names} alone ("
                f"{percent(share[few].sum())} of the energy, {percent(mass[few].sum())} of the "
                "mass): is it joined as intended?"
            )
            break
    return notes


def _small_enough(case: Case, tagged, dofs: int) -> tuple[Case, TaggedMesh | None]:
    """The case with its mesh; or with its diagnosis' mesh or larger elements, and None."""
    if tagged is None or dofs <= _MOST:
        return case, tagged
    coarse = case.diagnosed()
    mesh, expected = coarse.mesh, estimate(coarse).dofs
    key = next((key for key in _SIZES[:2] if getattr(mesh, key, None) is not None), None)
    if key is not None and expected > _MOST:
        size = getattr(mesh, key) * (2 * expected / _MOST) ** 0.5
        coarse = coarse.model_copy(update={"mesh": mesh.model_copy(update={key: size})})
    return coarse, tagged if coarse.mesh is case.mesh else None


def _of_bands(bands: dict[str, tuple[float, float]], hz: np.ndarray) -> list[str]:
    """A note for each frequency band without a mode; ``hz``: all elastic modes of the model."""
    notes = []
    for key, (low, high) in bands.items():
        if not np.any((hz > low / _MARGIN) & (hz < _MARGIN * high)) and low < hz.max(initial=0.0):
            near = min(hz.tolist(), key=lambda f: max(low / f, f / high))
            notes.append(
                f"{key} = [{low:g}, {high:g}] Hz: the model has no mode there; expected a band "
                f"around a mode, the nearest of which is at {near:.4g} Hz"
            )
    return notes


def _of_test(case: Case, modes: Modes) -> list[str]:
    """Notes on the measured modes, compared with the model's."""
    data, own = case.measured, case.row()
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
            f"test.sees: {len(seen)} of the model's {len(modes) - modes.n_rigid} elastic modes up "
            f"to {hz[-1]:.4g} Hz are visible to the sensors; expected at least "
            f"{len(data.mode_names)}, as many as were measured: are the sensors' places and "
            "directions right?"
        )
    return notes


def _share_of_joints(case: Case, modes: Modes, index) -> float:
    """Median share of the modes' strain energy that is in joints; 0 for contacts."""
    values, stiff = (
        modes.model.values(modes.given),
        {f"{name}.{key}" for name in case.joints for key in _STIFFNESSES},
    )
    sizes = np.array([value if name in stiff else 0.0 for name, value in values.items()])
    if not sizes.any():
        return 0.0
    return float(np.median(modes.gradients(index) @ sizes / modes.eigenvalues[index]))


def _of_mesh(case: Case, comm: MPI.Intracomm, model, modes: Modes) -> list[str]:
    """A note if the mesh is too coarse for the modes in the range of the test."""
    hz, mesh, finer, key = case.measured.frequencies_hz, case.mesh, None, "elements"
    if mesh.origin == "beams":
        mesh = mesh.model_copy(update={"elements": [2 * n for n in mesh.elements]})
        finer = build_structure(case.model_copy(update={"mesh": mesh}), comm)
    elif isinstance(model, Structure) and 2 * model.n_dofs < _FINER:
        key = next((k for k in _SIZES if getattr(mesh, k, None) is not None), "builder")
        finer = model.finer()
    if finer is None or finer.n_dofs > _FINER:
        return []
    # On nested spaces each eigenvalue, in order, is above the finer one's (Courant and Fischer).
    better = solve_modes(finer, n_modes=len(modes))
    top = max(np.sum(modes.frequencies_hz < np.nanmax(hz)), modes.n_rigid + hz.shape[1])
    own, true = (m.frequencies_hz[modes.n_rigid : top] for m in (modes, better))
    off, worst = own / true - 1.0, int(np.argmax(own / true))
    row = np.sort(hz[-1][np.isfinite(hz[-1])])
    n = min(len(row), len(own))
    all_off, of_test = rms(off[:n]), rms(own[:n] / row[:n] - 1.0)
    if off[worst] < _COARSE and all_off < max(_HIDES * of_test, _SLIGHT):
        return []
    return [
        f"mesh.{key}: the mesh is too coarse: it raises the model's frequencies by "
        f"{percent(all_off)} (root mean square; up to {percent(off[worst])}, {own[worst]:.4g} Hz "
        f"for {true[worst]:.4g} Hz on a finer mesh), and the model's error against the test is "
        f"{percent(of_test)}; expected less than a fifth of it: use smaller elements"
    ]
