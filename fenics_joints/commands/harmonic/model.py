"""The reduced model with nonlinear joints that a case describes."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from fenics_joints.case import Case, build_preload, build_structure
from fenics_joints.case.check_structure import refuse_beams
from fenics_joints.case.harmonic import ContactLawSection
from fenics_joints.errors import ConvergenceError, InputError
from fenics_joints.interfaces import (
    FullModel,
    InterfaceModel,
    ReducedInterfaceModel,
    reduce_contacts,
    reduce_layers,
    reduce_matrix_joints,
    with_modal_damping,
)
from fenics_joints.interfaces.full import full_layers
from fenics_joints.interfaces.loading import loading_shapes
from fenics_joints.joint_laws import JointLaw
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import LinearJoint, PreloadSolver, stuck_conditions
from fenics_joints.progress import Progress
from fenics_joints.structure.structure import Structure

FORCE, SENSOR = "force", "sensor"
#: Static loads whose shapes go into the basis: as many, the least as a share of the largest.
_LOADINGS, _LEAST = 12, 0.01
#: Interface modes of contacts beside those shapes, unless the case says how many.
_CONTACT_MODES = 12
#: Interface modes of joints between parts by matrices.
_JUMP_MODES = 60


@dataclass(frozen=True)
class HarmonicModel:
    """The model of a harmonic analysis.

    Attributes:
        model: The reduced model, damped.
        n_dofs: Degrees of freedom of the full one.
        frequencies_hz: Its modes at rest, Hz.
        mode: The mode that the band holds, by number, rigid-body modes counted.
        full: The full model, without damping; None unless the case asks for it.
    """

    model: ReducedInterfaceModel
    n_dofs: int
    frequencies_hz: np.ndarray
    mode: int
    full: FullModel | None = None


def joint_laws(case: Case, structure: Structure) -> dict[str, JointLaw]:
    """Law of every nonlinear layer of a case, by the joint's name. Collective."""
    numbers = {region.name: i for i, region in enumerate(structure.regions)}
    laws = {}
    for name, section in case.nonlinear.items():
        if name in case.joints:
            joint, meshed = case.joints[name], structure.extent(numbers[name])
            E, G = joint.E, joint.G
            if joint.law == "springs":
                meshed = structure.regions[numbers[name]].properties["meshed"]
                E, G = joint.k_n * meshed, joint.k_t * meshed
            laws[name] = section.make(E, G, meshed)
    return laws


def harmonic_model(case: Case, comm: MPI.Intracomm, progress: Progress) -> HarmonicModel:
    """Reduce the structure of a case about its nonlinear joints. Collective.

    Raises:
        InputError: If the case has no [harmonic] section, nonlinear layers and nonlinear contacts
            at once, or a band without a mode near it.
        JointsError: If the mesh or a solution fails.
    """
    if case.harmonic is None:
        refuse_beams(case, "harmonic")
        raise InputError(f"{case.path}: harmonic: expected a section [harmonic]")
    contacts = [name for name in case.nonlinear if name in case.contacts]
    if contacts and len(contacts) < len(case.nonlinear):
        raise InputError(
            f"{case.path}: nonlinear: expected layers or contacts, not both: "
            f"{', '.join(case.nonlinear)}"
        )
    if contacts and case.harmonic.quasi_static == "full":
        raise InputError(
            f"{case.path}: harmonic.quasi_static = 'full': expected layers; for contacts only the "
            "'reduced' model exists"
        )
    make = _with_contacts if contacts else _with_layers
    if case.mesh.origin == "matrices":
        make = _between_matrices
    model, n_dofs, modes, full = make(case, comm, progress)
    damping = case.harmonic.damping
    model = with_modal_damping(model, damping, damping[-1])
    mode = _mode_in_band(case, modes.frequencies_hz, modes.n_rigid)
    kept = full if case.harmonic.quasi_static == "full" else None
    return HarmonicModel(model, n_dofs, modes.frequencies_hz, mode, kept)


def _places(case: Case) -> dict:
    h = case.harmonic
    first = (None, h.base.direction) if h.force is None else (h.force.point, h.force.direction)
    more = {load_name(i): (load.point, load.direction) for i, load in enumerate(h.loads)}
    return {
        "forces": {FORCE: first, **more},
        "sensors": {SENSOR: (h.sensor.point, h.sensor.direction)},
    }


def load_name(i: int) -> str:
    """Name of the place of the i-th further load."""
    return f"load {i + 1}"


def level_power(case: Case) -> int:
    """Power of the frequency that a level is multiplied by to be a force."""
    base = case.harmonic.base
    return 2 if base is not None and base.motion == "displacement" else 0


def _mode_in_band(case: Case, hz: np.ndarray, n_rigid: int = 0) -> int:
    """The elastic mode in or near a band that is nearest to its middle."""
    low, high = case.harmonic.band
    inside = [i for i in range(n_rigid, len(hz)) if 0.8 * low <= hz[i] <= 1.25 * high]
    if not inside:
        there = ", ".join(f"{f:.4g}" for f in hz[n_rigid:][: case.harmonic.modes])
        raise InputError(
            f"{case.path}: harmonic.band = [{low:g}, {high:g}] Hz: no mode is near it; expected "
            f"one of {there} Hz inside"
        )
    return min(inside, key=lambda i: abs(hz[i] - 0.5 * (low + high)))


def _with_layers(case: Case, comm, progress: Progress):
    progress.step("building the model")
    structure = build_structure(case, comm)
    h, places, laws = case.harmonic, _places(case), joint_laws(case, structure)
    modes = solve_modes(structure, n_modes=h.modes)
    full = full_layers(structure, laws, **places)
    progress.step("static response of the joints", _LOADINGS)
    shapes = _loadings(case, full, modes, progress)
    progress.step(f"reducing {structure.n_dofs} degrees of freedom")
    model = reduce_layers(
        structure,
        laws,
        n_modes=h.modes,
        interface_modes=h.interface_modes or 0,
        extra=shapes,
        **places,
    )
    return model, structure.n_dofs, modes, full


def _between_matrices(case: Case, comm, progress: Progress):
    progress.step("building the model")
    structure = build_structure(case, comm)
    h, laws = case.harmonic, {}
    for name, section in case.nonlinear.items():
        joint = case.joints[name]
        laws[name] = section.make(joint.k_n, joint.k_t, 1.0)  # by the jump, m
    progress.step(f"reducing {structure.n_dofs} degrees of freedom")
    given = {"n_modes": h.modes, **_places(case)}
    # All that the joint can do, and of that what the loads ask for.
    whole = reduce_matrix_joints(structure, laws, interface_modes=_JUMP_MODES, **given)
    modes = solve_modes(whole, n_modes=min(h.modes, whole.n_dofs))
    return whole, structure.n_dofs, modes, None


def _loadings(case: Case, full: FullModel, modes: Modes, progress: Progress) -> list:
    """Static shapes up to what a linear joint would do at resonance at the highest level."""
    i = _mode_in_band(case, modes.frequencies_hz, modes.n_rigid)
    shape, eigenvalue = modes.shapes[i], float(modes.eigenvalues[i])
    load = full.M.createVecLeft()
    full.M.mult(shape, load)
    load.scale(eigenvalue)
    pushed, seen = full.forces[FORCE].dot(shape), full.sensors[SENSOR].dot(shape)
    factors = _factors(case, i, eigenvalue, abs(pushed), abs(seen))

    def on_load(factor: float) -> None:
        done = int(factor in factors[1:])  # where a load fails, smaller ones in between are tried
        progress.advance(done, f"load {factor / factors[-1]:.2g} of the highest")

    return loading_shapes(full, load, factors, on_load=on_load)


def _factors(case: Case, i: int, eigenvalue: float, pushed: float, seen: float) -> np.ndarray:
    """Amplitudes of a mode, by mass, up to the largest that is asked for."""
    zeta = case.harmonic.damping[min(i, len(case.harmonic.damping) - 1)]
    push = pushed * max(case.harmonic.levels) * eigenvalue ** (level_power(case) / 2)
    largest = push / (2 * max(zeta, 1e-4) * eigenvalue)
    if seen > 0:
        largest = max(largest, _measured_reach(case) / seen)
    return largest * np.geomspace(_LEAST, 1.0, _LOADINGS)


def _opening_shapes(case: Case, whole: InterfaceModel) -> list:
    """As `_loadings`, for contacts, which open one way and close the other: loads both ways.

    A way without an equilibrium, as where nothing holds a part that lifts off, gives no shapes.
    """
    shift, theta, X = whole.modes_at_rest()
    hz = np.sqrt(np.maximum(1 / theta - shift, 0.0)) / (2 * np.pi)
    i = _mode_in_band(case, hz, int(np.searchsorted(hz, 1e-3 * case.harmonic.band[0])))
    shape, eigenvalue = X[:, i] / np.sqrt(theta[i]), (2 * np.pi * hz[i]) ** 2
    load = eigenvalue * whole.M @ shape
    pushed, seen = whole.forces[FORCE] @ shape, whole.sensors[SENSOR] @ shape
    factors = _factors(case, i, eigenvalue, abs(pushed), abs(seen))
    found = []
    for way in (1, -1):
        with contextlib.suppress(ConvergenceError):
            found += loading_shapes(whole, way * load, factors)
    return found


def _measured_reach(case: Case) -> float:
    """Largest displacement, m, of a mode over its amplitude that laws are identified from, or 0."""
    identify = case.harmonic.identify
    if identify is None or not identify.by_amplitude:
        return 0.0
    there = case.backbones()
    taken = there[identify.mode or next(iter(there))]
    return 0.0 if taken.response == "force" else float(taken.displacements.max())


def _with_contacts(case: Case, comm, progress: Progress):
    progress.step("building the model")
    preload = build_preload(case, comm, at_rest=True)
    states, held = {}, {}
    if case.is_pressed:
        progress.step(f"contact of {preload.jumps.n} degrees of freedom under preload")
        result = PreloadSolver(preload).solve(monitor=lambda i, norm: progress.advance())
        states, held = result.contacts, stuck_conditions(result)
    h, laws = case.harmonic, {}
    for name, section in case.nonlinear.items():
        if name not in case.contacts:
            continue
        if isinstance(section, ContactLawSection):
            laws[name] = section.contact_law(states.get(name))
        else:
            laws[name] = section.make(None, None, 1.0)
    joint = LinearJoint(preload, held)
    own = preload.structure.total_mass()
    if h.base is not None and abs(joint.total_mass() - own) > 1e-9 * own:
        raise InputError(
            f"{case.path}: harmonic.base: the motion of the base does not act on the bolts' mass; "
            "expected bolts without mass, or a force"
        )
    progress.step(f"reducing {preload.jumps.n} degrees of freedom")
    jumps = sum(len(c) * preload.structure.gdim for c in preload.jumps.contacts if c.name in laws)
    kept = min(jumps, _CONTACT_MODES) if h.interface_modes is None else h.interface_modes
    model = reduce_contacts(
        joint,
        laws,
        n_modes=h.modes,
        interface_modes=kept,
        shapes=lambda whole: _opening_shapes(case, whole),
        **_places(case),
    )
    modes = solve_modes(model, n_modes=min(h.modes, model.n_dofs))
    return model, preload.jumps.n, modes, None
