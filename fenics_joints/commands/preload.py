"""The ``preload`` command: contacts under bolt preload, and the frequencies about that state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from mpi4py import MPI

import fenics_joints
from fenics_joints.case import Case, build_preload
from fenics_joints.commands.outcome import Outcome
from fenics_joints.files import plain, shown_path
from fenics_joints.formatting import number, prefixed, quantity
from fenics_joints.modal.modes import Modes, solve_modes
from fenics_joints.preload import (
    OPEN,
    SLIP,
    STICK,
    ContactState,
    Displacement,
    LinearJoint,
    PreloadResult,
    PreloadSolver,
    status_conditions,
    stuck_conditions,
)
from fenics_joints.preload.bodies import body_numbers
from fenics_joints.preload.fields import nodal_fields, write
from fenics_joints.preload.patch import equal_radius, largest_radius, nearest_axis
from fenics_joints.progress import Progress
from fenics_joints.report import document as doc
from fenics_joints.report import geometry
from fenics_joints.report.contact_pictures import pressure_map, pressure_profile
from fenics_joints.report.style import to_svg
from fenics_joints.report.surface import Surface, surface
from fenics_joints.report.view import Colours, SurfaceView, scene
from fenics_joints.structure.grids import check_fields_path

#: Pressure, Pa, that bounds the contact radius (Machines 2022, eq. 10).
LIMIT = 1e6
#: Friction coefficient and pressure, Pa, that no metal reaches: hard steel indents at some 8 GPa.
_ROUGH, _HARDEST = 2.0, 1e10
#: Gap over a face's size that counts as zero.
_FLAT = 1e-9
#: Components below this share of the largest are round-off.
_ZERO = 1e-9
#: Elastic modes whose frequencies are compared.
_ELASTIC = 6
#: Relative difference of frequencies below which modes are a symmetric structure's pair, whose
#: shapes may mix.
_EQUAL = 1e-3
#: Colours of open, slipping and sticking, distinct for all kinds of colour vision.
_STATUS = colormaps["cividis"]


def run_preload(
    case: Case, comm: MPI.Intracomm, progress: Progress, *, fields: Path | None = None
) -> Outcome[PreloadReport]:
    """Contacts at the case's bolt forces and loads, and frequencies about that state. Collective.

    Args:
        case: The case.
        comm: Communicator.
        progress: Told what is being done.
        fields: A file to write the fields to, ``.bp`` or ``.xdmf``.

    Raises:
        JointsError: If the case, the mesh or a solution fails.
    """
    if fields is not None:
        check_fields_path(comm, fields)
    progress.step("building the model")
    model = build_preload(case, comm)
    progress.step(f"contact of {model.jumps.n} degrees of freedom")
    result = PreloadSolver(model).solve(monitor=lambda i, norm: progress.advance())
    axes = bolt_axes(result)
    contacts = [contact_facts(state, axes) for state in result.contacts.values()]
    progress.step("modes with the contacts stuck, and as the preload leaves them")
    joint = LinearJoint(model, stuck_conditions(result))
    stuck = _elastic_modes(joint)
    loose = _elastic_modes(joint.change(status_conditions(result)), stuck)
    written = ()
    if fields is not None:
        progress.step(f"writing {fields}")
        written = tuple(write(result, fields))
    hz = [modes.frequencies_hz[modes.n_rigid :] for modes in (stuck, loose)]
    compared = min(_ELASTIC, *map(len, hz))
    found = PreloadReport(
        case,
        result,
        contacts,
        *(f[:compared] for f in hz),
        written,
        tuple(applied_facts(result)),
        max(loose.n_rigid - stuck.n_rigid, 0),
        _become(joint, stuck, loose)[:compared],
    )
    return Outcome(found, preload_document(found))


def _become(joint: LinearJoint, stuck: Modes, loose: Modes) -> np.ndarray:
    """Frequency, Hz, (n,), of the preloaded mode that has the shape of each stuck elastic mode.

    That mode, or modes of equal frequency together, must hold more than half of the kinetic energy
    of the stuck shape; nan where none do.
    """
    mass, hz = joint.free_matrices()[1], loose.frequencies_hz[loose.n_rigid :]
    moved = [mass * shape for shape in loose.shapes[loose.n_rigid :]]
    found = np.full(len(stuck) - stuck.n_rigid, np.nan)
    for i, shape in enumerate(stuck.shapes[stuck.n_rigid :]):
        # Shapes have unit modal mass: these shares of all modes together sum to 1.
        shares = np.array([shape.dot(other) ** 2 for other in moved])
        near = hz[np.argmax(shares)]
        if shares[np.abs(hz / near - 1) < _EQUAL].sum() > 0.5:
            found[i] = near
    return found


def _elastic_modes(joint: LinearJoint, before: Modes | None = None) -> Modes:
    """Enough modes to hold the compared elastic ones behind all motions at 0 Hz.

    Faces that slide or are open add such motions: bodies move freely against one another.
    """
    wanted = (6 if before is None else before.n_rigid) + _ELASTIC + 1
    solver = None if before is None else before.solver
    modes = solve_modes(joint, n_modes=wanted, solver=solver)
    if len(modes) - modes.n_rigid < _ELASTIC and len(modes) == wanted:
        wanted = modes.n_rigid + 6 * _ELASTIC
        modes = solve_modes(joint, n_modes=wanted, solver=solver)
    return modes


# -- the result ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PreloadReport:
    """The result of the ``preload`` command.

    Attributes:
        case: The case.
        result: The preload state.
        contacts: A dict of facts for each contact, see `contact_facts`.
        stuck_hz: Elastic frequencies with all contacts fully stuck, and obstacles stuck where they
            press, Hz, (n,).
        preloaded_hz: Elastic frequencies with each pair as the preload leaves it, Hz, (n,).
        written: Files of fields.
        applied: A dict of facts for each obstacle, displacement and load, see `applied_facts`.
        free_motions: Number of motions that nothing resists in the preloaded state, beyond those
            of the stuck structure.
        become_hz: Frequencies of the preloaded modes that have the stuck ones' shapes, Hz, (n,);
            nan where none has.
    """

    case: Case
    result: PreloadResult
    contacts: list[dict]
    stuck_hz: np.ndarray
    preloaded_hz: np.ndarray
    written: tuple[Path, ...] = ()
    applied: tuple[dict, ...] = ()
    free_motions: int = 0
    become_hz: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def records(self) -> list[dict]:
        """Rows of the table: each stuck mode beside the preloaded mode of its shape; then preloaded
        modes whose shape no stuck mode has."""
        other = self.preloaded_hz[~np.isin(self.preloaded_hz, self.become_hz)]
        stuck = np.append(self.stuck_hz, np.full(len(other), np.nan))
        preloaded = np.append(self.become_hz, other)
        numbers = [str(i + 1) if i < len(self.stuck_hz) else "" for i in range(len(stuck))]
        change = 100 * (preloaded / stuck - 1)
        return doc.records(
            mode=numbers, stuck_hz=stuck, preloaded_hz=preloaded, change_percent=change
        )

    @property
    def notes(self) -> list[str]:
        """Remarks on the state and its frequencies, and unlikely values, a sentence each."""
        found = [
            f"contact {c.name}: friction of {number(c.friction)} is unlikely; dry metals have "
            "0.1 to 1"
            for c in self.result.model.contacts
            if c.friction > _ROUGH
        ] + [
            f"contact {c['name']}: a peak pressure of {quantity(c['peak_pressure_pa'], 'Pa')} is "
            "more than metals bear: are the bolt forces right?"
            for c in self.contacts
            if c["peak_pressure_pa"] > _HARDEST
        ]
        if not np.isfinite(self.become_hz).all():
            found.append(
                "a mode with only one frequency has no mode of similar shape in the other state: "
                "faces that slide or open change the shapes"
            )
        if self.free_motions:
            found.append(
                f"sliding or open faces add {self.free_motions} "
                f"motion{'s' * (self.free_motions > 1)} that nothing resists, at 0 Hz, which "
                "this table leaves out"
            )
        if _recedes(self.result):
            found.append(
                "the faces touch everywhere before tightening, and only bolts press them (a "
                "receding contact): if all bolt forces change by one factor, the pressures change "
                "by it too, but the pressed area and these frequencies stay the same; they change "
                "with faces that have a gap or a crown, with other loads, and with joints whose "
                "stiffness depends on the pressure"
            )
        return found

    def __repr__(self) -> str:
        words = f"{self.result.iterations} iterations, {len(self.contacts)} contacts"
        return f"PreloadReport({self.case.name!r}, {words})"

    def to_json(self) -> dict[str, object]:
        """The content of ``--json``.

        Keys: ``version``, ``title``, ``dofs``, ``bolt_forces_n``, ``iterations``,
        ``complementarity``, ``contacts`` (each with the keys of `contact_facts`), ``applied``
        (obstacles, displacements and loads, with the keys of `applied_facts`),
        ``frequencies_hz`` with ``stuck``, ``preloaded`` and ``stuck_become`` (of the preloaded
        modes of the stuck shapes; null where there is none), ``free_motions`` and ``notes``.
        """
        become = {"stuck": self.stuck_hz, "preloaded": self.preloaded_hz}
        return plain(
            {
                "version": fenics_joints.__version__,
                "title": self.case.title,
                "dofs": self.result.model.jumps.n,
                "bolt_forces_n": bolt_forces(self.result),
                "iterations": self.result.iterations,
                "complementarity": self.result.complementarity,
                "contacts": self.contacts,
                "applied": self.applied,
                "frequencies_hz": {**become, "stuck_become": self.become_hz},
                "free_motions": self.free_motions,
                "notes": self.notes,
            }
        )


def _recedes(result: PreloadResult) -> bool:
    """Whether only bolts press, and faces have no gap: pressures then scale with the bolt forces.

    Dundurs and Stippes, J. Appl. Mech. 37, 1970.
    """
    model = result.model
    if model.moved or len(model.bolts) < len(result.forces):
        return False
    sizes = [np.ptp(i.points, axis=0).max() for i in model.interfaces]
    return bool(model.bolts) and all(
        np.abs(i.gap).max(initial=0.0) <= _FLAT * size
        for i, size in zip(model.interfaces, sizes, strict=True)
    )


def applied_facts(result: PreloadResult) -> list[dict]:
    """Obstacles, displacements and loads on faces, with their forces. Collective.

    Returns:
        A dict for each, with ``name``; ``kind`` (``obstacle``, ``displacement``, ``load``);
        ``displacement_m``, the components of the motion of the obstacle or face, None for those
        that are free and for a load; and ``force_n``, the components of the force on the bodies
        (for a displacement, the force that holds the face).
    """
    model, found = result.model, []
    for moved in sorted(model.moved, key=lambda m: isinstance(m, Displacement)):
        kind, way = "obstacle", result.motion(moved.name).tolist()
        if isinstance(moved, Displacement):
            kind = "displacement"
            way = [None if v is None else w for v, w in zip(moved.value, way, strict=True)]
        found.append((moved.name, kind, way, result.reaction(moved.name).tolist()))
    for name, force in model.resultants.items():
        found.append((name, "load", None, (result.forces[name] * force).tolist()))
    return [dict(zip(("name", "kind", "displacement_m", "force_n"), f, strict=True)) for f in found]


def bolt_axes(result: PreloadResult) -> dict[str, np.ndarray]:
    """A point on the axis of every bolt, m, (gdim,): the middle of its two faces. Collective."""
    model = result.model

    def middle(face: str) -> np.ndarray:
        points = model.face(face).points
        return 0.5 * (points.min(axis=0) + points.max(axis=0))

    return {bolt.name: 0.5 * (middle(bolt.lower) + middle(bolt.upper)) for bolt in model.bolts}


def contact_facts(state: ContactState, axes: dict[str, np.ndarray]) -> dict:
    """Forces, pressures, areas and radii of a contact, as ``--json`` writes them.

    Args:
        state: The contact in its state.
        axes: A point on the axis of each bolt, by name, as from `bolt_axes`.

    Returns:
        Keys ``name``; ``force_n``; ``peak_pressure_pa``, the largest of the facets' means, and
        ``peak_nodal_pressure_pa``; ``mean_pressure_pa``, over the area that presses; ``area_m2``,
        where the pressure, linear between vertices, is above zero, ``area_above_1_mpa_m2``, with
        the same pressure, and ``whole_area_m2``; ``radius_m`` by bolt, to the farthest place with
        1 MPa or more among those nearest to the bolt; ``equal_radius_m`` by bolt, in 3-D only:
        outer radius of a ring around the hole with the area above 1 MPa, and its least and largest
        value within the mesh's resolution; ``open``, ``slip``, ``stick``: numbers of pairs;
        ``matching``, whether these are pairs of vertices (else mortar).
    """
    area, farthest, equal = state.area, {}, {}
    nearest = nearest_axis(state.interface.points, axes.values()) if axes else None
    for i, (name, axis) in enumerate(axes.items()):
        own = np.where(nearest == i, state.pressure, 0.0)
        farthest[name] = largest_radius(state.interface, own, LIMIT, axis)
        if len(axis) == 3:
            equal[name] = equal_radius(state.interface, own, LIMIT, axis)
    kinds = (("open", OPEN), ("slip", SLIP), ("stick", STICK))
    return {
        "name": state.name,
        "force_n": state.normal_force,
        "peak_pressure_pa": float(state.facet_pressure.max(initial=0.0)),
        "peak_nodal_pressure_pa": float(state.pressure.max(initial=0.0)),
        "mean_pressure_pa": state.pressure_force / area if area else 0.0,
        "area_m2": area,
        "area_above_1_mpa_m2": state.area_above(LIMIT),
        "whole_area_m2": float(state.facet_area.sum()),
        "radius_m": farthest,
        "equal_radius_m": equal,
        "matching": state.interface.coupling is None,
        **{word: int(np.sum(state.status == kind)) for word, kind in kinds},
    }


def bolt_forces(result: PreloadResult) -> dict[str, float]:
    """The bolts' forces, N, by name."""
    return {bolt.name: result.forces[bolt.name] for bolt in result.model.bolts}


# -- the document ----------------------------------------------------------------------------------


def preload_document(p: PreloadReport) -> doc.Document:
    """The document of a preload state and its frequencies."""
    forces = forces_in_words(p.result)
    frequencies = doc.Table.of(
        p.records(),
        "mode: >elastic mode | stuck_hz: >stuck, Hz | preloaded_hz: >preloaded, Hz | "
        "change_percent: >change",
        id="frequencies",
    )
    press = ", and to obstacles where they press" if p.applied else ""
    held = f"Stuck: the faces are bonded everywhere{press}."
    return doc.Document(
        p.case.name,
        "contact under preload",
        "Contact under preload",
        [
            doc.Keys(
                [
                    *([("forces", forces, "(bolt forces)")] if forces else []),
                    ("dofs", p.result.model.jumps.n, "degrees of freedom"),
                    ("iterations", p.result.iterations, "iterations"),
                ]
            ),
            doc.OnPage(lambda: _scene(p.result)),
            doc.Heading("Effect of the preload on the frequencies"),
            doc.Text(
                f"{held} Preloaded: open where the preload leaves a gap, free to slide where it "
                "slips."
            ),
            frequencies,
            *(doc.Text(doc.sentence(note)) for note in p.notes),
            *_applied(p.applied),
            *contact_blocks(p.result, p.contacts),
            doc.OnTerminal([doc.Text(f"wrote {shown_path(path)}") for path in p.written]),
        ],
        p.to_json,
    )


def _applied(facts: Sequence[dict]) -> list:
    """Obstacles, displacements and loads, with their forces."""
    if not facts:
        return []
    rows = [
        {
            "name": f["name"],
            "kind": f["kind"],
            "way": "" if f["displacement_m"] is None else _words(f["displacement_m"], "m"),
            "force": _words(f["force_n"], "N"),
        }
        for f in facts
    ]
    table = doc.Table.of(
        rows,
        "name: name | kind: kind | way: moved by | force: force on the bodies",
        caption="Components x, y, z. On a displaced face the force is its reaction",
        id="applied",
    )
    return [doc.Heading("Obstacles, displacements and loads"), table]


def _words(vector: Sequence[float | None], unit: str) -> str:
    """A vector in words, with the prefix of the unit that suits its largest component."""
    size = max(abs(v or 0.0) for v in vector)
    factor, unit = prefixed(size, unit)
    parts = (
        "free" if v is None else number(v * factor if abs(v) > _ZERO * size else 0.0)
        for v in vector
    )
    return f"({', '.join(parts)}) {unit}"


def area_words(square_metres: float) -> str:
    """An area in mm2."""
    return f"{square_metres * 1e6:.0f} mm²"


def forces_in_words(result: PreloadResult) -> str:
    """The bolts' forces by name; empty without bolts."""
    return ", ".join(f"{name} {quantity(f, 'N')}" for name, f in bolt_forces(result).items())


def contact_blocks(result: PreloadResult, contacts: Sequence[dict]) -> list:
    """Facts on each contact, and pictures of its pressure."""
    tables = [_contact_table(c) for c in contacts]
    return [doc.Heading("Contacts"), *tables, doc.OnPage(lambda: _pressures(result))]


def _contact_table(c: dict) -> doc.Table:
    table = doc.Table([f"contact {c['name']}", ">"], kind="contact")
    presses, whole = area_words(c["area_m2"]), area_words(c["whole_area_m2"])
    table.add("force between the faces", quantity(c["force_n"], "N"))
    table.add("peak pressure, mean over a facet", quantity(c["peak_pressure_pa"], "Pa"))
    table.add("peak pressure at a vertex", quantity(c["peak_nodal_pressure_pa"], "Pa"))
    table.add("mean pressure over the pressed area", quantity(c["mean_pressure_pa"], "Pa"))
    table.add("pressed area", f"{presses} of {whole}")
    table.add("area above 1 MPa", area_words(c["area_above_1_mpa_m2"]))
    for bolt, radius in c["radius_m"].items():
        if bolt in c["equal_radius_m"]:
            equal, least, most = (1e3 * r for r in c["equal_radius_m"][bolt])
            words = f"{equal:.1f} mm ({least:.1f} to {most:.1f} by the mesh)"
            table.add(f"radius of the area above 1 MPa at {bolt}", words)
        table.add(f"farthest place with 1 MPa from {bolt}", quantity(radius, "m"))
    if not c["matching"]:
        table.add("meshes of the faces", "differ: mortar")
    for word in ("open", "slip", "stick"):
        table.add(f"{word} pairs", str(c[word]))
    return table


def bolt_centres(result: PreloadResult) -> np.ndarray | None:
    """Points on the bolts' axes, m, (n, gdim); None without bolts. Collective."""
    axes = bolt_axes(result)
    return np.array(list(axes.values())) if axes else None


def _pressures(result: PreloadResult) -> list[doc.Figure] | None:
    """Pictures of each contact's pressure: in plan, and along its longest direction. Collective."""
    centres = bolt_centres(result)
    if result.model.comm.rank != 0:
        return None
    found: list[doc.Figure] = []
    if result.model.structure.gdim < 3:
        return found
    for i, state in enumerate(result.contacts.values()):
        axis = int(np.ptp(state.interface.points, axis=0).argmax())
        words = f"Pressure of the contact {state.name}"
        peak = quantity(float(state.facet_pressure.max(initial=0)), "Pa")
        plan = pressure_map(state, centres=centres)
        line = pressure_profile(state, centres=centres, direction=np.eye(3)[axis])
        drawn = to_svg(plan, f"plan{i}", f"{words} in plan; peak {peak}.")
        found.append(doc.Figure(drawn, f"{state.name}: pressure in plan"))
        drawn = to_svg(line, f"line{i}", f"{words} along {'xyz'[axis]}.")
        found.append(doc.Figure(drawn, f"{state.name}: pressure of all pairs along {'xyz'[axis]}"))
    return found


def _scene(result: PreloadResult) -> list[doc.View] | None:
    """A 3-D view of the bodies taken apart, with pressure and status of the contacts; none of plane
    bodies. Collective; None on all ranks but 0."""
    model = result.model
    if model.structure.gdim < 3 or not result.contacts:
        return [] if model.comm.rank == 0 else None
    named = {field.name: field for field in nodal_fields(result)}
    vertices, (motion,) = model.structure.corner_motion([result.displacement.x.petsc_vec])
    own = model.V.mesh.topology.index_map(3).size_local
    body, _ = body_numbers(model.V)
    here = [body[model.V.dofmap.list[:own, 0]]]
    for name in ("pressure", "status"):
        field = named[name]
        here.append(field.x.array[field.function_space.dofmap.list[:own]])
    parts = model.comm.gather(here)
    if parts is None:
        return None
    number, pressure, status = (np.concatenate(a) for a in zip(*parts, strict=True))
    turn = _upright(result)
    level = geometry.stacked(vertices @ turn[2], number)
    most = max(float(pressure.max(initial=0.0)), 1e-12)

    def looks(s: Surface) -> list[SurfaceView]:
        shape, at = motion.reshape(-1, 3)[s.pick], status.ravel()[s.pick]
        way = quantity(float(np.abs(shape).max(initial=0.0)), "m")
        note = f"Bodies as the preload deforms them, up to {way}, enlarged."
        value = np.where(at >= 0, pressure.ravel()[s.pick] / most, np.nan)
        words, peak = ("pressure at the vertices", "no contact"), quantity(most, "Pa")
        return [
            SurfaceView(
                "contact pressure",
                Colours(colormaps["YlGnBu"], "0", peak, *words),
                motion=shape,
                values=value,
                shown=(0.0, most / 1e6, "MPa"),
                note=note,
            ),
            SurfaceView(
                "open, slip, stick",
                Colours(_STATUS, "open", "stick", "slip between them", "no contact"),
                motion=shape,
                values=np.where(at >= 0, at / STICK, np.nan),
                note=note,
            ),
        ]

    name = "Bodies under preload, taken apart, with the pressure on their faces."
    return [
        doc.View(
            scene(surface(vertices, number, level, [motion]), looks, name, turn=turn, apart=True)
        )
    ]


def _upright(result: PreloadResult) -> np.ndarray:
    """Rotation of the contacts' mean normal upwards and their longest extent to the right."""
    normals = np.concatenate([s.interface.frames[:, 0] for s in result.contacts.values()])
    points = np.concatenate([s.interface.points for s in result.contacts.values()])
    up = normals.mean(axis=0)
    if np.linalg.norm(up) < 0.5:
        return np.eye(3)
    up /= np.linalg.norm(up)
    flat = points - points.mean(axis=0)
    flat -= np.outer(flat @ up, up)
    axes = np.eye(3) - np.outer(up, up)
    right = axes[int(np.argmax(np.ptp(flat, axis=0)))]
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(up, right), up])
